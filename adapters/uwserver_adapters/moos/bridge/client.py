"""The adapter `moos`: it joins one MOOSDB or several, and stays there: greeting, heartbeat, packets."""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import cast

from uwserver.adapter import AdapterBase, AdapterContext, InputTurns, serving, within
from uwserver.ports import Event, Sample
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.alog import Alog
from uwserver_adapters.moos.bridge.bridge import Bridge, Pairs
from uwserver_adapters.moos.clock import MoosClock, warp_of
from uwserver_adapters.moos.config import CommunityTable, MoosConfig
from uwserver_adapters.moos.wire import Malformed, MoosMessage, Packet, Skipped

log = logging.getLogger(__name__)

BEAT_S = 1.0
"""Wall time between two heartbeats. A MOOSDB gives up after 5 s of silence."""
WAITING = 4 << 20
"""Bytes that may wait for a database that does not read. Samples are dropped above that."""
RETRY_S = 0.25
"""Wall time between two attempts to connect."""
CONNECT_S = 1.0
"""Wall time for the connection, and again for the welcome."""


class LinkLost(Exception):
    """The connection is over; the text says why."""


class Link(asyncio.Protocol):
    """The client's side of a connection. Loop thread.

    Args:
        name: name of the client.
        clock: MOOS time; it follows the clock of the database.
        take: gets the notifications of each packet.

    Attributes:
        is_joined: the database has welcomed us.
        joined: done once the database has welcomed us; raises LinkLost where it does not.
        joined_at: MOOS time of the welcome.
        community: name of the database's community.
        kinds: name -> type of the variables that the database had when we asked.
    """

    def __init__(self, name: str, clock: MoosClock, take: Callable[[Sequence[MoosMessage]], None]) -> None:
        self.is_joined = False
        self.joined_at = 0.0
        self.community = ""
        self.kinds: dict[str, str] = {}
        self._name = name
        self._clock = clock
        self._take = take
        self._decoder = wire.Decoder(skips=True)
        self._turns: InputTurns
        self._has_skipped = False
        self._transport: asyncio.Transport
        self._loop = asyncio.get_running_loop()
        self.joined: asyncio.Future[None] = self._loop.create_future()
        self._lost: asyncio.Future[None] = self._loop.create_future()
        self._heard = self._loop.time()
        self._greeted = 0.0
        self._ids = itertools.count(1)

    # -- asyncio --------------------------------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet the database."""
        self._transport = cast(asyncio.Transport, transport)
        self._turns = InputTurns(self._step, self._transport.pause_reading, self._read_on)
        self._greeted = self._clock.now()
        name = MoosMessage(wire.DATA, wire.ASYNCHRONOUS, data=self._name.encode(), kind=wire.STRING, time=self._greeted)
        self._transport.write(wire.HELLO + wire.packet([wire.encode(name)]))

    def data_received(self, data: bytes) -> None:
        """Take packets in pieces of any size."""
        self._heard = self._loop.time()
        self._decoder.receive(data)
        # In turns, because everything that other clients write comes through the database, which holds none of them back.
        self._turns.begin()

    def _step(self) -> bool:
        """Take the next stored packet."""
        event = self._decoder.next_event()
        if isinstance(event, Malformed):
            self._end(f"the peer is no MOOSDB: {event.text}")
        elif isinstance(event, Packet) and self.is_joined:
            self._packet(event.messages)
        elif isinstance(event, Packet):
            self._welcome(event.messages)
        elif isinstance(event, Skipped) and not self._has_skipped:
            self._has_skipped = True
            log.warning("%s passes over what the MOOSDB sends: %s", self._name, event.text)
        return event is not None and not self._lost.done()

    def _read_on(self) -> None:
        if not self._lost.done():
            self._transport.resume_reading()

    def connection_lost(self, error: Exception | None) -> None:
        """End: the database went, or we closed."""
        self._end("the connection was closed" if error is None else f"the connection broke: {error}")

    def _end(self, text: str) -> None:
        self.is_joined = False
        self._turns.stop()
        for future in (self.joined, self._lost):
            if not future.done():
                future.set_exception(LinkLost(text))
                future.exception()  # marks it as retrieved: asyncio would log an exception that nobody awaits
        self._transport.abort()

    # -- in -------------------------------------------------------------------------------------------------------------------------

    def _welcome(self, messages: Sequence[MoosMessage]) -> None:
        first = messages[0] if messages else MoosMessage(wire.NULL, "")
        if first.type != wire.WELCOME:
            refusal = f"the MOOSDB refuses us: {wire.readable(first.text)}"
            other = "the peer is no MOOSDB of version 10: it does not welcome us"
            self._end(refusal if first.type == wire.POISON else other)
            return
        # The welcome tells the database's time less the time of our greeting.
        self._clock.observe(self._greeted, self._greeted + first.number, self._clock.now())
        self.community = wire.readable(first.community)
        self.joined_at = self._clock.now()
        self.is_joined = True
        if not self.joined.done():
            self.joined.set_result(None)

    def _packet(self, messages: Sequence[MoosMessage]) -> None:
        mail = []
        for message in messages:
            if message.type == wire.NOTIFY:
                if message.id != wire.SERVER_REQUEST_ID:
                    mail.append(message)
                elif message.kind in wire.KINDS:  # other kinds stand for a variable that nobody has written yet
                    self.kinds[message.key] = message.kind
            elif message.type == wire.TIMING:
                # A step of the database's clock moves the time at which we came as well. Otherwise all that is written after a step back
                # would count as history.
                self.joined_at += self._clock.observe(message.time, message.number, self._clock.now())
        if mail:
            self._take(mail)

    # -- out ------------------------------------------------------------------------------------------------------------------------

    async def stay(self, timeout_s: float, attend: Callable[[], None]) -> None:
        """Send heartbeats until the connection is over.

        Args:
            timeout_s: wall time without a word of the database after which the connection is over.
            attend: called with each heartbeat.

        Raises:
            LinkLost: the connection is over, or the database said nothing for `timeout_s`.
        """
        while True:
            attend()
            self._write(MoosMessage(wire.TIMING, wire.TIMING_KEY, 0.0, time=self._clock.now()))
            await asyncio.wait([self._lost], timeout=BEAT_S)
            if self._lost.done():
                self._lost.result()
            if self._loop.time() - self._heard > timeout_s:
                raise LinkLost(f"the MOOSDB said nothing for {timeout_s:g} s")

    def register(self, names: Sequence[str]) -> None:
        """Ask for all writes of some variables. Their last values come at once."""
        now = self._clock.now()
        if names:
            self._write(
                *[MoosMessage(wire.REGISTER, name, 0.0, src=self._name, time=now, id=self._next_id()) for name in names]
            )

    def ask_kinds(self) -> None:
        """Ask for the types of all variables: a MOOSDB drops writes of another type without telling the writer."""
        self._write(MoosMessage(wire.SERVER_REQUEST, "ALL", time=self._clock.now(), id=wire.SERVER_REQUEST_ID))

    def notify(self, pairs: Sequence[tuple[str, float | str]]) -> int:
        """Write variables together.

        Returns:
            Bytes written; 0 when too much waits already.
        """
        if not self.is_joined or self._transport.is_closing() or self._transport.get_write_buffer_size() > WAITING:
            return 0
        now = self._clock.now()
        return self._write(*[wire.notify(name, value, now, self._name, self._next_id()) for name, value in pairs])

    def _write(self, *messages: MoosMessage) -> int:
        """Send messages as one packet. Returns its size, bytes."""
        data = wire.packet([wire.encode(message) for message in messages])
        self._transport.write(data)
        return len(data)

    def _next_id(self) -> int:
        return next(self._ids) & 0x7FFFFFFF  # an id has 32 bits with a sign

    def abort(self) -> None:
        """Close at once, if the connection was made."""
        if self._greeted:
            self._transport.abort()


class Community:
    """One MOOSDB, which is joined again and again. Loop thread.

    Args:
        name: name of the community in the adapter's table.
        table: table of the community.
        config: config of the adapter.
        context: the world.
        clock: MOOS time.

    Attributes:
        bridge: the bridge between the database and the world.
        link: the connection; None while there is none.
        address: address of the database.
    """

    def __init__(
        self, name: str, table: CommunityTable, config: MoosConfig, context: AdapterContext, clock: MoosClock
    ) -> None:
        self._table = table
        self._timeout_s = config.timeout_s
        self._context = context
        self._clock = clock
        self._alog: Alog | None = None
        self._trouble = ""
        self.link: Link | None = None
        self.bridge = Bridge(table, context, self._post, self._listen, name, asyncio.get_running_loop().time)
        self.address = f"{table.host}:{table.port}"

    def _post(self, pairs: Pairs) -> None:
        link, stats = self.link, self._context.stats
        if link is None:
            return
        if link.kinds:
            self._compare(link, pairs)
        size = link.notify(pairs)
        if not size:
            stats.dropped += len(pairs)
            return
        stats.samples_sent += len(pairs)
        stats.bytes_sent += size
        now = self._clock.now()
        self._log((name, value, self._table.client, now) for name, value in pairs)

    def _log(self, written: Iterable[tuple[str, float | str | bytes, str, float]]) -> None:
        if self._alog is not None:
            for name, value, source, time in written:
                self._alog.add(time, name, source, value)

    def _compare(self, link: Link, pairs: Pairs) -> None:
        """Warn once of each variable to which another client has given another type."""
        for name, value in pairs:
            theirs = link.kinds.pop(name, "")
            if theirs and theirs != (wire.STRING if isinstance(value, str) else wire.DOUBLE):
                text = f"the MOOSDB at {self.address} has {name} with another type and drops ours: rename one, or start it anew"
                self._context.stats.errors += 1
                self._warn(text)

    def _warn(self, text: str) -> None:
        self._context.stats.last_error = text
        log.warning("%s: %s", self._context.name, text)

    def _listen(self, names: Sequence[str]) -> None:
        if self.link is not None:
            self.link.register(names)

    def _take(self, link: Link, messages: Sequence[MoosMessage]) -> None:
        own = self._table.client
        mail = [(m.key, m.value, m.src, m.time) for m in messages if m.src != own]
        self._log(mail)
        self.bridge.take(mail, link.joined_at)

    async def run(self) -> None:
        """Join, stay, and join again, until cancelled."""
        self._alog = Alog(self._table.alog, self._clock.now, self._context) if self._table.alog else None
        try:
            while True:
                try:
                    await self._visit()
                except (OSError, LinkLost) as error:
                    text = f"MOOSDB at {self.address}: {error}; it is tried again"
                    self._context.stats.last_error = text
                    if text != self._trouble:
                        self._warn(text)
                        self._trouble = text
                await asyncio.sleep(RETRY_S)
        finally:
            self.bridge.close()
            if self._alog is not None:
                self._alog.close()

    async def _visit(self) -> None:
        """Join the database, and stay until the connection is over."""
        loop, stats = asyncio.get_running_loop(), self._context.stats
        table = self._table
        link: Link = Link(table.client, self._clock, lambda messages: self._take(link, messages))
        try:
            await within(CONNECT_S, loop.create_connection(lambda: link, table.host, table.port), "no answer")
            await within(CONNECT_S, link.joined, "no answer")
            if not self._clock.is_credible:
                gap = f"{self._clock.skew:g} s, is its MOOSTimeWarp {self._clock.warp:g}?"
                self._warn(f"the clock of the MOOSDB at {self.address} differs by {gap}")
            self.link = link
            if stats.last_error == self._trouble:  # that is over; what else went wrong stays
                stats.last_error = ""
            self._context.subscriptions_changed()
            stats.peers += 1
            try:
                log.info("%s joined the community %s at %s", self._context.name, link.community, self.address)
                link.register(self.bridge.listens_to)
                link.ask_kinds()
                self.bridge.begin(link.community)
                await link.stay(self._timeout_s, self.bridge.attend)
            finally:
                self.link = None
                self._context.subscriptions_changed()
                stats.peers -= 1
        finally:
            link.abort()
            await asyncio.sleep(0)  # the loop closes an aborted socket in its next turn


class MoosAdapter(AdapterBase[MoosConfig]):
    """Joins MOOS communities as a client (README.md)."""

    Config = MoosConfig

    def __init__(self, config: MoosConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self._communities: list[Community] = []

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled; the databases may come and go.

        Raises:
            CannotServe: the table names what is not there.
        """
        config, context = self.config, self.context
        steady = asyncio.get_running_loop().time
        warp = context.stats.details["warp"] = warp_of(context, config.warp)
        self._communities = [
            Community(name, table, config, context, MoosClock(warp, steady))
            for name, table in config.communities.items()
        ]
        tasks = [asyncio.ensure_future(community.run()) for community in self._communities]
        try:
            with serving(context, self, ", ".join(each.address for each in self._communities), ready):
                await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def _joined(self) -> list[Community]:
        return [community for community in self._communities if community.link is not None]

    @property
    def subscriptions(self) -> Collection[str]:
        """Ports that become variables of the communities that are joined now."""
        return frozenset().union(*(community.bridge.subscriptions for community in self._joined()))

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Publish samples in the communities that are joined now."""
        for community in self._joined():
            community.bridge.put_samples(samples)

    def put_event(self, event: Event) -> None:
        """Tell all bridges of an event."""
        for community in self._communities:
            community.bridge.put_event(event)
