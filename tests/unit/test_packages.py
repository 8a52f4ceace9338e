"""The command that installs a package is for the Python that runs."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from uwclient.errors import install_command as install_command_of_client

from uwserver import packages
from uwserver.packages import install_command

COMMANDS = {"uwserver": install_command, "uwclient": install_command_of_client}


@pytest.fixture
def python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An environment in the working folder, whose pip is not on PATH."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / ".venv/bin/python"
    monkeypatch.setattr(sys, "executable", str(path))
    monkeypatch.setenv("PATH", str(tmp_path / "elsewhere"))
    path.parent.mkdir(parents=True)
    for program in (path, path.with_name("pip"), tmp_path / "elsewhere/pip"):
        program.parent.mkdir(exist_ok=True)
        program.touch(mode=0o755)
    return path


@pytest.mark.parametrize("whose", COMMANDS)
def test_an_environment_that_is_not_active_is_named(whose: str, python: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert COMMANDS[whose](f"{whose}[plot]") == f'.venv/bin/python -m pip install "{whose}[plot]"'
    monkeypatch.chdir("/usr")
    assert COMMANDS[whose](f"{whose}[plot]") == f'{python} -m pip install "{whose}[plot]"'


@pytest.mark.parametrize("whose", COMMANDS)
def test_an_active_environment_needs_no_name(whose: str, python: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(python.parent))
    assert COMMANDS[whose](f"{whose}[plot]") == f'pip install "{whose}[plot]"'


def test_an_environment_of_uv_has_no_pip(python: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "find_spec", lambda name: None)
    assert install_command("scipy") == ".venv/bin/python -m pip install scipy"
    (Path("elsewhere") / "uv").touch(mode=0o755)
    assert install_command("scipy") == "uv pip install --python .venv/bin/python scipy"


def test_our_own_extras_are_one_requirement(python: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(python.parent))
    wanted = ("uwserver[uvloop]", "theirs>=2", "uwserver[plot]", "uwserver", "uwserver[uvloop]")
    assert install_command(*wanted) == 'pip install "uwserver[plot,uvloop]" "theirs>=2"'
    assert install_command("uwserver", "theirs>=2") == 'pip install uwserver "theirs>=2"'
