"""The web view of `uwserver run`: when it is there, where, and what is said first. Also of uwserver.server.page."""

from __future__ import annotations

import threading
import webbrowser
from dataclasses import replace
from typing import Any

import click
import msgspec
import pytest

from uwserver.adapter import AdapterTable, Token, installed_adapters
from uwserver.cli.serving.run import _announce
from uwserver.cli.serving.web_view import open_page, with_view_token, with_web_view
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


@pytest.mark.parametrize(("opens", "said"), [(True, ""), (False, "yourself")])
def test_a_browser_that_cannot_be_opened_is_told(
    opens: bool, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or opens)
    thread = open_page("http://127.0.0.1:7680/")
    assert thread is not None
    thread.join(10.0)
    assert opened == ["http://127.0.0.1:7680/"]
    told = capsys.readouterr().err
    assert (said in told, bool(told)) == (True, not opens)
    assert open_page("") is None
    assert len(opened) == 1


def test_a_browser_that_keeps_us_waiting_holds_up_nothing(pool: Resolved, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = threading.Event()
    monkeypatch.setattr(webbrowser, "open", lambda address: ends.wait(10.0))
    thread = open_page("http://127.0.0.1:7680/")
    assert thread is not None
    assert (thread.is_alive(), thread.daemon) == (True, True)
    ends.set()
    thread.join(10.0)


def announced(resolved: Resolved, token: Token, capsys: pytest.CaptureFixture[str]) -> list[str]:
    addresses = {"tcp": "127.0.0.1:7600", "web": "http://127.0.0.1:7680/"}
    _announce(resolved, False, "", addresses, view="web", shown=token)
    return [click.unstyle(line) for line in capsys.readouterr().out.splitlines() if line]


def with_real_view(resolved: Resolved, bind: str | None = None, **table: Any) -> Resolved:
    """With the view of the distribution, and `tcp` bound to an address."""
    kinds = installed_adapters()
    adapters = {**resolved.scenario.adapters, "web": kinds["web"](required=False, **table)}
    if bind is not None:
        adapters["tcp"] = kinds["sockets"](bind=bind)
    return changed(resolved, adapters)


def test_a_token_that_pages_of_this_machine_need_is_in_the_address(
    pool: Resolved, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("UWSERVER_TOKEN", raising=False)
    opened: list[str] = []
    monkeypatch.setattr("uwserver.cli.serving.run.open_page", opened.append)
    plain = with_real_view(pool)
    assert with_view_token(plain, "web", True) == (plain, Token(None))
    assert with_view_token(changed(pool, {"web": View()}), "web", True)[1] == Token(None)
    watched, token = with_view_token(with_real_view(pool, view_token="peek"), "web", True)
    assert token.is_new
    assert watched.scenario.adapters["web"].token == token.text  # type: ignore[attr-defined]
    assert announced(watched, token, capsys)[0] == f"Open http://127.0.0.1:7680/#token={token.text}"
    assert with_view_token(with_real_view(pool, view_token="peek"), "web", False)[1] == Token(None)
    monkeypatch.setenv("UWSERVER_TOKEN", "a b")
    known, token = with_view_token(plain, "web", True)
    assert (known, token) == (plain, Token("a b"))
    first = announced(known, token, capsys)[0]
    assert first.startswith("Open http://127.0.0.1:7680/ (with #token=")
    assert "a b" not in first, "a secret of the user's own is not printed"
    _announce(known, True, "", {"web": "http://127.0.0.1:7680/"}, view="web", shown=token, opens=True)
    assert opened == ["http://127.0.0.1:7680/#token=a%20b"]


def test_an_address_that_others_cannot_reach_is_not_said_first(
    pool: Resolved, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = announced(with_real_view(pool, bind="0.0.0.0"), Token(None), capsys)
    assert alone[0].startswith("uwserver runs")
    (said,) = [line for line in alone if "7680" in line]
    assert "from this machine only" in said
    assert 'bind = "0.0.0.0"' in said
    for_all = with_real_view(pool)
    view = msgspec.structs.replace(for_all.scenario.adapters["web"], bind="0.0.0.0")  # type: ignore[call-arg]
    for_all = changed(for_all, {**for_all.scenario.adapters, "web": view})
    first = announced(for_all, Token("secret", True), capsys)[0]
    assert first.startswith("Open http://ADDRESS:7680/#token=secret, where ADDRESS is")
    assert first.endswith("on this machine http://127.0.0.1:7680/#token=secret")
