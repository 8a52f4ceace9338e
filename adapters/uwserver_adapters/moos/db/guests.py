"""The connections of our own MOOSDB: greeting, packets in, mail out, and what happens to a client that misbehaves."""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator
from typing import Protocol

from uwserver.adapter import AdapterContext, Connection, Peers
from uwserver.ports import Fault
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.clock import DatabaseClock
from uwserver_adapters.moos.config import MoosDbConfig
from uwserver_adapters.moos.db.database import PIECE, Database
from uwserver_adapters.moos.db.variable import Letter
from uwserver_adapters.moos.wire import Malformed, Message, Packet

log = logging.getLogger(__name__)

NAME_S = 5.0
"""Wall time in which a client must have said its name."""
TOGETHER, TOGETHER_BYTES = 1000, 1 << 18
"""Messages in one packet at most, as C++ clients throw away mail above 2048 that are unread; and bytes, unless one message has more: joining
many would hold the interpreter."""
AT_ONCE, SPENT = 256, 3 * PIECE
"""Notifications of a packet that take effect together, and their work (`Database.spent`) where many hear them: about 0.5 ms. Behind so many of
them others may have their turn."""
HELD = 2048
"""Mail that waits for a synchronous client to ask; the oldest is dropped above, and above `queue_bytes`."""
CLIENT_NAME_LIMIT = 128


class Batch:
    """Mail of one client, and its packets, each with how many messages it has: many clients hear the same."""

    def __init__(self, letters: list[Letter]) -> None:
        self.letters = letters
        self.packets: list[tuple[bytes, int]] = []
        together: list[bytes] = []
        size = 0
        for letter in letters:
            data = letter.data
            if together and (len(together) == TOGETHER or size + len(data) > TOGETHER_BYTES):
                self.packets.append((wire.packet(together), len(together)))
                together, size = [], 0
            together.append(data)
            size += len(data)
        if together:
            self.packets.append((wire.packet(together), len(together)))


class Host(Protocol):
    """Whose guests they are: it has the database, room and names."""

    config: MoosDbConfig
    context: AdapterContext
    clock: DatabaseClock
    database: Database
    peers: Peers[Guest]

    def is_free(self, name: str) -> bool:
        """Whether no other client has this name."""

    def joined(self, guest: Guest) -> None:
        """A client has said its name."""

    def left(self, guest: Guest) -> None:
        """A client is gone."""

    def has_mail(self, guest: Guest) -> None:
        """It wants to send, with all others, at the end of this turn of the loop."""


class Guest(Connection):
    """One client of our database; all its methods run on the loop.

    Args:
        host: of the database.

    Attributes:
        name: "" before it has said it.
        heard: wall time (of the loop) of its last packet.
    """

    def __init__(self, host: Host) -> None:
        super().__init__(host.peers, NAME_S)
        self.name = ""
        self.heard = self.loop.time()
        self._host = host
        self._stats = host.context.stats
        self._decoder = wire.Decoder(expects_hello=True, limit=host.config.packet_bytes)
        self._is_asynchronous = True
        self._mail: list[Letter] = []
        self._held = 0
        self._is_due = False
        self._steps: Iterator[None] | None = None

    # -- a connection ---------------------------------------------------------------------------------------------------------------

    def refused(self, fault: Fault) -> bytes:
        """The packet that one client too many gets, or one that did not say its name."""
        return self._poison(fault.text)

    def closed(self) -> None:
        """It went, or we closed."""
        self._mail.clear()
        if self.name:
            self._host.left(self)

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self.heard = self.loop.time()
        self._decoder.receive(data)

    def step(self) -> bool:
        """Take the next packet, or the next costly request of one."""
        self._steps = self._steps or self._read()
        for _ in self._steps:
            return True
        self._steps = None
        return False

    def _read(self) -> Iterator[None]:
        """Take one packet after the other. Others may have their turn between them, and also within: behind each request, which
        may cost much, and behind many notifications: fewer of them take effect together."""
        while (event := self._decoder.next_event()) is not None:
            if isinstance(event, Malformed):
                self._fault(event.text)
            elif isinstance(event, Packet):
                if self.name:
                    yield from self._packet(event.messages)
                else:
                    self._greet(event.messages)
            yield

    # -- in -------------------------------------------------------------------------------------------------------------------------

    def _greet(self, messages: tuple[Message, ...]) -> None:
        host = self._host
        first = messages[0] if messages else Message(wire.NULL, "")
        name = first.text if len(first.data) <= wire.NAMES_LIMIT else ""
        if first.type != wire.DATA or not 0 < len(name) <= CLIENT_NAME_LIMIT:
            self._send_away(f"say your name, 1 to {CLIENT_NAME_LIMIT} characters, in the first message")
            return
        if not host.is_free(name):
            self._send_away(f'A client of this name ("{name}") already exists')
            return
        if not self.admit():
            return
        self._is_asynchronous = first.key == wire.ASYNCHRONOUS
        now = host.clock.now()
        welcome = Message(
            wire.WELCOME, "", now - first.time, wire.ASYNCHRONOUS.encode(), src_aux=f"hostname={socket.gethostname()}",
            community=host.config.community, time=now,
        )  # fmt: skip
        self.write(wire.packet([wire.encode(welcome)]))
        self.name = name
        host.joined(self)

    def _packet(self, messages: tuple[Message, ...]) -> Iterator[None]:
        host = self._host
        if messages and messages[0].type == wire.TIMING:
            first = messages[0]
            host.database.beat(self.name, first.time)
            if self._is_asynchronous:
                echo = Message(wire.TIMING, first.key, host.clock.now(), src=first.src, time=first.time, number2=0.0)
                self._send(wire.packet([wire.encode(echo)]), 1)
        start = host.database.spent
        for number, message in enumerate(messages, 1):
            known = len(host.database.variables)
            yield from host.database.steps(self.name, message)
            is_new = len(host.database.variables) != known  # which is compared with all that clients look for
            is_much = host.database.spent - start >= SPENT
            if message.type != wire.NOTIFY or is_new or is_much or number % AT_ONCE == 0:
                yield
                start = host.database.spent
        if not self._is_asynchronous:
            self._answer()

    # -- out ------------------------------------------------------------------------------------------------------------------------

    def deliver(self, letter: Letter) -> None:
        """Mail; all that comes in one turn of the loop leaves together."""
        self._mail.append(letter)
        if not self._is_asynchronous:
            self._hold(letter)
        elif not self._is_due:
            self._is_due = True
            self._host.has_mail(self)

    def _hold(self, letter: Letter) -> None:
        """Keep mail until it is asked for, within bounds."""
        self._held += len(letter.message.data)
        while len(self._mail) > HELD or self._held > self._host.config.queue_bytes:
            self._held -= len(self._mail.pop(0).message.data)
            self._stats.dropped += 1

    def send_mail(self, last: Batch) -> Batch:
        """Send what is there.

        Args:
            last: what another client has just got.

        Returns:
            What this one has got.
        """
        mail, self._mail = self._mail, []
        self._is_due = False
        batch = last if mail == last.letters else Batch(mail)
        for packet, messages in batch.packets:
            self._send(packet, messages)
        return batch

    def _answer(self) -> None:
        """The one packet that a synchronous client gets for each of its own."""
        null = wire.encode(Message(wire.NULL, "", self._host.clock.now()))
        mail, self._mail, self._held = self._mail, [], 0
        self._send(wire.packet([null, *(letter.data for letter in mail)]), 1 + len(mail))

    def _send(self, packet: bytes, messages: int) -> None:
        if self.is_closing:
            return
        if self.waiting > self._host.config.queue_bytes:
            self._stats.dropped += messages
            self._fault(f"more than {self._host.config.queue_bytes} bytes waited for it: it must read faster")
            return
        self._stats.samples_sent += messages
        self._stats.bytes_sent += len(packet)
        self.write(packet)

    # -- end ------------------------------------------------------------------------------------------------------------------------

    def check(self, now: float) -> None:
        """End it when it has been silent for too long."""
        limit = self._host.config.client_timeout_s
        if self.name and not self.is_closing and now - self.heard > limit:
            self._fault(f"silent for {limit:g} s")

    def _fault(self, text: str) -> None:
        self._stats.errors += 1
        name = wire.readable(self.name) or "a client"
        self._stats.last_error = f"{name}: {text}"
        log.warning("%s disconnects %s: %s", self._host.context.name, name, text)
        self.abort()

    def _poison(self, reason: str) -> bytes:
        """The packet that ends a connection."""
        self._stats.errors += 1
        self._stats.last_error = wire.readable(reason)
        data = reason.encode("utf-8", "surrogateescape")
        poison = Message(wire.POISON, "", data=data, kind=wire.STRING, time=self._host.clock.now())
        return wire.packet([wire.encode(poison)])

    def _send_away(self, reason: str) -> None:
        self.farewell(self._poison(reason))
