"""The topics that one client hears, throttled and queued as it asked, in the form that it asked for."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Protocol

import msgspec

from uwserver_adapters.native.outbox import Delivery, Outgoing
from uwserver_adapters.ros.feed import OutgoingMessage
from uwserver_adapters.rosbridge.codec import fragments, json_text, published, published_raw, text_frame

LONGEST_QUEUE = 1000
"""Most messages of a topic that wait for a client that throttles it."""


@dataclass(frozen=True)
class Options:
    """The options of one `subscribe` or another request.

    Attributes:
        throttle_s: least wall time between two messages, s.
        queue_length: most messages that wait meanwhile; with 0 they are dropped.
        fragment_size: longest message that is sent in one piece, characters; None for no limit.
        compression: one of `uwserver_adapters.rosbridge.codec.COMPRESSIONS`.
    """

    throttle_s: float = 0.0
    queue_length: int = 0
    fragment_size: int | None = None
    compression: str = "none"


class TopicMessage(Protocol):
    """A message of the world, or of another client.

    Attributes:
        size: about how many bytes it holds while it waits.
    """

    size: int

    def frame(self, topic: str, compression: str) -> bytes | None:
        """Return the message in one frame; None where it has no such form."""

    def text(self, topic: str) -> bytes | None:
        """Return the whole JSON text."""


class WorldMessage:
    """A message of the world. Each form is made once for all clients."""

    def __init__(self, outgoing: OutgoingMessage, t_ns: int) -> None:
        self._outgoing, self._t_ns = outgoing, t_ns
        self.size = outgoing.size

    def frame(self, topic: str, compression: str) -> bytes | None:
        """See `TopicMessage`."""
        outgoing = self._outgoing

        def make() -> bytes | None:
            if compression == "cbor-raw":
                return None if outgoing.raw is None else published_raw(topic, outgoing.raw, self._t_ns)
            return None if outgoing.plain is None else published(topic, outgoing.plain, compression)

        return outgoing.encoded(compression, make)

    def text(self, topic: str) -> bytes | None:
        """See `TopicMessage`."""
        plain = self._outgoing.plain
        message = {"op": "publish", "topic": topic, "msg": plain}
        return self._outgoing.encoded("text", lambda: None if plain is None else json_text(message))


class ClientMessage:
    """A message of another client, passed on as it came. Each form is made once for all clients."""

    def __init__(self, message: object) -> None:
        self._json = json_text(message)
        self._frames: dict[str, bytes] = {}
        self.size = len(self._json)

    def frame(self, topic: str, compression: str) -> bytes | None:
        """See `TopicMessage`. Its ROS bytes are unknown: "cbor-raw" gets CBOR instead."""
        form = "cbor" if compression == "cbor-raw" else compression
        if form not in self._frames:
            self._frames[form] = published(topic, msgspec.json.decode(self._json), form)
        return self._frames[form]

    def text(self, topic: str) -> bytes | None:
        """See `TopicMessage`."""
        return b'{"op":"publish","topic":%b,"msg":%b}' % (json_text(topic), self._json)


class Room:
    """The memory for messages that wait because a client throttles them, for all its topics together.

    Args:
        most_bytes: most bytes that may wait.

    Attributes:
        most_bytes: as given.
        used: bytes that wait.
    """

    def __init__(self, most_bytes: int) -> None:
        self.used, self.most_bytes = 0, most_bytes


class Subscription:
    """A topic that one client hears.

    Several `subscribe` of a topic are merged: the highest rate, the longest queue, the smallest pieces, and the last compression.

    Args:
        topic: its name.
        outbox: outbox of the client.
        flush: sends what waits in the outbox.
        room: room of the client.

    Attributes:
        options: those of each `subscribe`, by its id.
    """

    def __init__(self, topic: str, outbox: Outgoing, flush: Callable[[], None], room: Room) -> None:
        self.topic = topic
        self.options: dict[Hashable, Options] = {}
        self._outbox, self._flush, self._room = outbox, flush, room
        self._loop = asyncio.get_running_loop()
        self._merged = Options()
        self._next = 0.0
        self._waiting: deque[TopicMessage] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._pieces = 0

    def add(self, key: Hashable, options: Options) -> None:
        """Add a `subscribe` with this id, or replace the one with the same id."""
        self.options[key] = options
        self._merge(options.compression)

    def remove(self, key: Hashable) -> bool:
        """Remove a `subscribe`, or all where `key` is None; return whether none is left."""
        if key is None:
            self.options.clear()
        else:
            self.options.pop(key, None)
        if self.options:
            self._merge(next(reversed(self.options.values())).compression)
        return not self.options

    def _merge(self, compression: str) -> None:
        every = self.options.values()
        sizes = [one.fragment_size for one in every if one.fragment_size is not None]
        self._merged = Options(
            min(one.throttle_s for one in every), max(one.queue_length for one in every), min(sizes, default=None), compression
        )  # fmt: skip
        while len(self._waiting) > self._merged.queue_length:
            self._oldest()

    def put(self, message: TopicMessage) -> None:
        """Send a message of the topic, let it wait, or drop it."""
        throttle_s, now = self._merged.throttle_s, self._loop.time()
        if not throttle_s:
            self._send(message)
        elif now >= self._next and not self._waiting:
            # A message that is a little late does not delay those after it.
            is_steady = now - self._next < throttle_s
            self._next = max(self._next + throttle_s, now) if is_steady else now + throttle_s
            self._send(message)
        elif self._merged.queue_length:
            self._wait(message)

    def _wait(self, message: TopicMessage) -> None:
        """Let a message wait; the oldest of the topic are dropped for it. It is dropped itself if other topics leave too little room."""
        room = self._room
        while self._waiting and (
            len(self._waiting) >= self._merged.queue_length or room.used + message.size > room.most_bytes
        ):
            self._oldest()
        if room.used + message.size > room.most_bytes:
            return
        room.used += message.size
        self._waiting.append(message)
        if self._timer is None:
            self._timer = self._loop.call_at(self._next, self._release)

    def _oldest(self) -> TopicMessage:
        message = self._waiting.popleft()
        self._room.used -= message.size
        return message

    def _release(self) -> None:
        self._timer = None
        if self._waiting:
            self._send(self._oldest())
            self._flush()
            self._next = self._loop.time() + self._merged.throttle_s
        if self._waiting:
            self._timer = self._loop.call_at(self._next, self._release)

    def _send(self, message: TopicMessage) -> None:
        size, compression = self._merged.fragment_size, self._merged.compression
        if size is not None and compression in ("none", "png"):
            text = message.text(self.topic)
            frame = None if text is None else text_frame(text)
            if text is not None and len(text) > size:
                self._pieces += 1
                frame = b"".join(fragments(text, size, self._pieces))
        else:
            frame = message.frame(self.topic, compression)
        if frame is not None:
            # With a queue of one a client gets the newest, however slowly it reads; else it loses the oldest when too much waits.
            delivery: Delivery = "latest" if self._merged.queue_length == 1 else "ring"
            self._outbox.put_sample(self.topic, frame, delivery)

    def close(self) -> None:
        """Drop what waits; nothing is sent any more."""
        while self._waiting:
            self._oldest()
        if self._timer is not None:
            self._timer.cancel()
