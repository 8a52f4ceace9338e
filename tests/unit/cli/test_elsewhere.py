"""Commands of other distributions: what `uwserver` says when they are missing."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest
from click.testing import CliRunner

from uwserver import cli


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch):
    def install(*entries: EntryPoint) -> None:
        monkeypatch.setattr(cli, "entry_points", lambda *, group, name: [e for e in entries if e.name == name])

    return install


@pytest.mark.parametrize("arguments", [[], ["physics", "--quick"], ["--against", "/nowhere"], ["--help"]])
def test_without_the_benchmark_it_says_what_to_install(installed, arguments: list[str]) -> None:
    installed()
    done = CliRunner().invoke(cli.main, ["bench", *arguments])
    assert done.exit_code == 1
    assert "pip install uwserver-bench" in done.output
    assert "not installed" in done.output


def test_one_that_does_not_load_is_told_by_its_own_words(installed) -> None:
    installed(EntryPoint("bench", "no_such_package.cli:bench", "uwserver.commands"))
    done = CliRunner().invoke(cli.main, ["bench"])
    assert done.exit_code == 1
    assert "no_such_package" in done.output
    assert "pip install uwserver-bench" in done.output


@pytest.mark.parametrize("entry", [None, "no_such_package.cli:bench"])
def test_the_list_of_commands_stays_whole(installed, entry: str | None) -> None:
    installed(*([EntryPoint("bench", entry, "uwserver.commands")] if entry else []))
    done = CliRunner().invoke(cli.main, ["--help"])
    assert done.exit_code == 0
    assert "validate" in done.output
    assert "needs uwserver-bench" in done.output


def test_one_that_is_there_is_used(installed) -> None:
    installed(EntryPoint("bench", "uwserver_bench.cli:bench", "uwserver.commands"))
    done = CliRunner().invoke(cli.main, ["bench", "--help"])
    assert done.exit_code == 0
    assert "--against" in done.output


def test_a_listing_of_commands_loads_neither_physics_nor_benchmark() -> None:
    code = "import sys; from uwserver.cli import main; main(['--help'], standalone_mode=False); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "uwserver.cli" in loaded
    assert not loaded & {"uwserver_bench.engine.physics", "uwserver_bench.against.compare", "mujoco", "pybullet"}


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("launch", ' (did you mean "run"?); there are: run, check'),
        ("gui", ' (did you mean "run", with --open?); there are: run'),
        ("echo", ": `uwclient echo` prints the samples of a running server; there are: run"),
        ("chekc", ' (did you mean "check"?); there are: run'),
    ],
)
def test_an_unknown_command_is_answered_with_ours(word: str, hint: str) -> None:
    done = CliRunner().invoke(cli.main, [word])
    assert done.exit_code == 2
    assert f'no command "{word}"{hint}' in done.output
