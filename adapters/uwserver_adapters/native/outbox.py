"""What waits to be sent to one client: replies that must not be lost, samples that may be. Knows no socket."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, Protocol

from uwserver.adapter import AdapterStats

BEHIND = 1024
"""Messages that may wait for a sample that is still in work; with one more the sample is waited for."""
Delivery = Literal["latest", "ring", "reliable"]

REPLIES = 1024
"""Replies, events and progress that may wait for a client that does not read."""
QUEUE_BYTES = 16 << 20
"""Bytes of them, and as many of samples: no further one is queued on top of so much."""
BATCH_BYTES = 1 << 16
"""About as much is given to the transport at once, so that what does not fit stays here, where it can still be dropped."""


class Outgoing(Protocol):
    """Where answers and samples for one client go, whatever carries them.

    Attributes:
        deliveries: how samples can be delivered.
        largest: longest message that can be carried, bytes; None when any can.
        has_places: whether `put_later` may be used.
    """

    deliveries: tuple[Delivery, ...]
    largest: int | None
    has_places: bool

    def put_reply(self, message: bytes) -> None:
        """What must not be lost on our side."""

    def put_sample(self, key: Hashable, message: bytes, delivery: Delivery) -> None:
        """What may be dropped."""

    def put_later(self, key: Hashable, delivery: Delivery, hurry: Callable[[], bool]) -> Callable[[bytes | None], None]:
        """A place for a sample that is still in work, which all that is put later waits for; to be called with the sample, or None for none.

        Args:
            key, delivery: as of `put_sample`.
            hurry: waits until one sample more is there that was in work; False where none is.
        """

    def gather(self) -> None:
        """A tick has ended: nothing of the next replaces what the peer has time for. `flush` follows."""

    def flush(self) -> None:
        """Send what waits."""


@dataclass(eq=False)
class _Place:
    """Of a sample in work, and what was put after it: replies have no delivery; None is the end of a tick."""

    key: Hashable
    delivery: Delivery
    hurry: Callable[[], bool]
    message: bytes | None = None
    is_filled: bool = False
    behind: list[tuple[Hashable, bytes, Delivery | None] | None] = field(default_factory=list)


class Outbox:
    """Two kinds of queue, all bounded.

    Replies, events and progress leave in their order and before any waiting sample; too many of them end the connection. Samples wait as their
    subscription says: `ring` drops the oldest of all ring samples, `latest` keeps one sample a key, `reliable` ends the connection instead.

    Args:
        write: gives bytes to the transport.
        overflow: ends the connection, with a last text.
        capacity: samples that may wait, for each kind of delivery.
        most_bytes: of samples that may wait, and of replies; a single one may be longer.
        stats: counts what is sent and dropped.

    Attributes:
        paused: the transport takes nothing now.
        dropped: samples that this client lost.
    """

    deliveries: tuple[Delivery, ...] = ("latest", "ring", "reliable")
    largest: int | None = None
    has_places = True

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
    def has_time(self) -> bool:
        """Whether the transport takes all that comes now: nothing has to wait."""
        return not (self.paused or self._closed)

    def put_at_once(self, samples: bytes, count: int) -> None:
        """Give samples to the transport, while it `has_time`; behind all that waits for it."""
        self.gather()
        self._stats.samples_sent += count
        self._gathered.append(samples)
        self._gathered_bytes += len(samples)
        if self._gathered_bytes >= BATCH_BYTES:
            self._write_gathered()

    def put_reply(self, message: bytes) -> None:
        """Queue what must not be lost; `flush` sends it."""
        if not self._waits((None, message, None)):
            self._put_reply(message)

    def _put_reply(self, message: bytes) -> None:
        if self._closed:
            return
        if len(self._replies) >= REPLIES or self._reply_bytes > self._most_bytes:
            self.flush()
            if self._replies:
                self._overflow(self._too_many_replies())
                return
        self._replies.append(message)
        self._reply_bytes += len(message)

    def put_sample(self, key: Hashable, message: bytes, delivery: Delivery) -> None:
        """Queue a sample; `key` tells which older one it replaces where only the latest counts."""
        if not self._waits((key, message, delivery)):
            self._put_sample(key, message, delivery)

    def put_later(self, key: Hashable, delivery: Delivery, hurry: Callable[[], bool]) -> Callable[[bytes | None], None]:
        """See `Outgoing`."""
        place = _Place(key, delivery, hurry)
        if not self._closed:
            self._places.append(place)
        return partial(self._fill, place)

    def _waits(self, entry: tuple[Hashable, bytes, Delivery | None] | None) -> bool:
        """Whether something is kept behind a sample that is in work."""
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
                self._put_sample(first.key, first.message, first.delivery)
            for entry in first.behind:
                if entry is None:
                    self._gather()
                elif entry[2] is None:
                    self._put_reply(entry[1])
                else:
                    self._put_sample(entry[0], entry[1], entry[2])
        self.flush()

    def _put_sample(self, key: Hashable, message: bytes, delivery: Delivery) -> None:
        if self._closed:
            return
        if delivery == "latest":
            replaced = self._latest.pop(key, None)
            if replaced is not None:
                self._drop(replaced)
            if self._sample_bytes + len(message) <= self._most_bytes:  # as nearly always
                self._sample_bytes += len(message)
                self._latest[key] = message
                return
        queue = self._reliable if delivery == "reliable" else self._ring
        is_full = delivery != "latest" and len(queue) >= self._capacity
        if (is_full or not self._has_room(len(message))) and not self._make_room(len(message), delivery):
            self._overflow(self._too_slow())
            return
        self._sample_bytes += len(message)
        if delivery == "latest":
            self._latest[key] = message
        else:
            queue.append(message)

    def _has_room(self, size: int) -> bool:
        return not self._sample_bytes or self._sample_bytes + size <= self._most_bytes

    def _make_room(self, size: int, delivery: Delivery) -> bool:
        """Whether there is room now. What may be lost is dropped for it, the oldest first."""
        # More samples than the queue holds may come in one tick of a large world: they are dropped only if the peer is slow.
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
        self._count_drop()

    def _count_drop(self) -> None:
        self.dropped += 1
        self._stats.dropped += 1

    def _too_slow(self) -> str:
        return (
            f'disconnected: {len(self._reliable)} samples of a "reliable" subscription waited unread; read faster, subscribe with a lower '
            '"rate_hz" or with delivery "ring", or raise queue_samples or queue_bytes of the adapter'
        )

    def _too_many_replies(self) -> str:
        return (
            f"disconnected: {len(self._replies)} replies with {self._reply_bytes} bytes waited unread; "
            "read the replies while you send requests"
        )

    def gather(self) -> None:
        """Keep for the transport what it takes, as it would be given to it now; much is given at once."""
        self._gather()
        if self._places and self._places[-1].behind[-1:] != [None]:
            self._waits(None)

    def _gather(self) -> None:
        while not self.paused and (batch := self._take()):
            self._gathered.append(batch)
            self._gathered_bytes += len(batch)
            if self._gathered_bytes >= BATCH_BYTES:
                self._write_gathered()

    def flush(self) -> None:
        """Give to the transport what it takes."""
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
        if not (self._replies or self._reliable or self._ring) and self._sample_bytes < BATCH_BYTES:
            return self._take_latest()
        parts: list[bytes] = []
        size = 0
        while self._replies and size < BATCH_BYTES:
            parts.append(self._replies.popleft())
            size += len(parts[-1])
        self._reply_bytes -= size
        replies, reply_size = len(parts), size
        for queue in (self._reliable, self._ring):
            while queue and size < BATCH_BYTES:
                parts.append(queue.popleft())
                size += len(parts[-1])
        while self._latest and size < BATCH_BYTES:
            parts.append(self._latest.pop(next(iter(self._latest))))
            size += len(parts[-1])
        self._sample_bytes -= size - reply_size
        self._stats.samples_sent += len(parts) - replies
        return b"".join(parts)

    def _take_latest(self) -> bytes:
        """All of them, in their order, where they are all that waits, and not much."""
        batch = b"".join(self._latest.values())
        self._stats.samples_sent += len(self._latest)
        self._latest.clear()
        self._sample_bytes = 0
        return batch

    def resume(self) -> None:
        """The transport takes bytes again."""
        self.paused = False
        self.flush()

    def close(self) -> None:
        """Forget everything; nothing is taken any more."""
        self._closed = True
        self._places.clear()
        for queue in (self._replies, self._ring, self._reliable):
            queue.clear()
        self._latest.clear()
        self._gathered.clear()
        self._gathered_bytes = 0
