"""Colours come on terminals alone, and not against NO_COLOR; helps are whole; nothing about a rate that no person would type."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from uwserver.cli import main
from uwserver.cli.colour import coloured_problems, styled
from uwserver.logs import TerminalFormatter, set_up_logging

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
    tank.write_text(SCENARIO.replace("scanning_sonar", "sonar"))
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
