"""One stream: the pictures of a port, encoded once for all receivers on a thread of its own, and only while there are receivers."""

from __future__ import annotations

import asyncio
import zlib
from collections.abc import Callable
from datetime import datetime
from typing import NamedTuple, Protocol

from uwserver.adapter import AdapterContext, Refusals, Worker
from uwserver.adapter.pictures import pixels
from uwserver.ports import Port, Sample, Value
from uwserver_adapters.video import h264, mjpeg
from uwserver_adapters.video.config import StreamTable
from uwserver_adapters.video.encoder import Coded, Encoder, H264Encoder, JpegEncoder
from uwserver_adapters.video.rtp import Packets

WAITING = 2
"""Pictures that may wait for the encoder, including the one that is being encoded. A picture that waits longer would be late."""
FORCE_S = 0.5
"""Wall time between two key pictures for new receivers. Without it a receiver that rejoins again and again would lower the quality for all."""
REPORT_S = 5.0
"""Wall time between two sender reports."""


class Picture(NamedTuple):
    """An encoded picture for all receivers of a stream.

    Attributes:
        packets: RTP packets.
        is_key: a receiver can begin with it.
        report: the sender report if one is due; else b"".
        size: bytes of all packets.
    """

    packets: list[bytes]
    is_key: bool
    report: bytes
    size: int


class Receiver(Protocol):
    """A receiver of a stream."""

    def take(self, picture: Picture) -> None:
        """Send a picture, or leave it out. Called on the loop thread."""


class Stream:
    """One stream. Runs on the loop thread, except for the encoder.

    Args:
        name: its name in requests.
        table: how it is encoded.
        port: the port whose pictures it sends.
        place: index of the pictures among the port's fields.
        context: the adapter's context.
        refusals: logs pictures that could not be encoded.
        changed: called when the first receiver has joined, or the last one has left.

    Attributes:
        name, port: as given.
        rate_hz: pictures per second of simulation time.
        bit_rate: most bits per second.
        payload_type: payload type of RTP.
        size: width and height of the last picture in pixels; (0, 0) before.
        dropped: pictures for which the encoder had no time.
        encoded: pictures that were encoded.
        octets: bytes of these.
    """

    def __init__(
        self, name: str, table: StreamTable, port: Port, place: int, context: AdapterContext, refusals: Refusals,
        changed: Callable[[], None],
    ) -> None:  # fmt: skip
        self.name = name
        self.port = port
        self.rate_hz = port.rate_hz or 1.0
        self.bit_rate = table.bit_rate
        self.payload_type = h264.PAYLOAD_TYPE if table.codec == "h264" else mjpeg.PAYLOAD_TYPE
        self.size = (0, 0)
        self.dropped = self.encoded = self.octets = 0
        self._table = table
        self._place = place
        self._context = context
        self._refusals = refusals
        self._changed = changed
        self._receivers: dict[Receiver, None] = {}
        self._loop = asyncio.get_running_loop()
        self._worker = Worker(f"video {name}", context.stats)
        self._encoder: Encoder | None = None
        self._waiting = 0
        self._wants_key = False
        self._forced_at = self._reported_at = -REPORT_S
        self._format = ""
        self._t_ns = 0
        self._shift_ns = 0
        # Any number will do. Derived from the name, it lets a receiver recognise the stream after a restart.
        number = zlib.crc32(name.encode())
        epoch = datetime.fromisoformat(context.world.epoch_utc.replace("Z", "+00:00"))
        epoch_ns = int(epoch.timestamp() * 1e9)
        self._packets = Packets(self.payload_type, number, number >> 16, number, epoch_ns)

    @property
    def is_wanted(self) -> bool:
        """Whether there are receivers."""
        return bool(self._receivers)

    @property
    def expected_size(self) -> tuple[int, int]:
        """Width and height of the last picture, or what the port declares; 0 while unknown."""
        layout = self.port.fields[self._place].buffer
        if self.size != (0, 0) or not layout:
            return self.size
        return max(layout.shape[1], 0), max(layout.shape[0], 0)

    def description(self) -> list[str]:
        """Return its lines in a session description (RFC 8866)."""
        kind = self.payload_type
        lines = [
            f"m=video 0 RTP/AVP {kind}",
            f"a=rtpmap:{kind} {h264.ENCODING if kind == h264.PAYLOAD_TYPE else mjpeg.ENCODING}",
        ]
        if kind == h264.PAYLOAD_TYPE:
            lines.append(f"a=fmtp:{kind} {self._format or h264.format_parameters(None)}")
        return [*lines, f"a=framerate:{self.rate_hz:g}"]

    def join(self, receiver: Receiver) -> None:
        """Add a receiver. The next picture is a key picture, unless one was forced just before."""
        self._wants_key = True
        self._receivers[receiver] = None
        if len(self._receivers) == 1:
            self._changed()

    def leave(self, receiver: Receiver) -> None:
        """Remove a receiver. May be called again."""
        if self._receivers.pop(receiver, self) is None and not self._receivers:
            self._changed()

    def put(self, sample: Sample) -> None:
        """Take a sample of the port, and encode its picture."""
        if not self._receivers or not sample.valid or self._place >= len(sample.value):
            return
        if self._waiting >= WAITING:
            self.dropped += 1
            self._context.stats.dropped += 1
            self._refusals.note(
                "slow encoder",
                f"the encoder of {self.name} is too slow for all pictures: lower their rate or size, or choose a faster preset",
            )
            return
        value, key = sample.value[self._place], self._takes_key()
        self._waiting += 1
        if not self._worker.send(lambda: self._encode(value, sample.t_ns, key)):
            self._waiting -= 1

    def _takes_key(self) -> bool:
        now = self._loop.time()
        if not self._wants_key or now - self._forced_at < FORCE_S:
            return False
        self._wants_key = False
        self._forced_at = now
        return True

    def _encode(self, value: Value, t_ns: int, wants_key: bool) -> None:
        """Encode a picture. Runs on the stream's thread."""
        coded: Coded | None = None
        fault, size = "", (0, 0)
        try:
            shown = pixels(value)
            if shown is not None:
                size = (shown.shape[1], shown.shape[0])
                self._encoder = self._encoder or self._new_encoder()
                coded = self._encoder.encode(shown, wants_key)
        except Exception as error:  # noqa: BLE001  # a library may raise anything; it is reported, and the world goes on
            fault = f"{type(error).__name__}: {error}"
        self._loop.call_soon_threadsafe(self._deliver, coded, size, t_ns, fault)

    def _new_encoder(self) -> Encoder:
        table = self._table
        if table.codec == "jpeg":
            return JpegEncoder(table.quality)
        return H264Encoder(self.rate_hz, table.bit_rate, table.preset)

    def _deliver(self, coded: Coded | None, size: tuple[int, int], t_ns: int, fault: str) -> None:
        self._waiting -= 1
        stats = self._context.stats
        if coded is None:
            if fault:
                stats.count_error(f"{self.name}: {fault}")
                self._refusals.note("encoder", f"a picture of {self.port.path} cannot be encoded: {fault}")
            return
        self.size, self._format = size, coded.format
        self.encoded += 1
        self.octets += coded.size
        stats.encoded += 1
        t_ns = self._steady(t_ns)
        packets = self._packets.of(coded.payloads, t_ns)
        picture = Picture(packets, coded.is_key, self._report(t_ns), sum(map(len, packets)))
        for receiver in list(self._receivers):
            try:
                receiver.take(picture)
            except Exception as error:  # noqa: BLE001  # the fault of one receiver must not concern the others
                stats.count_error(f"{self.name}: {type(error).__name__}: {error}")
                self._refusals.note(
                    "not sent", f"a picture of {self.port.path} could not be sent to a receiver: {error}"
                )

    def _steady(self, t_ns: int) -> int:
        """Return the time of a picture for receivers, which know no reset: it never goes back."""
        if t_ns + self._shift_ns <= self._t_ns and self.encoded > 1:
            self._shift_ns = self._t_ns + round(1e9 / self.rate_hz) - t_ns
        self._t_ns = t_ns + self._shift_ns
        return self._t_ns

    def _report(self, t_ns: int) -> bytes:
        now = self._loop.time()
        if now - self._reported_at < REPORT_S:
            return b""
        self._reported_at = now
        return self._packets.report(t_ns)

    async def close(self) -> None:
        """End the stream after the pictures that wait for the encoder."""
        self._receivers.clear()
        if self._encoder is not None or self._waiting:
            await self._worker.run(self._finish)
        await self._worker.close(lambda: None)

    def _finish(self) -> None:
        """Release the encoder. Runs on the stream's thread."""
        encoder, self._encoder = self._encoder, None
        if encoder is not None:
            encoder.close()
