"""The web view of `uwserver run`: there by default, and never what a server fails by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click
import msgspec

if TYPE_CHECKING:
    from uwserver.scenario.load.resolved import Resolved

KIND = "web"


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


def open_page(address: str) -> None:
    """Show a page in the browser of this desktop, or say that it cannot be."""
    if not address:
        click.echo("uwserver: there is no web view to open", err=True)
    elif click.launch(address):
        click.echo(f"uwserver: no browser could be opened here: open {address} yourself", err=True)
