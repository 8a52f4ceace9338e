"""The links of the table: UDP, TCP and zenoh (`udp.py`, `tcp.py`, `zenoh_link.py`), and the serial line."""

from __future__ import annotations

import logging
from collections.abc import Callable

from uwserver.adapter import AdapterStats, SerialPort
from uwserver_adapters.mavlink.links.endpoint import READY, Address, BadLink, Link
from uwserver_adapters.mavlink.links.hub import Hub
from uwserver_adapters.mavlink.links.tcp import TcpIn, TcpOut
from uwserver_adapters.mavlink.links.udp import UdpIn, UdpOut
from uwserver_adapters.mavlink.links.zenoh import ZenohLink
from uwserver_adapters.mavlink.wire.channel import Channel

_log = logging.getLogger(__name__)


def make(text: str, hub: Hub, stats: AdapterStats) -> Link:
    """A link from its text.

    Raises:
        BadLink: the text says what is wrong.
    """
    kind, _, rest = text.partition(":")
    if kind == "serial" and rest:
        return SerialLink(rest, hub, stats)
    if kind == "zenoh" and "/" in rest:
        return ZenohLink(rest, hub, stats)
    host, _, number = rest.rpartition(":")
    host = host.strip("[]")
    if kind not in _SOCKETS or not host or not number.isdecimal() or int(number) > 0xFFFF:
        raise BadLink(
            f'link "{text}": write udpout:host:port, udpin:host:port, tcpin:host:port, tcpout:host:port, serial:/dev/ttyS1, or zenoh:tcp/host:port'
        )
    return _SOCKETS[kind]((host, int(number)), hub, stats)


class SerialLink:
    """A serial line or pseudo-terminal."""

    def __init__(self, path: str, hub: Hub, stats: AdapterStats) -> None:
        self.address = f"serial:{path}"
        self._hub = hub
        self._stats = stats
        self._channel: Channel | None = None
        self._port = SerialPort(
            path, opened=self._opened, received=self._received, closed=self._closed, failed=self._failed
        )

    async def open(self) -> None:
        """Open the device; it is tried again when that fails."""
        self._port.attend()

    async def attend(self) -> None:
        """Open the device, if it is not."""
        self._port.attend()

    def close(self) -> None:
        """Close the device."""
        self._port.close()

    def _opened(self) -> None:
        self._channel = self._hub.open(self.address, self._port.write, lambda: self._port.waiting < READY // 4)

    def _received(self, data: bytes) -> None:
        if self._channel is not None:
            self._hub.receive(self._channel, data)

    def _closed(self) -> None:
        if self._channel is not None:
            self._hub.close(self._channel)
            self._channel = None

    def _failed(self, text: str) -> None:
        if text != self._stats.last_error:
            _log.warning("%s", text)
        self._stats.last_error = text


_SOCKETS: dict[str, Callable[[Address, Hub, AdapterStats], Link]] = {
    "udpout": UdpOut,
    "udpin": UdpIn,
    "tcpin": TcpIn,
    "tcpout": TcpOut,
}
