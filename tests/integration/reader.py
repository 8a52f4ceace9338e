"""A reader of the pages: types what a page prints, in its order, unchanged but for the port and an end.

`make run` and `uwserver run ...` start a server in the background, to which all that follows speaks; a second one ends the first, which the page
has to say. A listing below "`name`:" is saved under that name. A listing with tests is run by pytest.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from nursery import command, nursery, python

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120
STARTS = {"make run": "uwserver run"}
"""What a target of make starts, as a test says that reads the Makefile."""
OURS = ("uwserver", "uwclient")
"""Commands that are forks of one process, in which most of what they import is there."""
NOT_TYPED = ("make ", "pip install ")
SILENT = ("cc ", "python -c ")
_BLOCK = re.compile(
    r"(?:^`(?P<file>[\w.]+)`:\n|at the end of `(?P<longer>[\w.]+)`:\n+)?^```(?P<language>\w+)\n(?P<text>.*?)^```",
    re.S | re.M,
)
_SERVER = re.compile(r"uwserver run(?! --help)(?!.*--until)")


class Block(NamedTuple):
    """One listing of a page; `file` is the name under which the reader saves it, `longer` the file to whose end it is put."""

    language: str
    text: str
    file: str = ""
    longer: str = ""


def blocks(page: str, language: str = "") -> list[Block]:
    """The listings of a page, a path below the top folder, of all languages or of one."""
    found = _BLOCK.finditer((ROOT / page).read_text(encoding="utf-8"))
    all_of_them = [Block(each["language"], each["text"], each["file"] or "", each["longer"] or "") for each in found]
    return [block for block in all_of_them if not language or block.language == language]


class Reader:
    """Sits in an empty folder; `said` is what each line and listing printed. Leaves no server behind when used as a context."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = 0
        self.said: dict[str, str] = {}
        self._server: subprocess.Popen[str] | None = None
        venv = Path(sys.executable).parents[1]
        self._programs = folder / ".venv" / "bin"
        self._programs.mkdir(parents=True)
        for part in ("lib", "pyvenv.cfg"):
            (folder / ".venv" / part).symlink_to(venv / part)
        for program in (venv / "bin").iterdir():
            if program.name not in OURS or nursery() is None:
                (self._programs / program.name).symlink_to(program)
            else:
                command(self._programs / program.name, "-m", program.name)
        (folder / "tests").symlink_to(ROOT / "tests")

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *_: object) -> None:
        self.end_server()

    def follow(self, page: str) -> None:
        """Do all that a page says; one of an example in its folder."""
        if page.startswith("clients/"):
            for file in (ROOT / page).parent.glob("*.*"):
                if file.is_file():
                    (self.folder / file.name).write_bytes(file.read_bytes())
        for block in blocks(page):
            if block.file:
                (self.folder / block.file).write_text(block.text, encoding="utf-8")
            elif block.longer:
                with (self.folder / block.longer).open("a", encoding="utf-8") as file:
                    file.write("\n" + block.text)
            elif block.language == "sh":
                self.type(block.text)
            elif block.language == "python":
                self.run_python(block.text)

    def type(self, text: str) -> None:
        """Type the lines of a listing into a shell. What follows a lone `nc` is typed into that."""
        lines = re.sub(r"\\\n\s*", "", text).splitlines()
        while lines:
            line = re.sub(r"\s+#\s.*", "", lines.pop(0))
            if re.fullmatch(r"nc [\d.]+ \d+", line):
                self._nc(line, lines)
                return
            if line in STARTS or _SERVER.match(line):
                self.start(STARTS.get(line, line))
            elif not line.startswith(NOT_TYPED):
                self._run(line)

    def start(self, command: str) -> None:
        """Start a server, on a free port, and wait until it listens; the one before is ended."""
        self.end_server()
        words = [python(), "-m", *command.split(), "--port", "0"]
        with (self.folder / "server.log").open("w") as log:
            self._server = subprocess.Popen(words, cwd=self.folder, stdout=subprocess.PIPE, stderr=log, text=True)
        assert self._server.stdout is not None
        for line in self._server.stdout:
            self.said[command] = self.said.get(command, "") + line
            if found := re.search(r"[\w-]+: [\d.]+:(\d+)$", line):
                self.port = int(found[1])
            if line.startswith("Ctrl-C"):
                return
        raise AssertionError(f"{command}: {(self.folder / 'server.log').read_text()}")

    def end_server(self) -> None:
        """End the server, as Ctrl-C in its terminal does."""
        if self._server is not None:
            self._server.terminate()
            self._server.communicate(timeout=PATIENCE_S)
            self._server = None

    def run_python(self, code: str) -> None:
        """Run a listing of Python; it has to print something, or to pass."""
        ported = re.sub(r"\.connect\(\)", f".connect(port={self.port})", code).replace("7600", str(self.port))
        words = [python(), "-c", ported]
        if re.search(r"^def test_", code, re.M):
            (self.folder / "test_page.py").write_text(ported, encoding="utf-8")
            words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_page.py"]
        done = subprocess.run(words, cwd=self.folder, capture_output=True, text=True, timeout=PATIENCE_S)
        assert done.returncode == 0, f"{code}\n{done.stdout}\n{done.stderr}"
        assert done.stdout.strip(), f"prints nothing:\n{code}"
        self.said[code] = done.stdout

    def _run(self, line: str) -> None:
        if re.search(r"\bnc\b|drive\.sh", line) and shutil.which("nc") is None:
            return
        done = subprocess.run(
            self._ported(line), shell=True, cwd=self.folder, capture_output=True, text=True, timeout=PATIENCE_S,
            env=self._environment(),
        )  # fmt: skip
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        self.said[line] = done.stdout + done.stderr
        assert self.said[line].strip() or line.startswith(SILENT), f"prints nothing: {line}"

    def _nc(self, line: str, typed: list[str]) -> None:
        if shutil.which("nc") is None:
            return
        nc = subprocess.Popen(
            self._ported(line).split(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=self._environment(), bufsize=1,
        )  # fmt: skip
        assert nc.stdin is not None
        assert nc.stdout is not None
        try:
            for request in typed:
                nc.stdin.write(request + "\n")
                self.said[request] = nc.stdout.readline()
                assert '"result"' in self.said[request], self.said[request]
        finally:
            nc.kill()
            nc.communicate(timeout=PATIENCE_S)

    def _ported(self, line: str) -> str:
        """The line with this port, and with an end where it has none."""
        if "--port" not in line:
            line = re.sub(r"^((?:\S*/)?uwclient) ", rf"\1 --port {self.port} ", line)
        if re.search(r"uwclient .*\becho ", line) and " -n " not in line:
            line += " -n 3"
        if re.search(r"uwclient .*\bwatch ", line) and "--seconds" not in line:
            line += " --seconds 1"
        return line.replace("7600", str(self.port)).replace("localhost", "127.0.0.1")

    def _environment(self) -> dict[str, str]:
        beside = f"{self._programs}{os.pathsep}{os.environ['PATH']}"
        return os.environ | {"PATH": beside, "COLUMNS": "120"}
