"""The server of one page: nothing else of the scenario listens, nobody else may look, and it ends with who started it."""

from __future__ import annotations

import http.client
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import pytest

from uwserver.adapter import installed_adapters
from uwserver.cli.browser.child import child
from uwserver.cli.browser.lone_view import ViewFailed, _main, lone_view, seen_alone
from uwserver.scenario.load.scenario import load

PATIENCE_S = 120.0


def test_of_the_scenario_s_adapters_none_is_left() -> None:
    adapters = installed_adapters()
    resolved = load("one_of_everything", adapters=adapters)
    alone = seen_alone(resolved, adapters, "secret")
    (view,) = alone.scenario.adapters.values()
    assert (view.bind, view.port, view.token, view.required) == ("127.0.0.1", 0, "secret", True)
    assert resolved.scenario.server.metrics
    assert not alone.scenario.server.metrics
    assert alone.vehicles is resolved.vehicles


def test_its_world_is_shown_to_who_has_the_token_alone_and_ends_with_its_standard_input(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    started: list[subprocess.Popen[str]] = []

    @contextmanager
    def watched(*given: Any, **options: Any) -> Iterator[subprocess.Popen[str]]:
        with child(*given, **options) as process:
            started.append(process)
            yield process

    monkeypatch.setattr("uwserver.cli.browser.lone_view.child", watched)
    with lone_view("bluerov2_pool", seed=3) as address:
        parts = urlsplit(address)
        assert parts.hostname == "127.0.0.1"
        token = parts.fragment.removeprefix("token=")
        for headers, status in (({}, 401), ({"Authorization": f"Bearer {token}"}, 200)):
            connection = http.client.HTTPConnection(parts.hostname, parts.port or 0, timeout=PATIENCE_S)
            connection.request("GET", "/world.json", headers=headers)
            assert connection.getresponse().status == status
            connection.close()
        (process,) = started
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(PATIENCE_S) == 0


def test_one_that_does_not_start_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The process says why, and who started it that there is no address."""
    with monkeypatch.context() as patched:
        patched.setattr("uwserver.logs.set_up_logging", lambda *given: None)
        patched.setattr("uwserver.server.process.end_undisturbed", lambda: None)
        assert _main("no_such_scenario") == 1
    assert capsys.readouterr().err.startswith('uwserver: no_such_scenario: unknown scenario "no_such_scenario"')
    monkeypatch.setattr(sys, "executable", "false")
    with pytest.raises(ViewFailed, match="ended before"), lone_view("no_such_scenario"):
        pass
