"""The connections of our own MOOSDB: greeting, packets in, mail out, and what happens to a client that misbehaves."""

from __future__ import annotations

import asyncio
import socket
from collections import deque
from typing import TYPE_CHECKING, cast

from uwserver_adapters.moos import wire
from uwserver_adapters.moos.database import Letter
from uwserver_adapters.moos.wire import Hello, Malformed, Message

if TYPE_CHECKING:
    from uwserver_adapters.moos.moosdb import MoosDbAdapter

NAME_S = 5.0
"""Wall time in which a client must have said its name."""
TURN_S = 0.002
"""Wall time after which other clients have their turn."""
TOGETHER = 1000
"""Messages in one packet at most: C++ clients throw away mail above 2048 that are unread."""
HELD = 2048
"""Mail that waits for a synchronous client to ask; the oldest is dropped above."""
CLIENT_NAME_LIMIT = 128


class Guest(asyncio.Protocol):
    """One client of our database; all its methods run on the loop.

    Attributes:
        name: "" before it has said it.
        heard: wall time (of the loop) of its last packet.
    """

    def __init__(self, adapter: MoosDbAdapter) -> None:
        self.name = ""
        self._adapter = adapter
        self._stats = adapter.context.stats
        self._loop = asyncio.get_running_loop()
        self.heard = self._loop.time()
        self._decoder = wire.Decoder(expects_hello=True, limit=adapter.config.packet_bytes)
        self._transport: asyncio.Transport
        self._is_asynchronous = True
        self._mail: deque[bytes] = deque()
        self._first: bytes | None = None
        self._flushing: asyncio.Handle | None = None
        self._turn: asyncio.Handle | None = None
        self._is_closed = False

    # -- asyncio --------------------------------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; one too many is told and sent away."""
        self._transport = cast(asyncio.Transport, transport)
        if not self._adapter.enter(self):
            most = self._adapter.config.max_clients
            self._poison(f"{most} clients are connected: close some, or raise max_clients of the adapter")

    def connection_lost(self, error: Exception | None) -> None:
        """It went, or we closed."""
        self._close()
        self._adapter.exit(self)

    def data_received(self, data: bytes) -> None:
        """Take bytes in pieces of any size."""
        if self._is_closed:
            return
        self.heard = self._loop.time()
        self._decoder.receive(data)
        if self._turn is None:
            self._work()

    def _work(self) -> None:
        self._turn = None
        end = self._loop.time() + TURN_S
        while not self._is_closed and (event := self._decoder.next_event()) is not wire.NEED_DATA:
            if isinstance(event, Malformed):
                self._fault(event.text)
                return
            if not isinstance(event, Hello):
                if self.name:
                    self._packet(event.messages)
                else:
                    self._greet(event.messages)
            if self._loop.time() > end:
                self._transport.pause_reading()
                self._turn = self._loop.call_soon(self._work)
                return
        if not self._is_closed:
            self._transport.resume_reading()

    # -- in -------------------------------------------------------------------------------------------------------------------------

    def _greet(self, messages: tuple[Message, ...]) -> None:
        adapter = self._adapter
        first = messages[0] if messages else Message(wire.NULL, "")
        name = first.text
        if first.type != wire.DATA or not 0 < len(name) <= CLIENT_NAME_LIMIT:
            self._poison(f"say your name, 1 to {CLIENT_NAME_LIMIT} characters, in the first message")
            return
        if not adapter.is_free(name):
            self._poison(f'A client of this name ("{name}") already exists')
            return
        self._is_asynchronous = first.key == wire.ASYNCHRONOUS
        now = adapter.clock.now()
        welcome = Message(
            wire.WELCOME, "", now - first.time, wire.ASYNCHRONOUS.encode(), src_aux=f"hostname={socket.gethostname()}",
            community=adapter.config.community, time=now,
        )  # fmt: skip
        self._transport.write(wire.packet([wire.encode(welcome)]))
        self.name = name
        adapter.joined(self)

    def _packet(self, messages: tuple[Message, ...]) -> None:
        adapter = self._adapter
        if messages and messages[0].type == wire.TIMING:
            first = messages[0]
            adapter.database.beat(self.name, first.time)
            echo = Message(wire.TIMING, first.key, adapter.clock.now(), src=first.src, time=first.time, number2=0.0)
            self._first = wire.encode(echo)
        for message in messages:
            adapter.take(self, message)
        if not self._is_asynchronous:
            self._answer()
        elif self._first is not None:
            self._wake()

    # -- out ------------------------------------------------------------------------------------------------------------------------

    def deliver(self, letter: Letter) -> None:
        """Mail; all that comes in one turn of the loop leaves together."""
        self._mail.append(letter.data)
        if not self._is_asynchronous:
            if len(self._mail) > HELD:
                self._mail.popleft()
                self._stats.dropped += 1
        else:
            self._wake()

    def _wake(self) -> None:
        if self._flushing is None and not self._is_closed:
            self._flushing = self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._flushing = None
        if self._transport.get_write_buffer_size() > self._adapter.config.queue_bytes:
            self._stats.dropped += len(self._mail)
            self._fault(f"more than {self._adapter.config.queue_bytes} bytes waited for it: it must read faster")
            return
        while self._mail or self._first is not None:
            messages = [] if self._first is None else [self._first]
            self._first = None
            while self._mail and len(messages) < TOGETHER:
                messages.append(self._mail.popleft())
            self._write(messages)

    def _answer(self) -> None:
        """The one packet that a synchronous client gets for each of its own."""
        null = wire.encode(Message(wire.NULL, "", self._adapter.clock.now()))
        self._first = None
        self._write([null, *self._mail])
        self._mail.clear()

    def _write(self, messages: list[bytes]) -> None:
        data = wire.packet(messages)
        self._stats.samples_sent += len(messages)
        self._stats.bytes_sent += len(data)
        self._transport.write(data)

    # -- end ------------------------------------------------------------------------------------------------------------------------

    def check(self, now: float) -> None:
        """End it when it has been silent for too long."""
        limit = self._adapter.config.client_timeout_s if self.name else NAME_S
        if not self._is_closed and now - self.heard > limit:
            self._fault(f"silent for {limit:g} s")

    def _fault(self, text: str) -> None:
        self._stats.errors += 1
        self._stats.last_error = f"{self.name or 'a client'}: {text}"
        self._adapter.note(self.name, text)
        self._close()
        self._transport.abort()

    def _poison(self, reason: str) -> None:
        self._stats.errors += 1
        self._stats.last_error = reason
        poison = Message(
            wire.POISON,
            "",
            data=reason.encode("utf-8", "surrogateescape"),
            kind=wire.STRING,
            time=self._adapter.clock.now(),
        )
        self._transport.write(wire.packet([wire.encode(poison)]))
        self._close()
        self._transport.close()
        self._loop.call_later(1.0, self._transport.abort)

    def _close(self) -> None:
        self._is_closed = True
        for handle in (self._flushing, self._turn):
            if handle is not None:
                handle.cancel()
        self._mail.clear()

    def abort(self) -> None:
        """End it at once."""
        self._close()
        self._transport.abort()
