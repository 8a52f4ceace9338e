"""A connection in memory for an `asyncio.Protocol`, without a socket, with a peer that reads only when the test says so."""

from __future__ import annotations

import asyncio


class Loopback(asyncio.Transport):
    """The transport of a protocol whose peer is the test. It needs a running loop.

    What the protocol writes goes to `written` while the peer reads. After `stall` it piles up, and the protocol is told to pause, as with a
    socket.

    Args:
        protocol: the protocol of the adapter's side.
        peer: address of the peer; None as of one that has reset the connection already.

    Attributes:
        written: what the peer has read since the last `take`.
        eof_written: whether the protocol has ended its side.
        is_lost: whether the connection has ended.
    """

    def __init__(self, protocol: asyncio.Protocol, peer: tuple[str, int] | None = ("127.0.0.1", 0)) -> None:
        super().__init__({"peername": peer})
        self.written = bytearray()
        self.eof_written = False
        self._reading = True
        self._protocol = protocol
        self._buffer = bytearray()
        self._stalled = False
        self._paused_writing = False
        self._high, self._low = 1 << 16, 1 << 14
        self._closing = False
        self.is_lost = False
        self._unread: list[bytes] = []
        self._ended = False
        protocol.connection_made(self)

    # -- the peer -------------------------------------------------------------------------------------------------------------------

    def feed(self, data: bytes) -> None:
        """Send bytes as the peer."""
        self._unread.append(data)
        self._deliver()

    def feed_eof(self) -> None:
        """End the peer's side."""
        self._ended = True
        self._deliver()

    def stall(self) -> None:
        """Let the peer stop reading."""
        self._stalled = True

    def drain(self) -> None:
        """Let the peer read everything that waits, and go on reading."""
        self._stalled = False
        self.written += self._buffer
        self._buffer.clear()
        if self._paused_writing:
            self._paused_writing = False
            self._protocol.resume_writing()
        if self._closing and not self._buffer:
            self.die()

    def die(self, error: Exception | None = None) -> None:
        """Let the connection end at once, as when the peer vanishes."""
        if not self.is_lost:
            self.is_lost = self._closing = True
            self._buffer.clear()
            asyncio.get_running_loop().call_soon(self._protocol.connection_lost, error)

    def take(self) -> bytes:
        """Return what the peer has read since the last call."""
        taken = bytes(self.written)
        self.written.clear()
        return taken

    def _deliver(self) -> None:
        while self._unread and self._reading and not self._closing:
            self._protocol.data_received(self._unread.pop(0))
        if self._ended and not self._unread and self._reading and not self._closing:
            self._ended = False
            if not self._protocol.eof_received():
                self.close()

    # -- the transport --------------------------------------------------------------------------------------------------------------

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """See asyncio.WriteTransport."""
        if self.is_lost:
            return
        self._buffer += data
        if self._stalled:
            if len(self._buffer) > self._high and not self._paused_writing:
                self._paused_writing = True
                self._protocol.pause_writing()
        else:
            self.written += self._buffer
            self._buffer.clear()

    def write_eof(self) -> None:
        """See asyncio.WriteTransport."""
        self.eof_written = True

    def can_write_eof(self) -> bool:
        """Return True, as without TLS."""
        return True

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """See asyncio.WriteTransport."""
        self._high = self._high if high is None else high
        self._low = self._high // 4 if low is None else low

    def get_write_buffer_limits(self) -> tuple[int, int]:
        """See asyncio.WriteTransport."""
        return self._low, self._high

    def get_write_buffer_size(self) -> int:
        """Return the number of bytes that the peer has not read."""
        return len(self._buffer)

    def pause_reading(self) -> None:
        """See asyncio.ReadTransport."""
        self._reading = False

    def resume_reading(self) -> None:
        """See asyncio.ReadTransport."""
        if not self._reading:
            self._reading = True
            asyncio.get_running_loop().call_soon(self._deliver)

    def is_reading(self) -> bool:
        """See asyncio.ReadTransport."""
        return self._reading

    def is_closing(self) -> bool:
        """See asyncio.BaseTransport."""
        return self._closing

    def close(self) -> None:
        """See asyncio.BaseTransport."""
        self._closing = True
        if not self._buffer:
            self.die()

    def abort(self) -> None:
        """See asyncio.WriteTransport."""
        self.die()
