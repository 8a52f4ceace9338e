"""The web view of `uwserver run`: it is served by default, and a server never fails because of it."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import click
import msgspec

from uwserver.adapter import Token, is_loopback, known_token, token_for
from uwserver.cli.loading import with_adapter
from uwserver.cli.terminal import styled
from uwserver.server.page import open_in_browser, with_token

if TYPE_CHECKING:
    from uwserver.scenario.load.resolved import Resolved

KIND = "web"
_ALL = ("0.0.0.0", "::")


def with_web_view(resolved: Resolved, adapters: Mapping[str, type[Any]], port: int | None) -> tuple[Resolved, str]:
    """Return the scenario with a web view, and the name of the view's adapter; "" if it has none.

    Args:
        resolved: the scenario.
        adapters: configuration types of the installed adapters by kind.
        port: option of the command line. 0 takes a free port for the web view too; any other port is that of another adapter.
    """
    given: Mapping[str, Any] = resolved.scenario.adapters
    name = next((name for name, config in given.items() if config.__struct_config__.tag == KIND), "")
    if name:
        config = given[name]
    else:
        name = KIND if KIND not in given else f"{KIND}_view"
        if not resolved.scenario.server.web or KIND not in adapters or name in given:
            return resolved, ""
        config = adapters[KIND](required=False)
    if port == 0:
        config = msgspec.structs.replace(config, port=0)
    return with_adapter(resolved, name, config), name


def with_view_token(resolved: Resolved, name: str, makes: bool) -> tuple[Resolved, Token]:
    """Return the scenario with the token that its web view would make itself, so that the printed address can hold it.

    Args:
        resolved: the scenario.
        name: name of the view's adapter; "" for no view.
        makes: whether a token may be made here.
    """
    config: Any = resolved.scenario.adapters.get(name)
    if not hasattr(config, "needs_token"):
        return resolved, Token(None)
    token = token_for(known_token(config.token), makes and config.needs_token)
    if not token.is_new:
        return resolved, token
    return with_adapter(resolved, name, msgspec.structs.replace(config, token=token.text)), token


def address_lines(resolved: Resolved, name: str, address: str, token: Token | None) -> tuple[str, str]:
    """Return what to print about the page before anything else, and what to print after the other addresses; "" for nothing.

    Args:
        resolved: the scenario.
        name: name of the view's adapter.
        address: address of the page on this machine; "" for no page.
        token: the token that the page needs; None for none.
    """
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
            f"Open {everywhere}{known}, where ADDRESS is an address of this machine,"
            f" or of its host if this is a container with a published port; on this machine {page}"
        ), ""
    if not is_loopback(bind) or all(is_loopback(_bind(config)) for config in adapters.values()):
        return "Open " + styled(page, fg="cyan", bold=True) + known, ""
    # Other adapters are open to the network, so this is likely a container or a machine without a screen, where nobody can open this page.
    return "", (
        f"The web view at {page}{known} can be reached from this machine only, and in a container not at all. To reach it from elsewhere, give it "
        f'an address in the scenario and publish its port: [adapters.{name}] kind = "{KIND}", bind = "0.0.0.0"'
    )


def _bind(config: Any) -> str:
    return str(getattr(config, "bind", "127.0.0.1"))


def open_page(address: str) -> threading.Thread | None:
    """Open a page in the browser of this desktop, or print that there is none.

    Returns:
        The thread that opens it, because a browser in a terminal runs until its user ends it, and some take seconds to answer.
    """
    if not address:
        click.echo("uwserver: there is no web view to open", err=True)
        return None
    return open_in_browser(address, _not_opened)


def _not_opened(address: str) -> None:
    click.echo(f"uwserver: no browser could be opened here: open {address} yourself", err=True)
