"""The `mavlink` adapter: one vehicle, as ground stations see an ArduSub ROV."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from datetime import datetime, timezone

from uwserver.adapter import AdapterContext
from uwserver_adapters.mavlink.links.endpoint import RETRY_S, Link
from uwserver_adapters.mavlink.links.hub import Hub
from uwserver_adapters.mavlink.links.parse import make
from uwserver_adapters.mavlink.vehicle.config import MavlinkConfig
from uwserver_adapters.mavlink.wire.dialect import Dialect

TICK_S = 0.05
"""Wall time between two looks at time-outs and downloads."""


class CannotServe(Exception):
    """The table names what is not there; the text says what there is."""


class MavlinkAdapter:
    """Speaks MAVLink on all its links (README.md)."""

    Config = MavlinkConfig

    def __init__(self, config: MavlinkConfig, context: AdapterContext) -> None:
        self.config = config
        self.context = context

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotSpeak: pymavlink is not installed.
            CannotServe: there is no such vehicle, or it must be named, or no such parameter.
            BadLink: a link cannot be had.
        """
        config, context, stats = self.config, self.context, self.context.stats
        loop = asyncio.get_running_loop()
        try:
            unix_s = datetime.now(timezone.utc).timestamp()
            hub = Hub(config, context, self._vehicle(), Dialect(), loop.time, unix_s)
        except ValueError as error:
            raise CannotServe(str(error)) from error
        links: list[Link] = []
        detach: Callable[[], None] | None = None
        try:
            for text in config.links:
                links.append(make(text, hub, stats))
                await links[-1].open()
            detach = context.attach(hub)
            stats.address = ", ".join(link.address for link in links)
            stats.state = "running"
            ready.set()
            await self._tick(hub, links)
        finally:
            if detach is not None:
                detach()
            for link in links:
                link.close()
            hub.end()
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(0)  # aborted connections are gone with the next turn of the loop
            stats.state = "stopped"

    async def _tick(self, hub: Hub, links: list[Link]) -> None:
        loop = asyncio.get_running_loop()
        due = attended = loop.time()
        while True:
            hub.tick()
            if loop.time() - attended >= RETRY_S:
                attended = loop.time()
                for link in links:
                    await link.attend()
            due = max(due + TICK_S, loop.time())
            await asyncio.sleep(due - loop.time())

    def _vehicle(self) -> str:
        names = sorted({path.split("/")[0] for path in self.context.ports})
        name = self.config.vehicle
        if name is not None and name not in names:
            raise CannotServe(f'no vehicle "{name}"; there are: {", ".join(names) or "none"}')
        if name is None and len(names) != 1:
            raise CannotServe(f"say which vehicle this is: vehicle = one of {', '.join(names) or 'none'}")
        return name or names[0]
