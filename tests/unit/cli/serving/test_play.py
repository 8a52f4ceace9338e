"""The command line of playback: what it refuses, and which adapters of a recording it serves."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner
from playback_rig import Dive, recorded
from served_rig import dive, served

from uwserver.adapter import installed_adapters
from uwserver.cli.serving import play as module
from uwserver.cli.serving.play import _opened, _renames, play
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--speed", "0"], "0.0 is not in the range"),
        (["--speed", "fast"], 'is not a valid float range. Or say "max".'),
        (["--map", "rov"], "--map takes OLD=NEW"),
        (["--map", "rov/imu=x"], "--map takes OLD=NEW"),
        (["--map", "auv=x"], 'no body has the name "auv"; there are: rov'),
        (["--from", "9"], "there is nothing from 9 s on"),
        (["--from", "0.2", "--to", "0.1"], "the range from 0.2 to 0.1 s is empty"),
    ],
)
def test_what_cannot_be_is_refused_at_once(tmp_path: Path, arguments: list[str], text: str) -> None:
    recorded(tmp_path / "x.mcap", ticks=60)
    result = CliRunner().invoke(play, [str(tmp_path / "x.mcap"), *arguments])
    assert result.exit_code != 0
    assert text in result.output


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (None, "No such file"),
        (b"x", "unknown format, the file begins with"),
        (b"\x89MCAP0\r\n", "not one whole record"),
    ],
)
def test_other_files_are_told(tmp_path: Path, data: bytes | None, text: str) -> None:
    path = tmp_path / "x.mcap"
    if data is not None:
        path.write_bytes(data)
    result = CliRunner().invoke(play, [str(path)])
    assert result.exit_code == 1
    assert text in result.output


def test_speed_max_and_options_reach_the_player(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded(tmp_path / "x.mcap", ticks=60)
    given: list[Any] = []

    def serve(*args: Any) -> int:
        given.extend(args)
        args[0].close()
        return 0

    monkeypatch.setattr(module, "_serve", serve)
    monkeypatch.setattr("uwserver.server.process.end_undisturbed", lambda: None)
    options = ["--speed", "max", "--loop", "--paused", "--from", "0.1", "--map", "rov=ghost", "--port", "0"]
    result = CliRunner().invoke(play, [str(tmp_path / "x.mcap"), *options])
    assert result.exit_code == 0, result.output
    track, timing, span, address, chosen, opens = given
    assert (timing.mode, timing.paused) == ("freerun", True)
    assert (span.from_s, span.to_s, span.loops) == (0.1, None, True)
    assert track.scenes[0].bodies[0].name == "ghost"
    assert (address, chosen, opens) == ((0, None), (), False)


def test_an_adapter_that_is_not_there_is_told(tmp_path: Path) -> None:
    recorded(tmp_path / "x.mcap", ticks=60)
    result = CliRunner().invoke(play, [str(tmp_path / "x.mcap"), "--adapter", "zen"])
    assert result.exit_code == 1
    assert 'x.mcap: the recording has no adapter "zen"; there are: none' in result.output


def test_a_busy_port_is_told_with_the_option_that_helps(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        busy = other.getsockname()[1]
        adapters = {"tcp": {"kind": "sockets", "port": busy}}
        server = {"web": False, "metrics_port": 0}
        raw = {"schema": 1, "vehicles": {"rov": {"model": "bluerov2_heavy"}}, "adapters": adapters, "server": server}
        scenario = msgspec.convert(raw, Scenario)
        with Dive(tmp_path / "x.mcap", load(scenario, adapters=installed_adapters())) as dive:
            dive.go(60)
        result = CliRunner().invoke(play, [str(tmp_path / "x.mcap")])
    assert result.exit_code == 1
    told = result.output.splitlines()[-1]
    assert f"port {busy} is in use" in told
    assert "x.mcap --port 0` takes free ports for all" in told
    assert "give this adapter" not in told


def test_what_was_recorded_from_outside_is_opened(tmp_path: Path) -> None:
    path = served(tmp_path / "a.mcap", dive())
    track = _opened(path, {}, None, tmp_path)
    track.close()
    assert track.path == path
    assert "its scenario is not in it" in track.remarks[0]
    assert "rov/modem" in track.scenes[0].ports


def test_names_are_pairs() -> None:
    assert _renames(("a=b", "c=d")) == {"a": "b", "c": "d"}
