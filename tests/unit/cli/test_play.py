"""The command line of playback: what it refuses, and which adapters of a recording it serves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner
from playback_rig import pool, recorded

from uwserver.adapter import AdapterTable, installed_adapters
from uwserver.cli import play as module
from uwserver.cli.play import _renames, _with_adapters, play


def with_adapters(**tables: dict[str, Any]) -> Any:
    resolved = pool()
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, adapters=tables))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--speed", "0"], "0.0 is not in the range"),
        (["--speed", "fast"], "is not a valid float"),
        (["--map", "rov"], "--map takes OLD=NEW"),
        (["--map", "rov/imu=x"], "--map takes OLD=NEW"),
        (["--map", "auv=x"], 'nobody is called "auv"; there are: rov'),
        (["--from", "9"], "there is nothing from 9 s on"),
        (["--from", "0.2", "--to", "0.1"], "nothing lies between"),
    ],
)
def test_what_cannot_be_is_refused_at_once(tmp_path: Path, arguments: list[str], text: str) -> None:
    recorded(tmp_path / "x.mcap", ticks=60)
    result = CliRunner().invoke(play, [str(tmp_path / "x.mcap"), *arguments])
    assert result.exit_code != 0
    assert text in result.output


@pytest.mark.parametrize(
    ("data", "text"),
    [(None, "No such file"), (b"x", "as no log does that is read here"), (b"\x89MCAP0\r\n", "not one whole record")],
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
    monkeypatch.setattr("uwserver.server.signals.end_undisturbed", lambda: None)
    options = ["--speed", "max", "--loop", "--paused", "--from", "0.1", "--map", "rov=ghost", "--port", "0"]
    result = CliRunner().invoke(play, [str(tmp_path / "x.mcap"), *options])
    assert result.exit_code == 0, result.output
    track, timing, span, address, opens = given
    assert (timing.mode, timing.paused) == ("freerun", True)
    assert (span.from_s, span.to_s, span.loops) == (0.1, None, True)
    assert track.scenes[0].bodies[0].name == "ghost"
    assert (address, opens) == ((0, None), False)


def test_adapters_of_a_recording_are_served_but_those_that_name_files_or_set_the_pace(
    caplog: pytest.LogCaptureFixture,
) -> None:
    known = installed_adapters()
    clock = msgspec.structs.replace(pool().scenario.world.clock, mode="lockstep", lockstep_clients=("sub",))
    resolved = with_adapters(
        tcp={"kind": "sockets", "port": 7811}, tls={"kind": "sockets", "tls_cert": "/etc/passwd"},
        odd={"kind": "of_an_extension"}, bad={"kind": "sockets", "port": "x"}, sub={"kind": "ardusub"}, none=3,
    )  # fmt: skip
    scenario = resolved.scenario
    world = msgspec.structs.replace(scenario.world, clock=clock)
    resolved = replace(resolved, scenario=msgspec.structs.replace(scenario, world=world))
    kept = _with_adapters(resolved, known, None).scenario.adapters
    assert list(kept) == ["tcp"]
    assert isinstance(kept["tcp"], AdapterTable)
    assert kept["tcp"].port == 7811  # type: ignore[attr-defined]
    text = caplog.text
    for name in ("tls", "odd", "bad", "sub", "none"):
        assert f'adapter "{name}" of the recording is left out' in text
    assert "names files or devices (tls_cert)" in text


def test_without_adapters_it_is_served_by_sockets() -> None:
    kept = _with_adapters(with_adapters(), installed_adapters(), 0).scenario.adapters
    assert list(kept) == ["sockets"]
    assert kept["sockets"].port == 0


def test_names_are_pairs() -> None:
    assert _renames(("a=b", "c=d")) == {"a": "b", "c": "d"}
