"""`uwserver run`: what it refuses before anything starts."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner

from uwserver.cli.run import _then_compile_the_rest, run
from uwserver.physics import builds
from uwserver.physics.kernel import compiled
from uwserver.physics.kernel.compiled import CacheState


@pytest.mark.parametrize("option", ["--until", "--speed"])
@pytest.mark.parametrize("value", ["nan", "inf", "-1", "soon"])
def test_times_and_speeds_that_are_none_are_refused(option, value):
    result = CliRunner().invoke(run, [option, value])
    assert result.exit_code == 2
    assert option in result.output


@pytest.mark.parametrize("rest", [("solids", "echoes"), ()])
def test_what_a_scenario_does_not_need_is_compiled_after_the_start_until_the_end(
    rest: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[object] = []
    monkeypatch.setattr(compiled, "cache_state", CacheState(tmp_path, False, ""))
    monkeypatch.setattr(builds, "missing", lambda stages: rest)
    monkeypatch.setattr(builds, "start", lambda stages, nice: told.append((stages, nice)) or "process")
    monkeypatch.setattr(builds, "stop", told.append)
    with ExitStack() as ending:
        announce = _then_compile_the_rest(told.append, ending)
        assert not told
        announce({"sockets": "here"})
        assert told == [{"sockets": "here"}, *([(rest, 19)] if rest else [])]
    assert told[1:] == ([(rest, 19), "process"] if rest else [])
