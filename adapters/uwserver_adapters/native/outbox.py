"""What waits to be sent to one client: replies, which must not be lost, and samples, which may be. Knows no socket."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, Protocol

from uwserver.adapter import AdapterStats, TokenTable
from uwserver.table import Count

Delivery = Literal["latest", "ring", "reliable"]

BEHIND = 1024
"""Messages that may wait for a sample that is still being encoded. With one more the sample is waited for."""
REPLIES = 1024
"""Replies, events and progress that may wait for a client that does not read."""
QUEUE_BYTES = 16 << 20
"""Bytes of replies, and as many of samples, on top of which no further one is queued."""
BATCH_BYTES = 1 << 16
"""About as many bytes are given to the transport at a time. What the transport does not take stays here, where it can still be dropped."""


class OutboxTable(TokenTable, kw_only=True, frozen=True):
    """The keys of adapters whose clients have an outbox.

    Attributes:
        queue_samples: most samples that wait for a slow client; the oldest is dropped first.
        queue_bytes: most bytes of samples, and of replies, that wait for a slow client.
    """

    queue_samples: Count = 1024
    queue_bytes: Count = QUEUE_BYTES


class Outgoing(Protocol):
    """Takes answers and samples for one client, whatever carries them.

    Attributes:
        deliveries: deliveries of samples that are possible.
        largest: longest message that can be carried, bytes; None if there is no limit.
        can_put_later: whether `put_later` may be called.
    """

    deliveries: tuple[Delivery, ...]
    largest: int | None
    can_put_later: bool

    def put_reply(self, message: bytes) -> None:
        """Queue a message that must not be lost on our side."""

    def put_sample(self, key: Hashable, message: bytes, delivery: Delivery) -> None:
        """Queue a sample, which may be dropped."""

    def put_later(self, key: Hashable, delivery: Delivery, hurry: Callable[[], bool]) -> Callable[[bytes | None], None]:
        """Keep a place for a sample that is still being encoded. Everything that is put later waits for it.

        Args:
            key, delivery: as for `put_sample`.
            hurry: waits until one more of the unfinished samples is encoded; returns False if there is none.

        Returns:
            A function that must be called with the sample, or with None if there will be none.
        """

    def gather(self) -> None:
        """Note the end of a tick: samples for which the peer has time are not replaced by those of the next tick. `flush` follows."""

    def flush(self) -> None:
        """Send what waits."""


_Entry = tuple[Hashable, bytes, Delivery | None]
"""A message in the queue: key, bytes, and delivery of a sample; a reply has no delivery."""


@dataclass(eq=False)
class _Place:
    """The place of a sample that is being encoded, and what was put after it; None stands for the end of a tick."""

    key: Hashable
    delivery: Delivery
    hurry: Callable[[], bool]
    message: bytes | None = None
    is_filled: bool = False
    behind: list[_Entry | None] = field(default_factory=list)


class Outbox:
    """The queues of one client, all of them bounded.

    Replies, events and progress are sent in their order, and before any waiting sample; if too many wait, the connection ends. Samples wait as
    their subscription says: `ring` drops the oldest of all ring samples, `latest` keeps one sample for each key, `reliable` ends the connection
    instead of dropping.

    Args:
        write: gives bytes to the transport.
        overflow: ends the connection, with a last text.
        capacity: samples that may wait, for each kind of delivery.
        stats: counts what is sent and dropped.
        most_bytes: bytes of samples that may wait, and of replies; a single message may be longer.

    Attributes:
        paused: whether the transport takes nothing now.
        dropped: samples that this client has lost.
    """

    deliveries: tuple[Delivery, ...] = ("latest", "ring", "reliable")
    largest: int | None = None
    can_put_later = True

    def __init__(
        self,
        write: Callable[[bytes], None],
        overflow: Callable[[str], None],
        capacity: int,
        stats: AdapterStats,
        most_bytes: int = QUEUE_BYTES,
    ) -> None:
        self.paused = False
        self.dropped = 0
        self._write = write
        self._overflow = overflow
        self._capacity = capacity
        self._most_bytes = most_bytes
        self._stats = stats
        self._replies: deque[bytes] = deque()
        self._reply_bytes = 0
        self._sample_bytes = 0
        self._ring: deque[bytes] = deque()
        self._reliable: deque[bytes] = deque()
        self._latest: dict[Hashable, bytes] = {}
        self._gathered: list[bytes] = []
        self._gathered_bytes = 0
        self._closed = False
        self._places: deque[_Place] = deque()

    @property
    def is_empty(self) -> bool:
        """Whether everything was given to the transport."""
        return not (self._replies or self._reliable or self._ring or self._latest or self._gathered or self._places)

    @property
    def is_ready(self) -> bool:
        """Whether the transport takes everything now, so that nothing has to wait."""
        return not (self.paused or self._closed)

    # -- in ---------------------------------------------------------------------------------------------------------------------------

    def put_at_once(self, samples: bytes, count: int) -> None:
        """Give samples to the transport after everything that waits for it. Only while the outbox is ready."""
        self.gather()
        self._stats.samples_sent += count
        self._keep_for_transport(samples)

    def put_reply(self, message: bytes) -> None:
        """Queue a message that must not be lost; `flush` sends it."""
        self._put((None, message, None))

    def put_sample(self, key: Hashable, message: bytes, delivery: Delivery) -> None:
        """Queue a sample. With delivery `latest` it replaces the older sample with the same key."""
        self._put((key, message, delivery))

    def _put(self, entry: _Entry) -> None:
        if not self._waits(entry):
            self._queue(entry)

    def put_later(self, key: Hashable, delivery: Delivery, hurry: Callable[[], bool]) -> Callable[[bytes | None], None]:
        """See `Outgoing`."""
        place = _Place(key, delivery, hurry)
        if not self._closed:
            self._places.append(place)
        return partial(self._fill, place)

    def _waits(self, entry: _Entry | None) -> bool:
        """Return whether an entry was put behind a sample that is being encoded."""
        while self._places and len(self._places[-1].behind) >= BEHIND and self._places[0].hurry():
            pass
        if not self._places:
            return False
        self._places[-1].behind.append(entry)
        return True

    def _fill(self, place: _Place, message: bytes | None) -> None:
        place.message, place.is_filled = message, True
        while self._places and self._places[0].is_filled:
            first = self._places.popleft()
            if first.message is not None:
                self._queue((first.key, first.message, first.delivery))
            for entry in first.behind:
                if entry is None:
                    self._gather()
                else:
                    self._queue(entry)
        self.flush()

    def _queue(self, entry: _Entry) -> None:
        key, message, delivery = entry
        if self._closed:
            return
        if delivery is None:
            self._queue_reply(message)
            return
        if delivery == "latest":
            replaced = self._latest.pop(key, None)
            if replaced is not None:
                self._drop(replaced)
            if self._sample_bytes + len(message) <= self._most_bytes:
                # The fast path, for nearly all of them.
                self._sample_bytes += len(message)
                self._latest[key] = message
                return
        queue = self._reliable if delivery == "reliable" else self._ring
        is_full = delivery != "latest" and len(queue) >= self._capacity
        if (is_full or not self._has_room(len(message))) and not self._make_room(len(message), delivery):
            self._overflow(
                f'disconnected: {len(self._reliable)} samples of a "reliable" subscription waited unread; read faster, subscribe with a lower '
                '"rate_hz" or with delivery "ring", or raise queue_samples or queue_bytes of the adapter'
            )
            return
        self._sample_bytes += len(message)
        if delivery == "latest":
            self._latest[key] = message
        else:
            queue.append(message)

    def _queue_reply(self, message: bytes) -> None:
        if len(self._replies) >= REPLIES or self._reply_bytes > self._most_bytes:
            self.flush()
            if self._replies:
                self._overflow(
                    f"disconnected: {len(self._replies)} replies with {self._reply_bytes} bytes waited unread; "
                    "read the replies while you send requests"
                )
                return
        self._replies.append(message)
        self._reply_bytes += len(message)

    def _has_room(self, size: int) -> bool:
        return not self._sample_bytes or self._sample_bytes + size <= self._most_bytes

    def _make_room(self, size: int, delivery: Delivery) -> bool:
        """Drop samples that may be lost, the oldest first; return whether there is room now."""
        # More samples than the queue holds may come in one tick of a large world. They are dropped only if the peer is slow.
        self.flush()
        if delivery == "reliable" and len(self._reliable) >= self._capacity:
            return False
        while self._ring and (len(self._ring) >= self._capacity or not self._has_room(size)):
            self._drop(self._ring.popleft())
        while self._latest and not self._has_room(size):
            self._drop(self._latest.pop(next(iter(self._latest))))
        return delivery != "reliable" or self._has_room(size)

    def _drop(self, message: bytes) -> None:
        self._sample_bytes -= len(message)
        self.dropped += 1
        self._stats.dropped += 1

    # -- out --------------------------------------------------------------------------------------------------------------------------

    def gather(self) -> None:
        """Keep what the transport takes now in the form in which it would get it. If it is much, it is given to the transport at once."""
        self._gather()
        if self._places and self._places[-1].behind[-1:] != [None]:
            self._waits(None)

    def _gather(self) -> None:
        while not self.paused and (batch := self._take()):
            self._keep_for_transport(batch)

    def _keep_for_transport(self, batch: bytes) -> None:
        self._gathered.append(batch)
        self._gathered_bytes += len(batch)
        if self._gathered_bytes >= BATCH_BYTES:
            self._write_gathered()

    def flush(self) -> None:
        """Give the transport what it takes."""
        self._gather()
        if self._gathered and not self.paused:
            self._write_gathered()

    def _write_gathered(self) -> None:
        batch = b"".join(self._gathered)
        self._gathered.clear()
        self._gathered_bytes = 0
        self._stats.bytes_sent += len(batch)
        self._write(batch)

    def _take(self) -> bytes:
        """Take the next messages from the queues, about `BATCH_BYTES` of them."""
        if not (self._replies or self._reliable or self._ring) and self._sample_bytes < BATCH_BYTES:
            # The fast path: only a few `latest` samples wait.
            batch = b"".join(self._latest.values())
            self._stats.samples_sent += len(self._latest)
            self._latest.clear()
            self._sample_bytes = 0
            return batch
        parts: list[bytes] = []
        size = _move(self._replies, parts, 0)
        self._reply_bytes -= size
        replies, reply_size = len(parts), size
        for queue in (self._reliable, self._ring):
            size = _move(queue, parts, size)
        while self._latest and size < BATCH_BYTES:
            parts.append(self._latest.pop(next(iter(self._latest))))
            size += len(parts[-1])
        self._sample_bytes -= size - reply_size
        self._stats.samples_sent += len(parts) - replies
        return b"".join(parts)

    def resume(self) -> None:
        """Go on sending: the transport takes bytes again."""
        self.paused = False
        self.flush()

    def close(self) -> None:
        """Forget everything, and take nothing any more."""
        self._closed = True
        self._places.clear()
        for queue in (self._replies, self._ring, self._reliable):
            queue.clear()
        self._latest.clear()
        self._gathered.clear()
        self._gathered_bytes = 0


def _move(queue: deque[bytes], parts: list[bytes], size: int) -> int:
    """Move messages of a queue to a batch that has a size, bytes; return its new size."""
    while queue and size < BATCH_BYTES:
        parts.append(queue.popleft())
        size += len(parts[-1])
    return size
