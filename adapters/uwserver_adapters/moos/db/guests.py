"""The connections of our own MOOSDB: greeting, packets in, mail out, and the end of a client that misbehaves."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Iterator

from uwserver.adapter import AdapterContext, BackgroundWork, Connection, Peers, Refusals
from uwserver.ports import Fault
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.clock import DatabaseClock, warp_of
from uwserver_adapters.moos.config import MoosDbConfig
from uwserver_adapters.moos.db.database import PIECE, Database
from uwserver_adapters.moos.db.variable import Letter
from uwserver_adapters.moos.wire import Malformed, MoosMessage, Packet

log = logging.getLogger(__name__)

NAME_S = 5.0
"""Wall time in which a client must have said its name."""
TOGETHER, TOGETHER_BYTES = 1000, 1 << 18
"""Most messages in one packet, as C++ clients drop unread mail above 2048 messages; and most bytes, unless one message has more: a larger packet
would hold the interpreter while it is joined."""
AT_ONCE, SPENT = 256, 3 * PIECE
"""Most notifications of a packet that take effect together, and the most work (`Database.spent`) of them, about 0.5 ms. After either others may have
their turn."""
HELD = 2048
"""Most messages that wait for a synchronous client to ask. The oldest are dropped above that, and above `queue_bytes`."""
CLIENT_NAME_LIMIT = 128
"""Longest name of a client, characters."""


class Batch:
    """Mail of one client, and its packets, each with its number of messages. Many clients get the same mail, so it is packed once."""

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


class Community:
    """A MOOSDB and its clients.

    Attributes:
        config, context: those of the adapter.
        clock: MOOS time of the community.
        database: its variables.
        peers: its connections.
        names: names of the database itself and of all clients.
    """

    def __init__(self, config: MoosDbConfig, context: AdapterContext, own_name: str) -> None:
        self._loop = asyncio.get_running_loop()
        self.config = config
        self.context = context
        self.clock = DatabaseClock(warp_of(context, config.warp))
        steady, warp = self._loop.time, self.clock.warp
        self.database = Database(config.community, self.clock.now, config.max_variables, lambda: steady() * warp)
        self.peers: Peers[Guest] = Peers(config.max_clients, Refusals(context.name, context.stats, steady))
        self._background = BackgroundWork()
        self.names = {own_name, self.database.name}
        self._with_mail: list[Guest] = []
        self._sending: asyncio.Handle | None = None

    def joined(self, guest: Guest) -> None:
        """Add a client that has said its name."""
        self.names.add(guest.name)
        self.context.stats.peers += 1
        self.database.join(guest.name, guest.deliver)

    def left(self, guest: Guest) -> None:
        """Remove a client."""
        self.names.remove(guest.name)
        self._background.add(self.database.leave(guest.name))
        self.context.stats.peers -= 1

    def has_mail(self, guest: Guest) -> None:
        """Let a client send its mail at the end of this turn of the loop, together with all others."""
        self._with_mail.append(guest)
        if self._sending is None:
            self._sending = self._loop.call_soon(self._send)

    def _send(self) -> None:
        self._sending = None
        guests, self._with_mail = self._with_mail, []
        batch = Batch([])
        for guest in guests:
            batch = guest.send_mail(batch)

    def close(self) -> None:
        """Send nothing more."""
        if self._sending is not None:
            self._sending.cancel()
        self._background.close()


class Guest(Connection):
    """The connection of one client. All its methods run on the loop.

    Args:
        community: community of the database.

    Attributes:
        name: name of the client; "" until it has said it.
    """

    def __init__(self, community: Community) -> None:
        super().__init__(community.peers, NAME_S)
        self.name = ""
        self._heard = self.loop.time()
        self._community = community
        self._stats = community.context.stats
        self._decoder = wire.Decoder(expects_hello=True, limit=community.config.packet_bytes)
        self._is_asynchronous = True
        self._mail: list[Letter] = []
        self._held = 0
        self._is_due = False
        self._steps: Iterator[None] | None = None

    # -- a connection ---------------------------------------------------------------------------------------------------------------

    def refused(self, fault: Fault) -> bytes:
        """Return the packet for a client that finds no place, or that did not say its name."""
        return self._poison(fault.text)

    def closed(self) -> None:
        """Forget the client."""
        self._mail.clear()
        if self.name:
            self._community.left(self)

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._heard = self.loop.time()
        self._decoder.receive(data)

    def step(self) -> bool:
        """Carry out a part of the stored packets."""
        self._steps = self._steps or self._read()
        for _ in self._steps:
            return True
        self._steps = None
        return False

    def _read(self) -> Iterator[None]:
        """Take one packet after the other. Others may have their turn after each packet, after each request in one, and after many
        notifications; notifications between two such turns take effect together."""
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

    def _greet(self, messages: tuple[MoosMessage, ...]) -> None:
        community = self._community
        first = messages[0] if messages else MoosMessage(wire.NULL, "")
        name = first.text if len(first.data) <= wire.NAMES_LIMIT else ""
        if first.type != wire.DATA or not 0 < len(name) <= CLIENT_NAME_LIMIT:
            self._send_away(f"say your name, 1 to {CLIENT_NAME_LIMIT} characters, in the first message")
            return
        if name in community.names:
            self._send_away(f'A client of this name ("{name}") already exists')
            return
        if not self.admit():
            return
        self._is_asynchronous = first.key == wire.ASYNCHRONOUS
        now = community.clock.now()
        welcome = MoosMessage(
            wire.WELCOME, "", now - first.time, wire.ASYNCHRONOUS.encode(), src_aux=f"hostname={socket.gethostname()}",
            community=community.config.community, time=now,
        )  # fmt: skip
        self.write(wire.packet([wire.encode(welcome)]))
        self.name = name
        community.joined(self)

    def _packet(self, messages: tuple[MoosMessage, ...]) -> Iterator[None]:
        community = self._community
        if messages and messages[0].type == wire.TIMING:
            first = messages[0]
            community.database.beat(self.name, first.time)
            if self._is_asynchronous:
                echo = MoosMessage(
                    wire.TIMING, first.key, community.clock.now(), src=first.src, time=first.time, number2=0.0
                )
                self._send(wire.packet([wire.encode(echo)]), 1)
        start = community.database.spent
        for number, message in enumerate(messages, 1):
            known = len(community.database.variables)
            yield from community.database.steps(self.name, message)
            # A new variable costs more: it is compared with the patterns of all clients.
            is_new = len(community.database.variables) != known
            is_much = community.database.spent - start >= SPENT
            if message.type != wire.NOTIFY or is_new or is_much or number % AT_ONCE == 0:
                yield
                start = community.database.spent
        if not self._is_asynchronous:
            self._answer()

    # -- out ------------------------------------------------------------------------------------------------------------------------

    def deliver(self, letter: Letter) -> None:
        """Take mail. All mail of one turn of the loop is sent together."""
        self._mail.append(letter)
        if not self._is_asynchronous:
            # Mail is kept until the client asks for it, within limits.
            self._held += len(letter.message.data)
            while len(self._mail) > HELD or self._held > self._community.config.queue_bytes:
                self._held -= len(self._mail.pop(0).message.data)
                self._stats.dropped += 1
        elif not self._is_due:
            self._is_due = True
            self._community.has_mail(self)

    def send_mail(self, last: Batch) -> Batch:
        """Send all mail.

        Args:
            last: mail that was sent to another client just before; its packets are used again where they hold the same.

        Returns:
            The mail that was sent.
        """
        mail, self._mail = self._mail, []
        self._is_due = False
        batch = last if mail == last.letters else Batch(mail)
        for packet, messages in batch.packets:
            self._send(packet, messages)
        return batch

    def _answer(self) -> None:
        """Send the one packet that a synchronous client gets for each of its own."""
        null = wire.encode(MoosMessage(wire.NULL, "", self._community.clock.now()))
        mail, self._mail, self._held = self._mail, [], 0
        self._send(wire.packet([null, *(letter.data for letter in mail)]), 1 + len(mail))

    def _send(self, packet: bytes, messages: int) -> None:
        if self.is_closing:
            return
        if self.waiting > self._community.config.queue_bytes:
            self._stats.dropped += messages
            self._fault(f"more than {self._community.config.queue_bytes} bytes waited for it: it must read faster")
            return
        self._stats.samples_sent += messages
        self._stats.bytes_sent += len(packet)
        self.write(packet)

    # -- end ------------------------------------------------------------------------------------------------------------------------

    def check(self) -> None:
        """Disconnect the client if it was silent for too long."""
        limit = self._community.config.client_timeout_s
        if self.name and not self.is_closing and self.loop.time() - self._heard > limit:
            self._fault(f"silent for {limit:g} s")

    def _fault(self, text: str) -> None:
        name = wire.readable(self.name) or "a client"
        self._stats.count_error(f"{name}: {text}")
        log.warning("%s disconnects %s: %s", self._community.context.name, name, text)
        self.abort()

    def _poison(self, reason: str) -> bytes:
        """Return the packet that ends a connection."""
        self._stats.count_error(wire.readable(reason))
        data = reason.encode("utf-8", "surrogateescape")
        poison = MoosMessage(wire.POISON, "", data=data, kind=wire.STRING, time=self._community.clock.now())
        return wire.packet([wire.encode(poison)])

    def _send_away(self, reason: str) -> None:
        self.farewell(self._poison(reason))
