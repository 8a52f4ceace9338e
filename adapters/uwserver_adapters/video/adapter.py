"""The `video` adapter: streams the pictures of ports to configured addresses, and to RTSP clients."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import socket
from collections.abc import Collection, Sequence
from typing import cast

from uwserver.adapter import (
    AdapterBase,
    AdapterContext,
    CannotServe,
    Peers,
    address_text,
    install_command,
    serve_tcp,
    serving,
)
from uwserver.adapter.pictures import EXTRA, can_encode_jpeg, picture_place
from uwserver.ports import Event, Json, Port, Sample
from uwserver_adapters.video.announcer import Announcer
from uwserver_adapters.video.config import StreamTable, VideoConfig, host_and_port, port_with_pictures
from uwserver_adapters.video.connection import RtspConnection
from uwserver_adapters.video.datagrams import MediaPorts, Sender, Target
from uwserver_adapters.video.stream import Stream

SHOW_S = 1.0
"""Wall time between two updates of the counters in the adapter's state."""
MOST_STREAMS = 64
"""Most streams of a world without a table of streams."""


class VideoAdapter(AdapterBase[VideoConfig]):
    """Serves pictures as video."""

    Config = VideoConfig

    def __init__(self, config: VideoConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self._streams: dict[str, Stream] = {}
        self._by_port: dict[str, list[Stream]] = {}
        self._subscriptions: frozenset[str] = frozenset()
        self._closing: set[asyncio.Task[None]] = set()

    @property
    def subscriptions(self) -> Collection[str]:
        """Ports whose pictures are taken."""
        return self._subscriptions

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: an address cannot be bound.
            CannotServe: a table names something that does not exist.
        """
        config = self.config
        self._load()
        self._build()
        async with contextlib.AsyncExitStack() as stack:
            stack.push_async_callback(self._end)
            sender = Sender(self.context.stats)
            stack.push_async_callback(sender.close)
            await self._open_targets(stack, sender)
            address = await self._open_rtsp(stack, sender) if config.rtsp else "rtp alone"
            announcer = Announcer(self._streams, config.streams, self.context, address)
            for target in config.mavlink:
                await stack.enter_async_context(announcer.speaking(target))
            with serving(self.context, self, address, ready):
                while True:
                    self._show()
                    announcer.heartbeat()
                    await asyncio.sleep(SHOW_S)

    # -- streams --------------------------------------------------------------------------------------------------------------------

    def _load(self) -> None:
        """Load the encoders before the world runs. It takes as long as hundreds of ticks, and cameras may come at any time."""
        codecs = {table.codec for table in self.config.streams.values()} or {self.config.codec}
        if "jpeg" in codecs and not can_encode_jpeg():
            raise CannotServe(f"JPEG needs simplejpeg or Pillow: {install_command(EXTRA)}")
        if "h264" in codecs:
            importlib.import_module("av")

    def _build(self) -> None:
        self._streams.clear()
        self._by_port.clear()
        for name, table in self.config.streams.items():
            try:
                port = port_with_pictures(table.port, self.context.ports)
            except CannotServe as error:
                raise CannotServe(f"streams.{name}.port: {error}") from None
            self._add(name, table, port)
        if not self.config.streams:
            self._follow_ports()

    def _follow_ports(self) -> None:
        """Make a stream for each port that has pictures now, and drop the others."""
        ports = self.context.ports
        for path in [path for path in self._streams if path not in ports]:
            self._drop(path)
        for path, port in ports.items():
            if path not in self._streams and picture_place(port) is not None:
                if len(self._streams) >= MOST_STREAMS:
                    text = (
                        f"more than {MOST_STREAMS} ports have pictures: list those to be served in the table `streams`"
                    )
                    self.refusals.note("streams", text)
                    return
                self._add(path, StreamTable(port=path, codec=self.config.codec), port)

    def _add(self, name: str, table: StreamTable, port: Port) -> None:
        place = picture_place(port)
        assert place is not None
        stream = Stream(name, table, port, place, self.context, self.refusals, self._follow_subscriptions)
        self._streams[name] = stream
        self._by_port.setdefault(port.path, []).append(stream)

    def _drop(self, name: str) -> None:
        stream = self._streams.pop(name)
        self._by_port[stream.port.path].remove(stream)
        task = asyncio.get_running_loop().create_task(stream.close())
        self._closing.add(task)
        task.add_done_callback(self._closing.discard)
        self._follow_subscriptions()

    def _follow_subscriptions(self) -> None:
        self._subscriptions = frozenset(
            path for path, streams in self._by_port.items() if any(s.is_wanted for s in streams)
        )
        self.context.subscriptions_changed()

    async def _end(self) -> None:
        for stream in self._streams.values():
            await stream.close()
        if self._closing:
            await asyncio.wait(self._closing)

    # -- addresses ------------------------------------------------------------------------------------------------------------------

    async def _open_targets(self, stack: contextlib.AsyncExitStack, sender: Sender) -> None:
        loop = asyncio.get_running_loop()
        for name, table in self.config.streams.items():
            for text in table.targets:
                host, port = host_and_port("rtp", text)
                try:
                    family, _, _, _, address = (await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM))[0]
                    out = sender.own(socket.socket(family, socket.SOCK_DGRAM))
                except OSError as error:
                    raise CannotServe(f"streams.{name}.rtp: {text}: {error}") from error
                out.setblocking(False)
                target = Target(sender.route(out, (str(address[0]), int(address[1]))), self.context.stats)
                self._streams[name].join(target)
                stack.callback(self._streams[name].leave, target)

    async def _open_rtsp(self, stack: contextlib.AsyncExitStack, sender: Sender) -> str:
        config, stats = self.config, self.context.stats
        ports: MediaPorts | None = None
        if config.udp:
            ports = MediaPorts(config.bind, sender)
            stack.push_async_callback(asyncio.sleep, 0)  # asyncio closes the sockets in the next turn of the loop
            stack.callback(ports.close)
            await ports.open()
        peers: Peers[RtspConnection] = Peers(
            config.max_clients, self.refusals, stats, most_per_host=config.max_clients_per_host
        )
        listener = await stack.enter_async_context(
            serve_tcp(
                lambda: RtspConnection(config, self._streams, peers, stats, ports),
                peers, config.bind, config.rtsp_port, key="rtsp_port", rival="another RTSP server, as mediamtx",
            )
        )  # fmt: skip
        return f"rtsp://{address_text(config.bind, listener.port)}/"

    # -- the world ------------------------------------------------------------------------------------------------------------------

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Each picture to its streams."""
        for sample in samples:
            for stream in self._by_port.get(sample.port, ()):
                stream.put(sample)

    def put_event(self, event: Event) -> None:
        """Cameras come and go."""
        if event.event == "ports_changed" and not self.config.streams:
            self._follow_ports()

    def _show(self) -> None:
        told: dict[str, Json] = {}
        for name, stream in self._streams.items():
            told[name] = {
                "port": stream.port.path, "taken": stream.is_wanted, "encoded": stream.encoded, "bytes": stream.octets,
                "dropped": stream.dropped, "size": cast(Json, list(stream.size)),
            }  # fmt: skip
        self.context.stats.details["streams"] = told
