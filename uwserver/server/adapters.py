"""The adapters of a server: they are started, started again when they fail, and ended. Loop thread."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable, Mapping
from typing import Any

from uwserver.adapter import AdapterStats, load_adapter
from uwserver.server.context import Context, Hub
from uwserver.simulation.clock import processor_ns
from uwserver.units import NANOSECONDS

log = logging.getLogger(__name__)

START_TIMEOUT_S = 10.0
"""Wall time without progress after which adapters have failed to start."""
START_WORK_NS = NANOSECONDS // 10
"""Processor time that counts as progress. A hundred checks whether all adapters have started take less, and a process gets more on any
machine."""
_POLL_S = 0.1
SHOWN_S = 1.0
"""Wall time for which the announcement waits for an adapter that is not required."""
STOP_TIMEOUT_S = 1.0
"""Wall time in which an adapter must clean up. It is also the least time between two signals for which the second one ends the process at
once."""
_FIRST_BACKOFF_S, _LAST_BACKOFF_S = 0.2, 5.0


class StartFailed(Exception):
    """A required adapter could not start, or a saved state does not fit. The text names it and says why."""


class Adapters:
    """The running adapters of a hub."""

    def __init__(self, hub: Hub, ending: asyncio.Event) -> None:
        """Begin without adapters. `ending` is set when the server ends: then nothing waits for an adapter any more."""
        self._hub, self._ending = hub, ending
        self._loop = asyncio.get_running_loop()
        self._tasks: dict[str, asyncio.Task[None]] = {}

    async def start(self, configs: Mapping[str, Any], shown: str = "") -> None:
        """Start adapters, and wait for those that are required, and a moment for the one that is `shown` to people.

        Args:
            configs: configuration of each adapter by its name; no adapter of this name runs.
            shown: name of the adapter whose address is announced; "" for none.

        Raises:
            StartFailed: a required adapter has failed, or nothing progresses. None of `configs` runs then.
        """
        waiting: dict[str, asyncio.Task[object]] = {}
        for name, config in configs.items():
            self._hub.stats.pop(name, None)  # of an adapter of this name that has ended
            context = Context(self._hub, name, config.truth)
            ready = asyncio.Event()
            task = self._loop.create_task(self._supervise(config, context, ready), name=f"adapter {name}")
            self._tasks[name] = task
            if config.required:
                waiting[name] = self._loop.create_task(ready.wait())
        try:
            await self._wait_ready(waiting)
            await self._wait_shown(shown)
        except StartFailed:
            await self.end(configs)
            raise
        finally:
            await cancel(waiting.values())

    async def end(self, names: Iterable[str] | None = None) -> None:
        """End these adapters, or all of them, and wait for them for a limited time."""
        chosen = [*self._tasks] if names is None else [name for name in names if name in self._tasks]
        await cancel([self._tasks.pop(name) for name in chosen])

    async def _wait_ready(self, waiting: dict[str, asyncio.Task[object]]) -> None:
        """Wait until all required adapters have started, or the server is told to end. There is no fixed limit as long as something
        progresses, because a busy machine may be slow.

        Raises:
            StartFailed: an adapter has failed, or there is no progress.
        """
        ending = self._loop.create_task(self._ending.wait())
        seen, since, told = (0, 0), self._loop.time(), False
        try:
            while pending := [name for name in waiting if not waiting[name].done()]:
                for name in pending:
                    if self._hub.stats[name].restarts:
                        raise StartFailed(f'adapter "{name}" did not start: {self._hub.stats[name].last_error}')
                if ending.done():
                    return
                sign, now = (len(pending), processor_ns() // START_WORK_NS), self._loop.time()
                names = " and ".join(f'"{name}"' for name in pending)
                if sign != seen:
                    seen, since = sign, now
                elif now - since > START_TIMEOUT_S:
                    text = f"no answer, and no work in this process, for {START_TIMEOUT_S:g} s: it waits for something outside"
                    raise StartFailed(f"adapter {names} did not start: {text}")
                elif not told and now - since > START_TIMEOUT_S / 4:
                    told = True
                    log.info("waiting until adapter %s has started", names)
                looked_at = [ending, *(waiting[name] for name in pending)]
                await asyncio.wait(looked_at, timeout=_POLL_S, return_when=asyncio.FIRST_COMPLETED)
        finally:
            ending.cancel()

    async def _wait_shown(self, name: str) -> None:
        """Wait a moment until the adapter that is announced first has its address, or has failed."""
        stats, until = self._hub.stats.get(name), self._loop.time() + SHOWN_S
        while stats is not None and stats.state == "starting" and self._loop.time() < until:
            await asyncio.sleep(_POLL_S / 10)

    async def _supervise(self, config: Any, context: Context, ready: asyncio.Event) -> None:
        """Run an adapter, and start it again after a growing pause when it fails. Its errors never reach the world."""
        backoff, stats = _FIRST_BACKOFF_S, context.stats
        while True:
            again = asyncio.Event()
            try:
                kind = load_adapter(str(config.__struct_config__.tag))
                runner = self._loop.create_task(kind(config, context).run(again))
                watcher = self._loop.create_task(_relay(again, ready, stats))
                try:
                    await runner
                finally:
                    await cancel([runner, watcher])
                raise RuntimeError("it ended by itself")
            except asyncio.CancelledError:
                stats.state = "stopped"
                raise
            except Exception as error:  # noqa: BLE001  # an adapter may fail in any way
                is_told = not config.required and stats.last_error == str(error)
                stats.restarts += 1
                stats.state, stats.last_error = "retrying", str(error)
                if not is_told:  # The same error of an adapter that is not required is logged once.
                    log.error('adapter "%s" failed: %s; next try in %.1f s', context.name, error, backoff)
                    self._hub.bus.say(self._hub.event("adapter_failed", f'adapter "{context.name}" failed: {error}'))
            if again.is_set():
                backoff = _FIRST_BACKOFF_S
            await asyncio.sleep(backoff)
            backoff = min(2 * backoff, _LAST_BACKOFF_S)


async def _relay(again: asyncio.Event, ready: asyncio.Event, stats: AdapterStats) -> None:
    await again.wait()
    stats.state = "running"
    ready.set()


async def cancel(tasks: Iterable[asyncio.Task[Any]]) -> None:
    """Cancel tasks and wait for them, for a limited time."""
    ended = [*tasks]
    for task in ended:
        task.cancel()
    if ended:
        await asyncio.wait(ended, timeout=STOP_TIMEOUT_S)
