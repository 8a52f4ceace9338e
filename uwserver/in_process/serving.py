"""What a program gets that serves its world: the page of the web view, or any other adapter."""

from __future__ import annotations

import html
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import msgspec

from uwserver.adapter import installed_adapters, known_token, new_token
from uwserver.ports import Refused
from uwserver.scenario.load.adapters import adapters_of
from uwserver.scenario.load.resolved import Resolved
from uwserver.server.hosted import Hosted
from uwserver.server.life_cycle import timing_of
from uwserver.server.page import open_in_browser, with_token
from uwserver.simulation.clock import Timing

PAGE = "web"
"""Kind, and default name, of the adapter of the web view."""
_DEFAULT = "sockets"


class Serving:
    """Adapters that serve a world while its program steps it, as `World.view` and `World.serve` start them.

    Clients hear the samples of each `step`, and their commands and calls are carried out in `step`, between two ticks, in the program's
    thread: nothing in the world changes while the program does something else. `sync` does what they have asked for without a tick.

    The adapters run in one thread beside the program's, named "uwserver clients". It ends, and all ports are free again, when the last
    adapter is closed, by `close` or the end of a ``with`` block; with the world (`World.close`, or when nothing refers to it any more); at
    the end of the process; or when a client calls ``world/shutdown``.
    """

    def __init__(self, hosted: Hosted, addresses: Mapping[str, str], token: str, sync: Callable[[], None]) -> None:
        """Take running adapters; `World.serve` calls this."""
        self._hosted, self._sync = hosted, sync
        self._addresses, self._token = dict(addresses), token

    @property
    def addresses(self) -> Mapping[str, str]:
        """Where clients find each adapter, by its name."""
        return MappingProxyType(self._addresses)

    @property
    def address(self) -> str:
        """Where clients find the first adapter: ``127.0.0.1:40123``, or the address of the page, with its token if it needs one."""
        return with_token(next(iter(self._addresses.values()), ""), self._token)

    @property
    def clients(self) -> int:
        """How many clients, or pages, are connected at present."""
        return self._hosted.peers(self._addresses)

    def is_running(self) -> bool:
        """Whether clients are served: ``while view.is_running(): world.step(24)``."""
        return self._hosted.has(self._addresses)

    def sync(self) -> None:
        """Do what clients have asked for, without a tick, and show them the world as it is now. `step` does this too."""
        if self.is_running():
            self._sync()

    def close(self) -> None:
        """End these adapters; when it returns, their ports are free. The world goes on. May be called again."""
        self._hosted.end(self._addresses)

    def __enter__(self) -> Serving:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{', '.join(self._lines())}>" if self.is_running() else "<closed>"

    def _repr_html_(self) -> str:
        if not self.is_running():
            return "closed"
        return "<br>".join(
            f'<a href="{html.escape(line)}" target="_blank">{html.escape(line)}</a>' if line.startswith("http") else html.escape(line)
            for line in self._lines()
        )  # fmt: skip

    def _lines(self) -> list[str]:
        return [
            with_token(address, self._token) if address.startswith("http") else f"{name}: {address}"
            for name, address in self._addresses.items()
        ]


def wanted_tables(
    resolved: Resolved, adapters: str | Sequence[str] | Mapping[str, Any] | None, port: int
) -> tuple[dict[str, Any], bool]:
    """Return the tables of the adapters that a program asks for, by name, and whether they are the scenario's.

    Args:
        resolved: the scenario; its table of an adapter is taken for its name.
        adapters: kinds, or names of the scenario's, or tables by name; None for the scenario's, or `sockets`.
        port: port of an adapter `sockets` for which no other is asked.

    Raises:
        Refused: it is something else, or no adapter.
    """
    own: Mapping[str, Any] = resolved.scenario.adapters
    if adapters is None:
        adapters = [*own] or [_DEFAULT]
    if isinstance(adapters, str):
        adapters = [adapters]
    if isinstance(adapters, Mapping):
        tables = dict(adapters)
    elif isinstance(adapters, Sequence) and all(isinstance(name, str) for name in adapters):
        tables = {name: own.get(name, {"kind": name}) for name in adapters}
    else:
        raise Refused(
            "bad_argument",
            f'"adapters" must be names, or tables by name ({{"sockets": {{"kind": "sockets"}}}}), not {adapters!r}',
            "adapters",
        )
    if not tables:
        raise Refused("bad_argument", '"adapters" names none', "adapters")
    for name, table in tables.items():
        if isinstance(table, Mapping) and table.get("kind") == _DEFAULT and "port" not in table:
            tables[name] = {**table, "port": port}
        elif isinstance(table, msgspec.Struct) and table.__struct_config__.tag == _DEFAULT:
            tables[name] = msgspec.structs.replace(table, port=port)
    return tables, any(name in own for name in tables)


def configured(resolved: Resolved, tables: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Return the configuration of each adapter, and the token that the page among them needs; "" for none.

    All of them are required, so that one that cannot start is told at once.

    Raises:
        ScenarioError: tables have faults, or packages are missing.
    """
    configs, token = adapters_of(tables, installed_adapters(), resolved.scenario), ""
    for name, config in configs.items():
        changes: dict[str, Any] = {"required": True} if hasattr(config, "required") else {}
        if config.__struct_config__.tag == PAGE and config.needs_token:
            token = known_token(config.token) or new_token()
            changes["token"] = token
        configs[name] = msgspec.structs.replace(config, **changes)
    return configs, token


def hosting_time(resolved: Resolved, speed: float | None, is_whole: bool) -> Timing:
    """Return how the ticks of a world follow wall time while clients are served.

    Args:
        resolved: the scenario.
        speed: simulated seconds per second of wall time; None for as fast as the program steps.
        is_whole: whether adapters of the scenario serve it: then lockstep holds, if the scenario has that.

    Raises:
        Refused: no possible speed.
    """
    if speed is not None and not (isinstance(speed, (int, float)) and 1e-3 <= speed <= 1000.0):
        raise Refused(
            "out_of_range", f'"speed" must be within 0.001 and 1000 times real time, or None, not {speed!r}', "speed"
        )
    given = timing_of(resolved)
    if is_whole and given.mode == "lockstep":
        return given if speed is None else replace(given, max_speed=float(speed))
    return Timing("freerun") if speed is None else Timing("realtime", float(speed))


def show_page(address: str, is_wanted: bool) -> None:
    """Open a page in the browser of this desktop; without a desktop, print its address on standard error.

    Args:
        address: address of the page.
        is_wanted: the user asks for a browser, so one in the terminal will do.
    """
    if is_wanted or _has_desktop():
        open_in_browser(address, _tell)
    else:
        _tell(address)


def _tell(address: str) -> None:
    print(f"uwserver: open {address} in a browser", file=sys.stderr)


def _has_desktop() -> bool:
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
