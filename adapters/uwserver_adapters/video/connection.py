"""One RTSP client: its requests, their answers, and the packets within or beside the connection."""

from __future__ import annotations

import secrets
import struct
from collections.abc import Mapping
from typing import Any, Final

from uwserver.adapter import AdapterStats, Connection, Peers
from uwserver.ports import Fault
from uwserver_adapters.video.config import VideoConfig
from uwserver_adapters.video.datagrams import Address, MediaPorts, Route
from uwserver_adapters.video.rtsp import Interleaved, Malformed, Reader, answer, sequence_number
from uwserver_adapters.video.session import Session
from uwserver_adapters.video.stream import Picture, Stream

REQUESTS_PER_S: Final = 50
"""Requests that one client may send per second. Players send a few, then one every few seconds."""
IDLE_S: Final = 60.0
"""Wall time without a request after which a client without a stream is closed."""
_FRAME: Final = struct.Struct(">BBH")
_DOLLAR: Final = 0x24


class RtspConnection(Connection):
    """The connection of one client.

    Args:
        config: the adapter's table.
        streams: all streams, by name.
        peers, stats: the adapter's connections and statistics.
        ports: our UDP ports; None where datagrams are not served.
    """

    def __init__(
        self,
        config: VideoConfig,
        streams: Mapping[str, Stream],
        peers: Peers[Any],
        stats: AdapterStats,
        ports: MediaPorts | None,
    ) -> None:
        super().__init__(peers, config.hello_timeout_s, stats=stats, requests_per_s=REQUESTS_PER_S)
        self._config = config
        self._streams = streams
        self._ports = ports
        self._reader = Reader()
        self._session: Session | None = None
        self._address = ""
        self._seq = ""
        self._channel: int | None = None
        self._udp: tuple[Route, Address] | None = (
            None  # over UDP: the route to its port, and the address of its reports
        )
        self._stream: Stream | None = None
        self._waits_for_key = True
        self._heard_at = self.loop.time()
        self._idle_timer = self.loop.call_later(1.0, self._attend)

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def opened(self) -> None:
        """Begin a session: the connection was accepted."""
        self._address = str((self.transport.get_extra_info("peername") or ("",))[0])
        self._session = Session(
            secrets.token_hex(8), self._streams, self, self._address, self._config.keep_alive_s, self._ports is not None
        )

    def receive(self, data: bytes) -> None:
        """Store received bytes."""
        self._reader.receive(data)

    def step(self) -> bool:
        """Answer the next request. Returns False when there is none, or too many came: then they wait, and the sender too."""
        now = self.loop.time()
        if self._rate.is_full(now):
            return False
        event = self._reader.next_event()
        if event is None:
            return False
        self._rate.take(now)
        if isinstance(event, Malformed):
            self._stats.errors += 1
            self.peers.refusals.note("malformed", event.text)
            self.farewell(
                answer(event.status, "", {"Content-Type": "text/plain", "Connection": "close"}, f"{event.text}\r\n")
            )
            return True
        if isinstance(event, Interleaved):
            self._heard_at = now  # this is a receiver's report
            return True
        self._seq = sequence_number(event)
        if self.admit():
            assert self._session is not None
            self._heard_at = now
            self._stats.calls += 1
            self.reply(self._session.answer(event))
        return True

    def reply(self, data: bytes) -> None:
        """Send an answer. A client that reads none is disconnected."""
        if self.waiting > 2 * self._config.queue_bytes:
            self.peers.refusals.note("slow", "a client does not read its answers and is disconnected")
            self.abort()
            return
        self._stats.bytes_sent += len(data)
        self.write(data)

    def quiet_until(self) -> float:
        """Return when the next request is read from a client that sent too many."""
        return self._rate.end if self._rate.is_full(self.loop.time()) else 0.0

    def refused(self, fault: Fault) -> bytes:
        """Return the answer for a client that was not admitted, or that said nothing in time."""
        status = 453 if fault.code == "overload" else 400
        return answer(status, self._seq, {"Content-Type": "text/plain", "Connection": "close"}, f"{fault.text}\r\n")

    def half_closed(self) -> None:
        """Close the connection: a client that has ended its side takes nothing more."""
        self.close()

    # -- pictures -------------------------------------------------------------------------------------------------------------------

    def interleave(self, channel: int) -> None:
        """See `session.Media`."""
        self._forget_udp()
        self._channel = channel

    def open_udp(self, pair: tuple[int, int]) -> tuple[int, int] | None:
        """See `session.Media`."""
        if self._ports is None:
            return None
        self._forget_udp()
        self._channel = None
        self._udp = (self._ports.route((self._address, pair[0])), (self._address, pair[1]))
        self._ports.enter(self._udp[1], self._heard)
        return self._ports.numbers

    def play(self, stream: str) -> None:
        """See `session.Media`."""
        self._waits_for_key = True
        self._heard_at = self.loop.time()
        self._stream = self._streams[stream]
        self._stream.join(self)

    def pause(self) -> None:
        """See `session.Media`."""
        if self._stream is not None:
            self._stream.leave(self)
            self._stream = None

    def take(self, picture: Picture) -> None:
        """Send a picture unless the client is slow. A slow client gets none until the next key picture."""
        if self.is_closing:
            return
        if self._waits_for_key and not picture.is_key:
            return
        if not self._sent(picture):
            self._stats.dropped += 1
            self._waits_for_key = True
            return
        self._waits_for_key = False
        self._stats.samples_sent += 1
        self._stats.bytes_sent += picture.size

    def _sent(self, picture: Picture) -> bool:
        if self._udp is not None and self._ports is not None:
            return self._ports.send(picture.packets, picture.report, *self._udp)
        if self.waiting + picture.size > self._config.queue_bytes:
            return False
        if self.waiting == 0:
            self._heard()  # the client has read everything, so it is there
        channel = self._channel or 0
        framed = [part for packet in picture.packets for part in (_FRAME.pack(_DOLLAR, channel, len(packet)), packet)]
        if picture.report:
            framed += (_FRAME.pack(_DOLLAR, channel + 1, len(picture.report)), picture.report)
        self.write(b"".join(framed))
        return True

    # -- the end --------------------------------------------------------------------------------------------------------------------

    def _heard(self) -> None:
        self._heard_at = self.loop.time()

    def _attend(self) -> None:
        """Close a client that has been silent for too long. Called about once per second."""
        if self.is_closing:
            return
        if self._stream is not None and self._udp is None and self.waiting == 0:
            # Players send their keep-alive between packets, so none comes while the world is paused. But the client has read what we
            # sent and the connection is open, so it is there.
            self._heard()
        patience = IDLE_S if self._stream is None else self._config.keep_alive_s
        rest = self._heard_at + patience - self.loop.time()
        if rest > 0 or self.is_stranger:
            self._idle_timer = self.loop.call_later(max(min(rest, 1.0), 0.05), self._attend)
            return
        self.peers.refusals.note("silent", f"a client sent nothing for {patience:g} s and is disconnected")
        self.close()

    def _forget_udp(self) -> None:
        if self._udp is not None and self._ports is not None:
            self._ports.leave(self._udp[1])
            self._udp[0].is_over = True
        self._udp = None

    def stop(self) -> None:
        """End the session: the connection is closing."""
        self._idle_timer.cancel()
        if self._session is not None:
            self._session.end()
        self._forget_udp()

    def closed(self) -> None:
        """End the session: the connection is closed."""
        self.stop()
