"""The web view of `uwserver run`: when it is there, where, and what is said first."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click
import msgspec
import pytest

from uwserver.adapter import AdapterTable, installed_adapters
from uwserver.cli.run import _announce
from uwserver.cli.web_view import open_page, with_web_view
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load


class View(AdapterTable, tag="web", kw_only=True, frozen=True):
    """Of a view."""

    port: int = 7680


class Other(AdapterTable, tag="other", kw_only=True, frozen=True):
    """Of something else."""


INSTALLED: dict[str, type[Any]] = {"web": View}


@pytest.fixture(scope="module")
def pool() -> Resolved:
    return load("bluerov2_pool", adapters=installed_adapters())


def changed(resolved: Resolved, adapters: dict[str, Any], **server: Any) -> Resolved:
    table = msgspec.structs.replace(resolved.scenario.server, **server)
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, adapters=adapters, server=table))


def test_it_is_there_unless_the_scenario_says_no(pool: Resolved) -> None:
    shown, name = with_web_view(pool, INSTALLED, None)
    assert name == "web"
    assert shown.scenario.adapters["web"] == View(required=False)
    assert [*shown.scenario.adapters][:-1] == [*pool.scenario.adapters]
    assert "web" not in pool.scenario.adapters
    for hidden in (changed(pool, {}, web=False), replace(pool)):
        kinds = INSTALLED if hidden is not pool and not hidden.scenario.server.web else {}
        assert with_web_view(hidden, kinds, None) == (hidden, "")


def test_one_of_the_scenarios_own_is_left_as_it_is(pool: Resolved) -> None:
    own = changed(pool, {"bridge": View(port=9, required=True)}, web=False)
    assert with_web_view(own, INSTALLED, None) == (own, "bridge")
    free, name = with_web_view(own, INSTALLED, 0)
    assert (free.scenario.adapters, name) == ({"bridge": View(port=0, required=True)}, "bridge")


def test_a_name_that_is_taken_is_left_to_who_has_it(pool: Resolved) -> None:
    shown, name = with_web_view(changed(pool, {"web": Other()}), INSTALLED, None)
    assert (name, shown.scenario.adapters["web"]) == ("web_view", Other())


@pytest.mark.parametrize(("given", "port"), [(None, 7680), (0, 0), (7601, 7680)])
def test_a_free_port_of_the_command_line_is_for_it_too(pool: Resolved, given: int | None, port: int) -> None:
    shown, name = with_web_view(pool, INSTALLED, given)
    assert shown.scenario.adapters[name].port == port


def test_the_page_is_said_first(pool: Resolved, capsys: pytest.CaptureFixture[str]) -> None:
    addresses = {"tcp": "127.0.0.1:7600", "web": "http://127.0.0.1:7680/"}
    _announce(pool, False, "", addresses, view="web")
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    assert click.unstyle(lines[0]) == "Open http://127.0.0.1:7680/"
    assert "uwserver runs bluerov2_pool" in lines[1]
    assert not any("web:" in line for line in lines)


def test_without_a_page_nothing_is_said_of_one(pool: Resolved, capsys: pytest.CaptureFixture[str]) -> None:
    _announce(pool, False, "", {"tcp": "127.0.0.1:7600", "web": ""}, view="web")
    assert "Open" not in capsys.readouterr().out


@pytest.mark.parametrize(("status", "said"), [(0, ""), (1, "yourself")])
def test_a_browser_that_cannot_be_opened_is_told(
    status: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(click, "launch", lambda address: opened.append(address) or status)
    open_page("http://127.0.0.1:7680/")
    assert opened == ["http://127.0.0.1:7680/"]
    told = capsys.readouterr().err
    assert (said in told, bool(told)) == (True, bool(status))
    open_page("")
    assert len(opened) == 1
