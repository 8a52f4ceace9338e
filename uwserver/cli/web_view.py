"""The web view of `uwserver run`: there by default, and never what a server fails by."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlsplit

import click
import msgspec

from uwserver.cli.colour import styled

if TYPE_CHECKING:
    from uwserver.adapter import Token
    from uwserver.scenario.load.resolved import Resolved

KIND = "web"
_ALL = ("0.0.0.0", "::")


def with_web_view(resolved: Resolved, adapters: Mapping[str, type[Any]], port: int | None) -> tuple[Resolved, str]:
    """The scenario with a web view, and the name of its adapter; "" where it has none.

    Args:
        resolved: of the scenario.
        adapters: configuration types by kind, of those that are installed.
        port: of the command line: 0 takes a free one for the web view too; any other is that of another adapter.
    """
    given = resolved.scenario.adapters
    name = next((name for name, config in given.items() if config.__struct_config__.tag == KIND), "")
    if not name:
        if not resolved.scenario.server.web or KIND not in adapters:
            return resolved, ""
        name = KIND if KIND not in given else f"{KIND}_view"
        if name in given:
            return resolved, ""
        config = adapters[KIND](required=False)
    else:
        config = given[name]
    if port == 0:
        config = msgspec.structs.replace(config, port=0)
    scenario = msgspec.structs.replace(resolved.scenario, adapters={**given, name: config})
    return replace(resolved, scenario=scenario), name


def with_view_token(resolved: Resolved, name: str, makes: bool) -> tuple[Resolved, Token]:
    """The scenario with the token that its web view would make itself, so that the printed address holds it.

    Args:
        resolved: of the scenario.
        name: of the adapter; "" for no view.
        makes: otherwise none is made here.
    """
    from uwserver.adapter import Token, known_token, token_for

    config: Any = resolved.scenario.adapters.get(name)
    if not hasattr(config, "needs_token"):
        return resolved, Token(None)
    token = token_for(known_token(config.token), makes and config.needs_token)
    if not token.is_new:
        return resolved, token
    adapters = {**resolved.scenario.adapters, name: msgspec.structs.replace(config, token=token.text)}
    return replace(resolved, scenario=msgspec.structs.replace(resolved.scenario, adapters=adapters)), token


def where_to_look(resolved: Resolved, name: str, address: str, token: Token | None) -> tuple[str, str]:
    """What is said of the page before all else, and what after the other addresses; "" for nothing.

    Args:
        resolved: of the scenario.
        name: of the view's adapter.
        address: of the page, on this machine; "" where there is none.
        token: that it needs; None for none.
    """
    from uwserver.adapter import is_loopback

    if not address:
        return "", ""
    shown, is_new = token or (None, False)
    page = with_token(address, shown if is_new else None)
    known = " (with #token= and the server's token behind it)" if shown and not is_new else ""
    adapters = resolved.scenario.adapters
    bind = _bind(adapters.get(name))
    if bind in _ALL:
        host = urlsplit(address).netloc.rpartition(":")[0]
        everywhere = styled(page.replace(host, "ADDRESS", 1), fg="cyan", bold=True)
        return (
            f"Open {everywhere}{known}, where ADDRESS is one of this machine,"
            f" or of its host where this is a container with a published port; on this machine {page}"
        ), ""
    if not is_loopback(bind) or all(is_loopback(_bind(config)) for config in adapters.values()):
        return "Open " + styled(page, fg="cyan", bold=True) + known, ""
    # Likely a container, or a machine without a screen: nobody there could open an address of its own.
    return "", (
        f"The web view is at {page}{known} for this machine alone; in a container, for nobody. To reach it from elsewhere give it "
        f'an address in the scenario, and publish its port: [adapters.{name}] kind = "{KIND}", bind = "0.0.0.0"'
    )


def _bind(config: Any) -> str:
    return str(getattr(config, "bind", "127.0.0.1"))


def with_token(address: str, token: str | None) -> str:
    """The address by which a page comes with its token, which browsers send to nobody."""
    return f"{address}#token={quote(token, safe='')}" if address and token else address


def open_page(address: str) -> threading.Thread | None:
    """Show a page in the browser of this desktop, or say that it cannot be.

    Returns the thread that does it: a browser of a terminal ends only when its user ends it, and some take seconds to answer.
    """
    if not address:
        click.echo("uwserver: there is no web view to open", err=True)
        return None
    thread = threading.Thread(target=_open, args=(address,), name="browser", daemon=True)
    thread.start()
    return thread


def _open(address: str) -> None:
    import webbrowser

    if not webbrowser.open(address):
        click.echo(f"uwserver: no browser could be opened here: open {address} yourself", err=True)
