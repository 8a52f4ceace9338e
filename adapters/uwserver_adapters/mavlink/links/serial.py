"""A serial line or pseudo-terminal as a link."""

from __future__ import annotations

from uwserver.adapter import SerialPort
from uwserver_adapters.mavlink.links.endpoint import READY, Link
from uwserver_adapters.mavlink.links.router import Router
from uwserver_adapters.mavlink.wire.channel import Channel


class SerialLink(Link):
    """A device that may come and go. Opening it is tried again and again.

    Args:
        path: path of the device.
        router: the router of the vehicle.
    """

    def __init__(self, path: str, router: Router) -> None:
        super().__init__(f"serial:{path}", router)
        self._channel: Channel | None = None
        self._port = SerialPort(path, router.context, opened=self._opened, received=self._received, closed=self._closed)

    async def attend(self) -> None:
        """Open the device if it is not open."""
        self._port.attend()

    async def close(self) -> None:
        """Close the device."""
        self._port.close()

    def _opened(self) -> None:
        self._channel = self._router.open(self.address, self._port.write, lambda: self._port.waiting < READY // 4)

    def _received(self, data: bytes) -> None:
        if self._channel is not None:
            self._router.receive(self._channel, data)

    def _closed(self) -> None:
        if self._channel is not None:
            self._router.close(self._channel)
            self._channel = None
