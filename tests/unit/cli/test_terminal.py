"""Options, colours and messages about faults."""

from __future__ import annotations

import errno
import logging
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from uwserver.cli import main
from uwserver.cli.terminal import coloured_problems, rotated, styled, told
from uwserver.logs import TerminalFormatter, set_up_logging
from uwserver.recording.parts import ONE_FILE, Rotation

GOT: list[Rotation] = []


@click.command()
@click.option("--record")
@rotated
def command(record: str | None, rotation: Rotation) -> None:
    GOT.append(rotation)


@pytest.mark.parametrize(
    ("args", "rotation"),
    [
        (("--record", "x"), ONE_FILE),
        ((), ONE_FILE),
        (("--record", "x", "--record-rotate-mb", "1.5"), Rotation(1_500_000)),
        (("--record", "x", "--record-rotate-s", "60"), Rotation(0, 60.0)),
    ],
)
def test_a_recording_goes_on_when_it_is_told(args: tuple[str, ...], rotation: Rotation):
    GOT.clear()
    assert CliRunner().invoke(command, args).exit_code == 0
    assert [rotation] == GOT


def test_without_a_recording_there_is_nothing_to_rotate():
    done = CliRunner().invoke(command, ["--record-rotate-s", "60"])
    assert (done.exit_code, "need --record FILE" in done.output) == (2, True)


@pytest.mark.parametrize(("size", "seconds", "due"), [(99, 9.9, False), (100, 0.0, True), (0, 10.0, True)])
def test_whatever_comes_first_ends_a_part(size: int, seconds: float, due: bool):
    assert Rotation(100, 10.0).is_due(size, seconds) == due
    assert not ONE_FILE.is_due(10**12, 1e9)
    assert not ONE_FILE


SCENARIO = (
    'schema = 1\n[vehicles.rov]\nmodel = "bluerov2"\nposition_ned_m = [0, 0, -5]\n'
    '[vehicles.rov.sensors.eye]\nkind = "scanning_sonar"\nprofile = "ping360"\nrate_hz = 7\n'
)


@pytest.fixture
def tank(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "tank.toml"
    path.write_text(SCENARIO)
    return path


def test_faults_are_red_and_warnings_yellow_on_a_terminal(tank, monkeypatch):
    text = tank.read_text().replace("rate_hz = 7", "rate_hz = 8")
    tank.write_text(text)
    shown = CliRunner().invoke(main, ["check", "tank.toml"], color=True).output
    assert (
        "\x1b[33mtank.toml:4:25:\x1b[0m vehicles.rov.position_ned_m[2]: warning: it starts 5 m above the water" in shown
    )
    assert "\x1b[32mok\x1b[0m: tank.toml" in shown
    tank.write_text(SCENARIO)
    assert "\x1b[31mtank.toml:8:1:\x1b[0m" in CliRunner().invoke(main, ["check", "tank.toml"], color=True).output
    assert "\x1b" not in CliRunner().invoke(main, ["check", "tank.toml"]).output
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in CliRunner().invoke(main, ["check", "tank.toml"], color=True).output
    assert styled("x", fg="red") == "x"


def test_lines_without_a_place_stay_as_they_are(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    text = "a.toml:1:2: x: warning: y\nb.toml: no\n2 errors"
    assert coloured_problems(text) == text


def test_rates_that_are_proposed_are_whole_numbers(tank):
    assert "the nearest rates that do are 6 and 8" in CliRunner().invoke(main, ["check", "tank.toml"]).output


def test_a_kind_is_found_by_one_of_its_words(tank):
    tank.write_text(SCENARIO.replace("scanning_sonar", "scanning"))
    assert 'did you mean "scanning_sonar"?' in CliRunner().invoke(main, ["check", "tank.toml"]).output


def test_no_short_help_is_cut():
    lines = CliRunner().invoke(main, ["--help"], terminal_width=80).output.splitlines()
    commands = lines[lines.index("Commands:") + 1 :]
    assert len(commands) >= 10
    assert not [line for line in commands if line.endswith("...") or "  " not in line.strip()]


def test_log_lines_on_a_terminal_are_short_and_stand_back(monkeypatch):
    record = logging.LogRecord("uwserver.x", logging.INFO, "", 0, "all %s", ("well",), None)
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert TerminalFormatter().format(record).startswith("\x1b[2m")
    warning = logging.LogRecord("uwserver.x", logging.WARNING, "", 0, "late", (), None)
    assert TerminalFormatter().format(warning).endswith(" warning: late\x1b[0m")
    monkeypatch.setenv("NO_COLOR", "1")
    assert TerminalFormatter().format(record)[8:] == " all well"


def test_log_lines_in_a_file_keep_their_logger(monkeypatch, capsys):
    before = logging.getLogger().handlers[:]
    try:
        for is_terminal, words in ((True, " ready\n"), (False, " INFO uwserver.x: ready\n")):
            monkeypatch.setattr(sys.stderr, "isatty", lambda told=is_terminal: told, raising=False)
            monkeypatch.setenv("NO_COLOR", "1")
            set_up_logging("info", as_json=False)
            logging.getLogger("uwserver.x").info("ready")
            line = capsys.readouterr().err
            assert line.endswith(words)
            assert ("uwserver.x" in line) is not is_terminal
    finally:
        logging.getLogger().handlers[:] = before


class BadFile(Exception):
    """A fault whose text is for the user."""


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (BadFile("line 3: no number"), "line 3: no number"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "b.mcap"), "b.mcap: No such file or directory"),
        (OSError(errno.ENOSPC, "No space left on device"), "a.mcap: No space left on device"),
        (FileExistsError("a.mcap: it exists already"), "a.mcap: it exists already"),
    ],
)
def test_a_fault_is_a_message_that_names_the_file(error: Exception, message: str) -> None:
    with pytest.raises(click.ClickException) as caught, told("a.mcap", BadFile):
        raise error
    assert (caught.value.message, caught.value.exit_code) == (message, 1)
    assert caught.value.__cause__ is error


def test_text_and_status_may_be_others() -> None:
    with pytest.raises(click.ClickException) as caught, told("a", BadFile, text=lambda error: f"{error}!", status=2):
        raise BadFile("no")
    assert (caught.value.message, caught.value.exit_code) == ("no!", 2)


def test_other_errors_pass() -> None:
    with pytest.raises(KeyError), told("a", BadFile):
        raise KeyError("x")
