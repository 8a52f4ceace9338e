"""What one client hears: its topics, thinned and queued as it asked, in the form that it asked for."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Protocol

import msgspec

from uwserver_adapters.native.outbox import Outgoing
from uwserver_adapters.ros.feed import Told
from uwserver_adapters.rosbridge.codec import fragments, json_text, published, published_raw, text_frame

LONGEST_QUEUE = 1000
"""Messages of a topic that may wait for a client that throttles them."""


@dataclass(frozen=True)
class Wish:
    """What one `subscribe` asked for.

    Attributes:
        throttle_s: wall time between two messages, at least.
        queue_length: messages that wait meanwhile; 0: they are dropped.
        fragment_size: characters of a message at most, longer ones come in pieces; None: all in one.
        compression: one of `COMPRESSIONS`.
    """

    throttle_s: float = 0.0
    queue_length: int = 0
    fragment_size: int | None = None
    compression: str = "none"


class Message(Protocol):
    """What a subscription sends: a message of the world, or of another client.

    Attributes:
        size: about, bytes that it holds while it waits.
    """

    size: int

    def frame(self, topic: str, compression: str) -> bytes | None:
        """The message in one frame; None where it cannot be said so."""

    def text(self, topic: str) -> bytes | None:
        """The whole JSON text."""


class WorldMessage:
    """One of the world: each form is made once for all clients."""

    def __init__(self, told: Told, t_ns: int) -> None:
        self._told, self._t_ns = told, t_ns
        self.size = told.size

    def frame(self, topic: str, compression: str) -> bytes | None:
        """See `Message`."""
        return self._told.encoded(compression, lambda: self._made(topic, compression))

    def _made(self, topic: str, compression: str) -> bytes | None:
        if compression == "cbor-raw":
            raw = self._told.raw
            return None if raw is None else published_raw(topic, raw, self._t_ns)
        plain = self._told.plain
        return None if plain is None else published(topic, plain, compression)

    def text(self, topic: str) -> bytes | None:
        """See `Message`."""
        return self._told.encoded("text", lambda: self._text(topic))

    def _text(self, topic: str) -> bytes | None:
        plain = self._told.plain
        return None if plain is None else json_text({"op": "publish", "topic": topic, "msg": plain})


class ClientMessage:
    """One of another client, passed on as it came: each form is made once for all clients."""

    def __init__(self, message: object) -> None:
        self._json = json_text(message)
        self._frames: dict[str, bytes] = {}
        self.size = len(self._json)

    def frame(self, topic: str, compression: str) -> bytes | None:
        """See `Message`; its bytes in ROS' form are not known."""
        form = "cbor" if compression == "cbor-raw" else compression
        known = self._frames.get(form)
        if known is None:
            known = self._frames[form] = published(topic, msgspec.json.decode(self._json), form)
        return known

    def text(self, topic: str) -> bytes | None:
        """See `Message`."""
        return b'{"op":"publish","topic":%b,"msg":%b}' % (json_text(topic), self._json)


class Room:
    """What may wait for one client that throttles, all topics together.

    Args:
        most_bytes: of messages.

    Attributes:
        used: bytes that wait.
    """

    def __init__(self, most_bytes: int) -> None:
        self.used, self.most_bytes = 0, most_bytes


class Subscription:
    """A topic of one client; several `subscribe` of it are one: the lowest rate, the longest queue, the smallest pieces.

    Args:
        topic: its name.
        outbox: of the client.
        flush: sends what waits there.
        room: of the client.

    Attributes:
        wishes: by the id of each `subscribe`.
    """

    def __init__(self, topic: str, outbox: Outgoing, flush: Callable[[], None], room: Room) -> None:
        self.topic = topic
        self.wishes: dict[Hashable, Wish] = {}
        self._outbox, self._flush, self._room = outbox, flush, room
        self._loop = asyncio.get_running_loop()
        self._wish = Wish()
        self._next = 0.0
        self._waiting: deque[Message] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._pieces = 0

    def ask(self, key: Hashable, wish: Wish) -> None:
        """One more `subscribe`; one of the same id replaces it."""
        self.wishes[key] = wish
        self._merge(wish.compression)

    def give_up(self, key: Hashable) -> bool:
        """An `unsubscribe`; of all where `key` is None. Whether none is left."""
        if key is None:
            self.wishes.clear()
        else:
            self.wishes.pop(key, None)
        if self.wishes:
            self._merge(next(reversed(self.wishes.values())).compression)
        return not self.wishes

    def _merge(self, compression: str) -> None:
        wishes = self.wishes.values()
        sizes = [wish.fragment_size for wish in wishes if wish.fragment_size is not None]
        self._wish = Wish(
            min(wish.throttle_s for wish in wishes), max(wish.queue_length for wish in wishes), min(sizes, default=None), compression
        )  # fmt: skip
        while len(self._waiting) > self._wish.queue_length:
            self._oldest()

    def put(self, message: Message) -> None:
        """A message of the topic."""
        wish = self._wish
        if not wish.throttle_s:
            self._send(message)
            return
        now = self._loop.time()
        if now >= self._next and not self._waiting:
            self._next = (
                max(self._next + wish.throttle_s, now) if now - self._next < wish.throttle_s else now + wish.throttle_s
            )
            self._send(message)
        elif wish.queue_length:
            self._wait(message)

    def _wait(self, message: Message) -> None:
        """One more that waits; the oldest of the topic make way. What is too large beside other topics' is dropped."""
        room = self._room
        while self._waiting and (
            len(self._waiting) >= self._wish.queue_length or room.used + message.size > room.most_bytes
        ):
            self._oldest()
        if room.used + message.size > room.most_bytes:
            return
        room.used += message.size
        self._waiting.append(message)
        if self._timer is None:
            self._timer = self._loop.call_at(self._next, self._release)

    def _oldest(self) -> Message:
        message = self._waiting.popleft()
        self._room.used -= message.size
        return message

    def _release(self) -> None:
        self._timer = None
        if not self._waiting:
            return
        self._send(self._oldest())
        self._flush()
        self._next = self._loop.time() + self._wish.throttle_s
        if self._waiting:
            self._timer = self._loop.call_at(self._next, self._release)

    def _send(self, message: Message) -> None:
        wish = self._wish
        # A client that asked for a queue of one wants the newest, however slowly it reads; others lose the oldest when too much waits.
        delivery = "latest" if wish.queue_length == 1 else "ring"
        if wish.fragment_size is not None and wish.compression in ("none", "png"):
            text = message.text(self.topic)
            if text is not None and len(text) > wish.fragment_size:
                self._pieces += 1
                pieces = b"".join(fragments(text, wish.fragment_size, self._pieces))
                self._outbox.put_sample(self.topic, pieces, delivery)  # type: ignore[arg-type]
                return
            frame = None if text is None else text_frame(text)
        else:
            frame = message.frame(self.topic, wish.compression)
        if frame is not None:
            self._outbox.put_sample(self.topic, frame, delivery)  # type: ignore[arg-type]

    def close(self) -> None:
        """Nothing is sent any more."""
        while self._waiting:
            self._oldest()
        if self._timer is not None:
            self._timer.cancel()
