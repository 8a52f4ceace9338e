"""The how-to about a vehicle of one's own, from top to bottom: every command, listing and table, as printed, in one folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/how-to/your-vehicle.md"
PATIENCE_S = 240
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.S | re.M)


def edited(text: str, tables: str) -> str:
    """A vehicle file after the edit that the page shows: keys of tables that are there are replaced, other tables go to the end."""
    for table in re.split(r"\n(?=\[)", tables.strip()):
        head, *lines = table.splitlines()
        if head.startswith("[[") or head not in text:
            text += "\n" + table + "\n"
            continue
        before, after = text.split(head + "\n", 1)
        body, gap, rest = after.partition("\n\n")
        for line in lines:
            key = line.split(" = ")[0]
            body, count = re.subn(rf"^{key} = .*$", lambda _, line=line: line, body, flags=re.M)
            assert count == 1, f"{head} has no {key}"
        text = before + head + "\n" + body + gap + rest
    return text


def numbers(report: str) -> dict[str, float]:
    """First value of each row of a report."""
    return {a.strip(): float(b) for a, b in re.findall(r"^\| ([^|]+) \| (-?\d[\d.]*)(?: \||,)", report, re.M)}


@pytest.mark.slow
def test_the_vehicle_of_the_page_is_made_trimmed_driven_and_measured(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    pytest.importorskip("matplotlib")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = os.environ | {"PATH": path}
    outputs: list[str] = []
    commands: list[str] = []

    def run(command: Any, *, shell: bool = False) -> str:
        done = subprocess.run(
            command, shell=shell, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=PATIENCE_S
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    crab, server, port = tmp_path / "crab.toml", None, 0
    try:
        for language, code in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
            if language == "toml":
                crab.write_text(edited(crab.read_text(), code))
                tomllib.loads(crab.read_text())
            elif language == "python":
                outputs.append(run([sys.executable, "-c", code]))
            else:
                for command in code.splitlines():
                    commands.append(command)
                    if command.startswith("uwserver run"):
                        server = subprocess.Popen(
                            f"exec {command} --port 0", shell=True, cwd=tmp_path, env=env, stdout=subprocess.PIPE,
                            stderr=subprocess.DEVNULL, text=True,
                        )  # fmt: skip
                        assert server.stdout is not None
                        found = (re.search(r"tcp: [\d.]+:(\d+)", line) for line in server.stdout)
                        port = int(next(filter(None, found))[1])
                    else:
                        own = command.replace("uwclient ", f"uwclient --port {port} ", 1)
                        outputs.append(run(own, shell=True))
    finally:
        if server is not None:
            server.terminate()
            server.communicate(timeout=PATIENCE_S)
    assert len(commands) == 10
    assert (tmp_path / "crab.png").read_bytes().startswith(b"\x89PNG")
    first, last = (numbers(out) for out in outputs if out.startswith("# crab"))
    assert first["weight in the water"] == pytest.approx(-6.5, abs=0.1)
    assert -2.0 < last["weight in the water"] < 0.0
    (depth,) = (float(found[1]) for out in outputs if (found := re.match(r"depth ([\d.]+) m, attitude", out)))
    assert depth == pytest.approx(3.0, abs=0.05)
    (echoed,) = (out for out in outputs if out.count("depth=") == 3 or out.count('"depth"') == 3)
    assert echoed
