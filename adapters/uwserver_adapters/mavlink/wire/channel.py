"""One conversation: a connection, a serial line, or one peer of a UDP socket. Sans-IO: the owner passes in how to write bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

from uwserver.adapter import RateMeter
from uwserver_adapters.mavlink.wire.dialect import Dialect, Fields
from uwserver_adapters.mavlink.wire.frames import Decoder
from uwserver_adapters.mavlink.wire.streams import Streams

Outgoing = tuple[str, Fields]
"""A message to send: its name and fields."""

BACKLOG = 16
"""Downloads (parameters, files) that may be in progress on a channel. A new one ends the oldest."""


class Channel:
    """The state of one conversation.

    Args:
        number: number of the channel, which no later channel uses again.
        name: the channel as a user would type it.
        dialect: the messages, for the decoder.
        write: sends bytes; returns False when the peer does not keep up.
        is_ready: returns whether a download may send more now.
        streams: which telemetry it gets how often.
        frames_per_s: most frames that are accepted per second.

    Attributes:
        seq: sequence number of the next frame.
        backlog: downloads in progress, of which a few messages are sent at a time.
        heard_at: loop time of the last good frame, s.
        is_heard: a good frame has been received.
        has_peer: a peer has spoken, or is known to be there.
        allowance: download messages that may be sent before the next tick.
        meter: limits the frames that are accepted.
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
        self.backlog: deque[Iterator[Outgoing]] = deque(maxlen=BACKLOG)
        self.heard_at = 0.0
        self.is_heard = False
        self.has_peer = False
        self.allowance = 0
        self.meter = RateMeter(frames_per_s)

    def next_seq(self) -> int:
        """Return the sequence number of the frame that is written next."""
        seq = self.seq
        self.seq = (seq + 1) & 0xFF
        return seq
