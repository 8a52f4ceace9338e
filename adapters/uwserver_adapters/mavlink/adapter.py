"""The `mavlink` adapter: shows one vehicle to ground stations as an ArduSub ROV, on the links that its table names."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from datetime import datetime, timezone

from uwserver.adapter import AdapterBase, CannotServe, serving, vehicle_of
from uwserver_adapters.mavlink.links.endpoint import RETRY_S, Address, BadLink, Link
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.links.stream import SerialLink, TcpIn, TcpOut
from uwserver_adapters.mavlink.links.udp import UdpIn, UdpOut
from uwserver_adapters.mavlink.links.zenoh import ZenohLink
from uwserver_adapters.mavlink.vehicle.config import MavlinkConfig
from uwserver_adapters.mavlink.wire.dialect import Dialect

_SOCKETS: dict[str, Callable[[Address, Router], Link]] = {
    "udpout": UdpOut,
    "udpin": UdpIn,
    "tcpin": TcpIn,
    "tcpout": TcpOut,
}
TICK_S = 0.05
"""Wall time between two checks of time-outs and downloads."""


def make(text: str, router: Router) -> Link:
    """Return the link that a text describes.

    Raises:
        BadLink: the text is no link.
    """
    kind, _, rest = text.partition(":")
    if kind == "serial" and rest:
        return SerialLink(rest, router)
    if kind == "zenoh" and "/" in rest:
        return ZenohLink(rest, router)
    host, _, number = rest.rpartition(":")
    host = host.strip("[]")
    if kind not in _SOCKETS or not host or not number.isdecimal() or int(number) > 0xFFFF:
        raise BadLink(
            f'link "{text}": write udpout:host:port, udpin:host:port, tcpin:host:port, tcpout:host:port, serial:/dev/ttyS1, or zenoh:tcp/host:port'
        )
    return _SOCKETS[kind]((host, int(number)), router)


class MavlinkAdapter(AdapterBase[MavlinkConfig]):
    """Speaks MAVLink on all its links (README.md in this folder)."""

    Config = MavlinkConfig

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotSpeak: pymavlink is not installed.
            CannotServe: the vehicle or a parameter does not exist, or a link cannot be opened.
        """
        config, context = self.config, self.context
        loop = asyncio.get_running_loop()
        vehicle = vehicle_of(config.vehicle, context.ports)
        try:
            unix_s = datetime.now(timezone.utc).timestamp()
            router = Router(config, context, vehicle, Dialect(), loop.time, unix_s)
        except ValueError as error:
            raise CannotServe(str(error)) from error
        async with contextlib.AsyncExitStack() as stack:
            # asyncio closes aborted connections in the next turn of the loop.
            stack.push_async_callback(asyncio.sleep, 0)
            stack.callback(router.end)
            links: list[Link] = []
            for text in config.links:
                links.append(make(text, router))
                stack.push_async_callback(links[-1].close)
                await links[-1].open()
            with serving(context, router, ", ".join(link.address for link in links), ready):
                await self._tick(router, links)

    async def _tick(self, router: Router, links: list[Link]) -> None:
        loop = asyncio.get_running_loop()
        due = attended = loop.time()
        while True:
            router.tick()
            if loop.time() - attended >= RETRY_S:
                attended = loop.time()
                for link in links:
                    await link.attend()
            due = max(due + TICK_S, loop.time())
            await asyncio.sleep(due - loop.time())
