"""The adapter `moos`: it joins one MOOSDB or several, and stays there."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection, Iterable, Sequence

from uwserver.adapter import AdapterBase, AdapterContext, serving, within
from uwserver.ports import Event, Sample
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.alog import Alog
from uwserver_adapters.moos.bridge.bridge import Bridge, Pairs
from uwserver_adapters.moos.client.link import Link, LinkLost
from uwserver_adapters.moos.clock import MoosClock, warp_of
from uwserver_adapters.moos.config import CommunityTable, MoosConfig
from uwserver_adapters.moos.wire import MoosMessage

log = logging.getLogger(__name__)

RETRY_S = 0.25
"""Wall time between two attempts to connect."""
CONNECT_S = 1.0
"""Wall time for the connection, and again for the welcome."""


class Community:
    """One MOOSDB, which is joined again and again. Loop thread.

    Args:
        name: of the community in the adapter's table.
        table: of the community.
        config: of the adapter.
        context: the world.
        clock: MOOS time.

    Attributes:
        bridge: the bridge between the database and the world.
        link: the connection; None while there is none.
        address: of the database.
    """

    def __init__(
        self, name: str, table: CommunityTable, config: MoosConfig, context: AdapterContext, clock: MoosClock
    ) -> None:
        self._table = table
        self._timeout_s = config.timeout_s
        self._context = context
        self._clock = clock
        self._alog: Alog | None = None
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
        told = ""
        self._alog = Alog(self._table.alog, self._clock.now, self._context) if self._table.alog else None
        try:
            while True:
                try:
                    await self._visit()
                except (OSError, LinkLost) as error:
                    text = f"MOOSDB at {self.address}: {error}; it is tried again"
                    self._context.stats.last_error = text
                    if text != told:
                        self._warn(text)
                        told = text
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
