"""Cameras of MAVLink towards ground stations: each stream is one, on a socket of its own beside the autopilot's."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from typing import TYPE_CHECKING, Final, cast

from uwserver.adapter import AdapterContext, RateMeter
from uwserver_adapters.video.config import StreamTable, host_and_port
from uwserver_adapters.video.h264 import PAYLOAD_TYPE
from uwserver_adapters.video.stream import Stream

if TYPE_CHECKING:
    from uwserver_adapters.video.camera import Camera, Facts

COMMANDS_PER_S: Final = 50
"""Commands of one ground station that are answered per second."""


class Announcer:
    """Announces the streams to ground stations.

    Args:
        streams: all streams, by name; may change.
        tables: tables of the streams that the scenario names.
        context: the adapter's context.
        address: address of the RTSP server.
    """

    def __init__(
        self, streams: Mapping[str, Stream], tables: Mapping[str, StreamTable], context: AdapterContext, address: str
    ) -> None:
        self._streams = streams
        self._tables = tables
        self._context = context
        self._address = address
        self._links: list[_Link] = []

    @contextlib.asynccontextmanager
    async def speaking(self, target: str) -> AsyncIterator[None]:
        """Speak to a ground station while the context is open, whether or not it listens."""
        loop = asyncio.get_running_loop()
        host, port = host_and_port("mavlink", target)
        try:
            _, link = await loop.create_datagram_endpoint(lambda: _Link(self), remote_addr=(host, port))
        except OSError as error:  # the host is not known now; the pictures are served all the same
            self._context.stats.last_error = f"mavlink: {target}: {error}"
            yield
            return
        self._links.append(link)
        try:
            yield
        finally:
            self._links.remove(link)
            link.close()
            await asyncio.sleep(0)  # asyncio closes the socket in the next turn of the loop

    def heartbeat(self) -> None:
        """Send a heartbeat of each camera. Called once per second."""
        for link in self._links:
            for camera, _ in self._cameras(link):
                link.send(camera.heartbeat())

    def _cameras(self, link: _Link) -> list[tuple[Camera, Facts]]:
        """Return the camera of each stream, and what this station is told of it."""
        from uwserver_adapters.video.camera import FIRST_COMPONENT, MOST_CAMERAS, Camera

        found = []
        numbers: dict[int, int] = {}
        for name, stream in self._streams.items():
            table = self._tables.get(name)
            system = 1 if table is None else table.system
            number = numbers[system] = numbers.get(system, 0) + 1
            if number <= MOST_CAMERAS:
                camera = link.known.setdefault(name, Camera(system, FIRST_COMPONENT + number - 1))
                found.append((camera, self._facts(name, stream, table, link)))
        return found

    def _facts(self, name: str, stream: Stream, table: StreamTable | None, link: _Link) -> Facts:
        from uwserver_adapters.video.camera import Facts

        targets = () if table is None else table.targets
        is_h264 = stream.payload_type == PAYLOAD_TYPE
        is_rtp = bool(targets) and is_h264
        uri = targets[0].rpartition(":")[2] if is_rtp else f"{self._rtsp(link)}{name}"
        return Facts(
            name, stream.port.path, uri, is_rtp, is_h264, stream.is_wanted or not is_rtp, stream.expected_size,
            stream.rate_hz, stream.bit_rate,
        )  # fmt: skip

    def _rtsp(self, link: _Link) -> str:
        """Return the RTSP server's address for a station. If it listens at all addresses, use ours on the way to the station."""
        for everywhere in ("//0.0.0.0:", "//[::]:"):
            if everywhere in self._address:
                own = f"[{link.own_host}]" if ":" in link.own_host else link.own_host
                return self._address.replace(everywhere, f"//{own}:")
        return self._address

    def take(self, link: _Link, data: bytes) -> None:
        """Answer the commands in a station's datagram."""
        time_ms = round(asyncio.get_running_loop().time() * 1e3)
        for command in link.decoder.commands(data):
            for camera, facts in self._cameras(link):
                for answer in camera.answer(command, facts, time_ms):
                    self._context.stats.commands += 1
                    link.send(answer)


class _Link(asyncio.DatagramProtocol):
    """The socket for one station. It receives from nobody else."""

    def __init__(self, announcer: Announcer) -> None:
        from uwserver_adapters.video.camera import Decoder

        self.known: dict[str, Camera] = {}
        self.decoder = Decoder()
        self.own_host = "127.0.0.1"
        self._announcer = announcer
        self._rate = RateMeter(COMMANDS_PER_S)
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport, and our own address."""
        self._transport = cast(asyncio.DatagramTransport, transport)
        own = transport.get_extra_info("sockname")
        if isinstance(own, tuple) and own:
            self.own_host = str(own[0])

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the transport."""
        self._transport = None

    def error_received(self, exc: Exception) -> None:
        """Ignore that nobody listens there yet, or any more."""

    def datagram_received(self, data: bytes, addr: tuple[object, ...]) -> None:
        """Take a datagram, unless too many came."""
        if self._rate.take(asyncio.get_running_loop().time()):
            self._announcer.take(self, data)

    def send(self, data: bytes) -> None:
        """Send one frame."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(data)

    def close(self) -> None:
        """Close the socket."""
        if self._transport is not None:
            self._transport.abort()
