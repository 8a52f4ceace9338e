"""`uwserver run`: what it refuses before anything starts."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner

from uwserver.adapter import installed_adapters
from uwserver.cli.serving.run import _announce, _then_compile_the_rest, _with_new_token, run, with_address
from uwserver.physics.kernel import compiled
from uwserver.physics.kernel.compiled import CacheState
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load
from uwserver.server.life_cycle import Options
from uwserver.world import builds


@pytest.mark.parametrize("option", ["--until", "--speed", "--profile"])
@pytest.mark.parametrize("value", ["nan", "inf", "-1", "soon"])
def test_times_and_speeds_that_are_none_are_refused(option, value):
    result = CliRunner().invoke(run, [option, value])
    assert result.exit_code == 2
    assert option in result.output


@pytest.mark.parametrize("no_foxglove", [False, True])
def test_what_is_asked_for_is_what_the_server_is_told(
    no_foxglove: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Options] = []
    monkeypatch.setattr("uwserver.cli.serving.run._run_loop", lambda resolved, options: told.append(options) or 0)
    monkeypatch.setattr("uwserver.logs.set_up_logging", lambda *given: None)
    monkeypatch.setattr("uwserver.server.process.end_undisturbed", lambda: None)
    given = [
        "bluerov2_open_sea",
        "--mode",
        "freerun",
        "--until",
        "5",
        "--seed",
        "8",
        "--record",
        str(tmp_path / "a.mcap"),
    ]
    done = CliRunner().invoke(run, [*given, *(["--no-foxglove"] if no_foxglove else [])])
    assert done.exit_code == 0, done.output
    (options,) = told
    assert options.timing is not None
    assert options.timing.mode == "freerun"
    assert (options.until_s, options.seed, options.record) == (5.0, 8, tmp_path / "a.mcap")
    assert options.foxglove is not no_foxglove


@pytest.mark.parametrize("rest", [("solids", "echoes"), ()])
def test_what_a_scenario_does_not_need_is_compiled_after_the_start_until_the_end(
    rest: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[object] = []
    monkeypatch.setattr(compiled, "cache_state", CacheState(tmp_path, ""))
    monkeypatch.setattr(builds, "missing", lambda stages: rest)
    monkeypatch.setattr(builds, "start", lambda stages, nice: told.append((stages, nice)) or "process")
    monkeypatch.setattr(builds, "stop", told.append)
    with ExitStack() as ending:
        announce = _then_compile_the_rest(told.append, ending)
        assert not told
        announce({"sockets": "here"})
        assert told == [{"sockets": "here"}, *([(rest, 19)] if rest else [])]
    assert told[1:] == ([(rest, 19), "process"] if rest else [])


def opened(bind: str) -> Resolved:
    return with_address(load("bluerov2_pool", adapters=installed_adapters()), 7701, bind, ())


def commands(text: str) -> list[str]:
    """The lines to type."""
    return [line.strip() for line in text.splitlines() if "uwclient" in line]


def test_what_to_type_next_holds_the_token_that_was_made(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)
    resolved, token = _with_new_token(opened("0.0.0.0"))
    assert len(token) >= 32
    assert token.isalnum()  # so that no option of a command line begins with it
    assert [config.token for config in resolved.scenario.adapters.values()] == [token]
    _announce(resolved, False, token, {"tcp": "0.0.0.0:7701"})
    lines = commands(capsys.readouterr().out)
    assert len(lines) == 3
    assert all(f"--port 7701 --token {token} " in line for line in lines)


@pytest.mark.parametrize(("bind", "variable"), [("127.0.0.1", ""), ("0.0.0.0", "chosen"), ("127.0.0.1", "chosen")])
def test_no_token_is_made_where_none_is_needed_and_one_that_was_chosen_is_not_printed(
    bind: str, variable: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UWSERVER_TOKEN", variable)
    given = opened(bind)
    resolved, token = _with_new_token(given)
    assert (resolved, token) == (given, "")
    _announce(resolved, False, token, {"tcp": f"{bind}:7701"})
    said = capsys.readouterr().out
    assert "--token" not in said
    assert "chosen" not in said
    assert ("with UWSERVER_TOKEN set" in said) == bool(variable)
