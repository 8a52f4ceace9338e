"""One conversation: a connection, a serial line, or one peer of a UDP socket. Sans-IO: it gets a way to write bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

from uwserver.adapter import RateMeter
from uwserver_adapters.mavlink.wire.dialect import Dialect, Fields
from uwserver_adapters.mavlink.wire.frames import Decoder
from uwserver_adapters.mavlink.wire.streams import Streams

Out = tuple[str, Fields]
"""A message to send: its name and fields."""

BACKLOG = 16
"""Downloads (parameters, files) that may be under way on a channel; a new one ends the oldest."""


class Channel:
    """What belongs to one conversation.

    Args:
        number: of this channel, never used again by another.
        name: as a user would type it.
        dialect: for its decoder.
        write: sends bytes, or says False when the peer does not keep up.
        is_ready: whether more than what must be may be written now.
        streams: what it is told how often.
        frames_per_s: that are taken.

    Attributes:
        seq: of the next frame.
        backlog: downloads under way, sent some at a time.
        heard_at: loop time of the last good frame, s.
        is_heard: a good frame has come.
        has_peer: somebody has spoken, or is surely there.
        allowance: frames of the backlog that may be sent before the next tick.
        meter: bounds its frames.
    """

    def __init__(
        self,
        number: int,
        name: str,
        dialect: Dialect,
        write: Callable[[bytes], bool],
        is_ready: Callable[[], bool],
        streams: Streams,
        frames_per_s: int,
    ) -> None:
        self.number = number
        self.name = name
        self.decoder = Decoder(dialect)
        self.write = write
        self.is_ready = is_ready
        self.streams = streams
        self.seq = 0
        self.backlog: deque[Iterator[Out]] = deque(maxlen=BACKLOG)
        self.heard_at = 0.0
        self.is_heard = False
        self.has_peer = False
        self.allowance = 0
        self.meter = RateMeter(frames_per_s)

    def next_seq(self) -> int:
        """Number of the frame that is written next."""
        seq = self.seq
        self.seq = (seq + 1) & 0xFF
        return seq
