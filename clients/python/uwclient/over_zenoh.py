"""Clients over zenoh instead of TCP."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from uwclient.aio import AsyncClient
from uwclient.session import Settings
from uwclient.sync import Client
from uwclient.zenoh_async import dial_zenoh_async
from uwclient.zenoh_link import dial_zenoh
from uwclient.zenoh_place import ZenohPlace

LOOPBACK = ("tcp/127.0.0.1:7447",)
"""Default endpoint of a server on this machine."""


def connect_zenoh(
    server: str = "uwserver",
    connect: Sequence[str] = LOOPBACK,
    *,
    prefix: str = "uw",
    mode: str = "peer",
    config: Mapping[str, object] | None = None,
    name: str | None = None,
    encoding: str = "json",
    timeout: float = 5.0,
    reconnect: bool = True,
) -> Client:
    """Connect over zenoh. Everything else is as with `Client.connect`. Needs the eclipse-zenoh package.

    Args:
        server: name of the server in the keys.
        connect: endpoints of servers or routers; with none, (), the server is found by multicast.
        prefix: first levels of the keys, as in the server's adapter.
        mode: mode of the zenoh session, "peer" or "client".
        config: zenoh settings by path, such as {"transport/link/tls/root_ca_certificate": "ca.pem"}.
        name: name of this client, which it needs to take part in a lockstep barrier.
        encoding: "json", or "msgpack" (needs the msgpack package); preferably that of the server's adapter.
        timeout: wall s, for connecting and for every operation without a timeout of its own.
        reconnect: whether to renew a lost connection.

    Raises:
        ConnectionLost: there is no such server in the network; the text names those that are there.
        UwError: eclipse-zenoh is missing (`missing_package`), or a setting is wrong (`bad_argument`).
    """
    place = ZenohPlace(server, tuple(connect), prefix, mode, dict(config or {}), encoding)
    settings = Settings("", 0, name, None, encoding, timeout, reconnect, via=place.address)
    return Client.over(partial(dial_zenoh, place), settings)


async def connect_zenoh_async(
    server: str = "uwserver",
    connect: Sequence[str] = LOOPBACK,
    *,
    prefix: str = "uw",
    mode: str = "peer",
    config: Mapping[str, object] | None = None,
    name: str | None = None,
    encoding: str = "json",
    timeout: float = 5.0,
    reconnect: bool = True,
) -> AsyncClient:
    """Connect an `AsyncClient` over zenoh. Arguments and errors are those of `connect_zenoh`."""
    place = ZenohPlace(server, tuple(connect), prefix, mode, dict(config or {}), encoding)
    settings = Settings("", 0, name, None, encoding, timeout, reconnect, via=place.address)
    return await AsyncClient.over(partial(dial_zenoh_async, place), settings)
