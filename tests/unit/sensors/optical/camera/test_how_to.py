"""docs/how-to/cameras.md is followed: its tables make a vehicle with a camera, and its listing gets a picture."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from uwserver.cli import main

PAGE = Path(__file__).parents[5] / "docs/how-to/cameras.md"


def listings(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_tables_and_listing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    switched_on, own, light, _, ports = listings("toml")
    flat = ports.splitlines()[1]
    text = switched_on + light + own.replace("height = 480", "height = 480\n" + flat)
    (tmp_path / "my_pool.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (code,) = listings("python")
    scope: dict[str, object] = {}
    exec(code, scope)
    assert getattr(scope["picture"], "shape", None) == (480, 640, 3)
    (commands,) = listings("sh")
    for line in commands.splitlines():
        done = CliRunner().invoke(main, line.partition(" > ")[0].split()[1:])
        assert done.exit_code == 0, done.output


def test_the_other_port_and_the_tables_of_a_vehicle_file() -> None:
    import tomllib

    *_, vehicle, ports = listings("toml")
    assert tomllib.loads(vehicle)["actuators"]["camera_tilt"]["mount"] == "camera"
    kinds = [tomllib.loads(line.removeprefix("# "))["port"]["kind"] for line in ports.splitlines()[1:]]
    assert kinds == ["flat", "dome"]
