"""What waits to be sent to one client: replies that must not be lost, samples that may be. Knows no socket."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from typing import Literal

from uwserver.adapter import AdapterStats

Delivery = Literal["latest", "ring", "reliable"]

REPLIES = 1024
"""Replies, events and progress that may wait for a client that does not read."""
REPLY_BYTES = 16 << 20
"""Bytes of them: no further one is queued on top of so much."""
BATCH_BYTES = 1 << 16
"""About as much is given to the transport at once, so that what does not fit stays here, where it can still be dropped."""

_TOO_MANY_REPLIES = f"disconnected: {REPLIES} replies or {REPLY_BYTES >> 20} MiB of them waited unread; read the replies while you send requests"


class Outbox:
    """Two kinds of queue, all bounded.

    Replies, events and progress leave in their order and before any waiting sample; too many of them end the connection. Samples wait as their
    subscription says: `ring` drops the oldest of all ring samples, `latest` keeps one sample a key, `reliable` ends the connection instead.

    Args:
        write: gives bytes to the transport.
        overflow: ends the connection, with a last text.
        capacity: samples that may wait, for each kind of delivery.
        stats: counts what is sent and dropped.

    Attributes:
        paused: the transport takes nothing now.
        dropped: samples that this client lost.
    """

    def __init__(
        self, write: Callable[[bytes], None], overflow: Callable[[str], None], capacity: int, stats: AdapterStats
    ) -> None:
        self.paused = False
        self.dropped = 0
        self._write = write
        self._overflow = overflow
        self._capacity = capacity
        self._stats = stats
        self._replies: deque[bytes] = deque()
        self._reply_bytes = 0
        self._ring: deque[bytes] = deque()
        self._reliable: deque[bytes] = deque()
        self._latest: dict[Hashable, bytes] = {}
        self._closed = False

    @property
    def is_empty(self) -> bool:
        """Whether everything was given to the transport."""
        return not (self._replies or self._reliable or self._ring or self._latest)

    def put_reply(self, message: bytes) -> None:
        """Queue what must not be lost; `flush` sends it."""
        if self._closed:
            return
        if len(self._replies) >= REPLIES or self._reply_bytes > REPLY_BYTES:
            self.flush()
            if self._replies:
                self._overflow(_TOO_MANY_REPLIES)
                return
        self._replies.append(message)
        self._reply_bytes += len(message)

    def put_sample(self, key: Hashable, message: bytes, delivery: Delivery) -> None:
        """Queue a sample; `key` tells which older one it replaces where only the latest counts."""
        if self._closed:
            return
        if delivery == "ring":
            if len(self._ring) >= self._capacity:
                self._make_room()
            self._ring.append(message)
        elif delivery == "latest":
            if self._latest.pop(key, None) is not None:
                self._count_drop()
            self._latest[key] = message
        else:
            if len(self._reliable) >= self._capacity:
                self.flush()
            if len(self._reliable) >= self._capacity:
                self._overflow(self._too_slow())
                return
            self._reliable.append(message)

    def _make_room(self) -> None:
        # More samples than the queue holds may come in one tick of a large world: they are dropped only if the peer is slow.
        self.flush()
        while len(self._ring) >= self._capacity:
            self._ring.popleft()
            self._count_drop()

    def _count_drop(self) -> None:
        self.dropped += 1
        self._stats.dropped += 1

    def _too_slow(self) -> str:
        return (
            f'disconnected: {self._capacity} samples of a "reliable" subscription waited unread; read faster, subscribe with a lower "rate_hz" '
            'or with delivery "ring", or raise queue_samples of the adapter'
        )

    def flush(self) -> None:
        """Give to the transport what it takes."""
        while not self.paused:
            batch = self._take()
            if not batch:
                return
            self._stats.bytes_sent += len(batch)
            self._write(batch)

    def _take(self) -> bytes:
        parts: list[bytes] = []
        size = 0
        while self._replies and size < BATCH_BYTES:
            parts.append(self._replies.popleft())
            size += len(parts[-1])
        self._reply_bytes -= size
        replies = len(parts)
        for queue in (self._reliable, self._ring):
            while queue and size < BATCH_BYTES:
                parts.append(queue.popleft())
                size += len(parts[-1])
        while self._latest and size < BATCH_BYTES:
            parts.append(self._latest.pop(next(iter(self._latest))))
            size += len(parts[-1])
        self._stats.samples_sent += len(parts) - replies
        return b"".join(parts)

    def resume(self) -> None:
        """The transport takes bytes again."""
        self.paused = False
        self.flush()

    def close(self) -> None:
        """Forget everything; nothing is taken any more."""
        self._closed = True
        for queue in (self._replies, self._ring, self._reliable):
            queue.clear()
        self._latest.clear()
