"""The `moos` adapter: joins a MOOSDB, or one for each community, and stays there."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection, Sequence

from uwserver.adapter import AdapterContext, serving, within
from uwserver.ports import Event, Sample
from uwserver_adapters.moos import wire
from uwserver_adapters.moos.alog import Alog
from uwserver_adapters.moos.bridge.bridge import Bridge, Pairs
from uwserver_adapters.moos.client.link import Link, LinkLost
from uwserver_adapters.moos.clock import MoosClock, warp_of
from uwserver_adapters.moos.config import CommunityTable, MoosConfig
from uwserver_adapters.moos.wire import Message

log = logging.getLogger(__name__)

RETRY_S = 0.25
"""Wall time between two attempts to connect."""
CONNECT_S = 1.0
"""Wall time for the connection, and again for the welcome."""


class Community:
    """One connection that is made again and again. The adapter's `Subscriber`. Loop thread."""

    def __init__(
        self, name: str, table: CommunityTable, config: MoosConfig, context: AdapterContext, clock: MoosClock
    ) -> None:
        self._table = table
        self._timeout_s = config.timeout_s
        self._context = context
        self._clock = clock
        self._link: Link | None = None
        self._alog: Alog | None = None
        self.bridge = Bridge(table, context, self._post, self._listen, name, asyncio.get_running_loop().time)
        self.address = f"{table.host}:{table.port}"

    @property
    def wanted(self) -> Collection[str]:
        """What the bridge does, while somebody is there."""
        return () if self._link is None else self.bridge.wanted

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Publish them, if somebody is there."""
        if self._link is not None:
            self.bridge.put_samples(samples)

    def put_event(self, event: Event) -> None:
        """Tell it."""
        self.bridge.put_event(event)

    def _post(self, pairs: Pairs) -> None:
        link, stats = self._link, self._context.stats
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
        if self._alog is not None:
            now = self._clock.now()
            for name, value in pairs:
                self._alog.write(now, name, self._table.client, value)

    def _compare(self, link: Link, pairs: Pairs) -> None:
        """Tell once of each variable that another client keeps as another type."""
        for name, value in pairs:
            theirs = link.kinds.pop(name, "")
            if theirs and theirs != (wire.STRING if isinstance(value, str) else wire.DOUBLE):
                text = f"the MOOSDB at {self.address} has {name} with another type and drops ours: rename one, or start it anew"
                self._context.stats.errors += 1
                self._context.stats.last_error = text
                log.warning("%s: %s", self._context.name, text)

    def _listen(self, names: Sequence[str]) -> None:
        if self._link is not None:
            self._link.register(names)

    def _take(self, link: Link, messages: Sequence[Message]) -> None:
        own = self._table.client
        mail = [(m.key, m.value, m.src, m.time) for m in messages if m.src != own]
        if self._alog is not None:
            for name, value, source, time in mail:
                self._alog.write(time, name, source, value)
        self.bridge.take(mail, link.joined_at)

    async def run(self) -> None:
        """Join, stay, join again, until cancelled."""
        stats = self._context.stats
        told = ""
        self._alog = Alog(self._table.alog, self._clock.now, self._context) if self._table.alog else None
        try:
            while True:
                try:
                    await self._visit()
                except (OSError, LinkLost) as error:
                    text = f"MOOSDB at {self.address}: {error}; it is tried again"
                    stats.last_error = text
                    if text != told:
                        log.warning("%s: %s", self._context.name, text)
                        told = text
                await asyncio.sleep(RETRY_S)
        finally:
            self.bridge.close()
            if self._alog is not None:
                self._alog.close()

    async def _visit(self) -> None:
        loop, stats = asyncio.get_running_loop(), self._context.stats
        table = self._table
        link: Link
        link = Link(table.client, self._clock, lambda messages: self._take(link, messages))
        try:
            await within(CONNECT_S, loop.create_connection(lambda: link, table.host, table.port), "no answer")
            await within(CONNECT_S, link.join(), "no answer")
            if not self._clock.is_credible:
                gap = f"{self._clock.skew:g} s, is its MOOSTimeWarp {self._clock.warp:g}?"
                stats.last_error = f"the clock of the MOOSDB at {self.address} differs by {gap}"
                log.warning("%s: %s", self._context.name, stats.last_error)
            self._link = link
            self._context.follow_wants()
            stats.peers += 1
            try:
                log.info("%s joined the community %s at %s", self._context.name, link.community, self.address)
                link.register(self.bridge.listens_to)
                link.ask_kinds()
                self.bridge.begin(link.community)
                await link.stay(self._timeout_s, self.bridge.attend)
            finally:
                self._link = None
                self._context.follow_wants()
                stats.peers -= 1
        finally:
            link.abort()
            await asyncio.sleep(0)  # its socket is closed with the next turn of the loop


class MoosAdapter:
    """Joins MOOS communities as a client (README.md)."""

    Config = MoosConfig

    def __init__(self, config: MoosConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled; the databases may come and go.

        Raises:
            CannotServe: the table names what is not there.
        """
        config, context = self.config, self.context
        steady = asyncio.get_running_loop().time
        warp = warp_of(context, config.warp)
        members = [
            Community(name, table, config, context, MoosClock(warp, steady))
            for name, table in config.communities.items()
        ]
        tasks = [asyncio.ensure_future(member.run()) for member in members]
        try:
            context.stats.details["warp"] = warp
            with serving(context, _Several(members), ", ".join(member.address for member in members), ready):
                await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


class _Several:
    """A subscriber of many."""

    def __init__(self, members: Sequence[Community]) -> None:
        self._members = members

    @property
    def wanted(self) -> Collection[str]:
        return frozenset().union(*(member.wanted for member in self._members))

    def put_samples(self, samples: Sequence[Sample]) -> None:
        for member in self._members:
            member.put_samples(samples)

    def put_event(self, event: Event) -> None:
        for member in self._members:
            member.put_event(event)
