"""Shows a world to clients that a program steps in its own process: one thread beside the program's, which runs the asyncio loop."""

from __future__ import annotations

import asyncio
import atexit
import concurrent.futures.thread
import contextlib
import logging
import sys
import threading
import weakref
from collections.abc import Callable, Collection, Coroutine, Mapping
from typing import Any, TypeVar

from uwserver.ports import Fault, Refused
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import Scenery
from uwserver.server.adapters import Adapters, StartFailed, cancel
from uwserver.server.context import Hub
from uwserver.server.life_cycle import SWITCH_INTERVAL_S
from uwserver.server.process import run
from uwserver.server.profiling import PROFILE
from uwserver.server.recordings import SERVICES as RECORDING_SERVICES
from uwserver.server.state_files import StateFiles, state_folder
from uwserver.server.status import Monitor
from uwserver.simulation.clock import SystemTime, Timing
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.stepped import Outlet, Stepped
from uwserver.world import World

log = logging.getLogger(__name__)

T = TypeVar("T")

THREAD_NAME = "uwserver clients"
"""Name of the thread."""
ATTEND_S = 0.02
"""Wall time between two looks at what clients ask for while the program does something else than stepping."""
_POLL_S = 0.5
IDLE_S = 0.1
"""The same while nobody takes samples and nothing was asked for."""
_BY_THE_PROGRAM = (PROFILE.path, *RECORDING_SERVICES)
"""Services of a server that a program has in its own way."""


class Hosted:
    """The clients of a world that its program steps. All methods but `shutdown` are called by the program's thread.

    The thread begins with this object, and ends with `close`, with ``world/shutdown`` of a client, or with the process.

    Attributes:
        stepped: makes the ticks from now on; see there.
    """

    stepped: Stepped

    def __init__(self, resolved: Resolved, world: World, timing: Timing) -> None:
        """Begin without adapters.

        Args:
            resolved: the scenario of the world.
            world: the world, between two ticks.
            timing: how its ticks follow wall time, and whether clients grant them.
        """
        self._resolved = resolved
        self._begun: concurrent.futures.Future[None] = concurrent.futures.Future()
        self._is_over, self._reason = False, ""
        self._names: set[str] = set()
        self._thread = threading.Thread(target=self._main, args=(world, timing), name=THREAD_NAME, daemon=True)
        self._thread.start()
        _RUNNING.add(self)
        try:
            self._begun.result()
        except BaseException:  # also Ctrl-C
            concurrent.futures.wait([self._begun])
            self.close()
            raise

    @property
    def is_over(self) -> bool:
        """Whether it has ended, or is ending. Any thread."""
        return self._is_over

    def start(self, adapters: Mapping[str, Any]) -> dict[str, str]:
        """Start adapters, and return the address of each, by name.

        Raises:
            Refused: an adapter of this name is there, or one cannot start; then none of these is there.
        """
        there = [name for name in adapters if name in self._names]
        if there:
            text = f'the world has an adapter "{there[0]}" already: close that first, or give this one another name'
            raise Refused("busy", text, there[0])
        try:
            addresses = self._do(self._start(adapters))
        except BaseException:
            self._close_if_idle()
            raise
        self._names |= adapters.keys()
        return addresses

    def end(self, names: Collection[str]) -> None:
        """End adapters. If none is left then, everything is."""
        if self.has(names):
            self._names.difference_update(names)
            with contextlib.suppress(Refused):  # it ends just now
                self._do(self._adapters.end(names))
            self._close_if_idle()

    def has(self, names: Collection[str]) -> bool:
        """Return whether these adapters run."""
        return not self._is_over and self._names.issuperset(names)

    def peers(self, names: Collection[str]) -> int:
        """Return how many clients these adapters have at present."""
        there = self._hub.stats
        return sum(there[name].peers for name in names if name in there) if self.has(names) else 0

    def _close_if_idle(self) -> None:
        if not self._names:
            self.close()

    def follow(self, world: World) -> None:
        """Show another world of the same scenario from now on; the program's thread has just built it."""
        if not self._is_over:
            self._do(self._follow(world))

    def close(self) -> None:
        """End all adapters, the loop and the thread, and wait for that. May be called again, and by any thread."""
        self.shutdown("the program has closed it")
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def shutdown(self, reason: str) -> None:
        """Begin to end. Any thread; does not wait."""
        if not self._is_over:
            self._is_over = True
            self._reason = reason
            self._call_soon(self._ending.set)

    # -- the loop -------------------------------------------------------------------------------------------------------------------

    def _do(self, work: Coroutine[Any, Any, T]) -> T:
        """Let the loop do something, and wait for it."""
        over = Refused("shutdown", f"it has ended: {self._reason}")
        try:
            doing = asyncio.run_coroutine_threadsafe(work, self._loop)
        except RuntimeError:  # the loop is closed
            work.close()
            raise over from None
        while not concurrent.futures.wait([doing], _POLL_S).done:
            if not self._thread.is_alive():
                raise over
        if doing.cancelled():
            raise over
        return doing.result()

    def _call_soon(self, function: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function)

    def _main(self, world: World, timing: Timing) -> None:
        try:
            run(self._live(world, timing))
        except Exception as error:
            self._reason = f"an internal fault: {error}"
            log.exception("the thread of the clients has failed")
            if not self._begun.done():
                self._begun.set_exception(error)
        finally:
            self._is_over = True
            _RUNNING.discard(self)

    async def _live(self, world: World, timing: Timing) -> None:
        self._loop, self._ending = asyncio.get_running_loop(), asyncio.Event()
        time = SystemTime()
        outlet, mailbox = Outlet(self._call_soon, time), Mailbox()
        self.stepped = stepped = Stepped(world, timing, time, outlet, mailbox)
        monitor = Monitor(lambda: self._hub, time.now_ns)
        files = StateFiles(state_folder(self._resolved), stepped, mailbox, self._call_soon)
        self._hub = hub = Hub(
            self._resolved.scenario.server.name, stepped, outlet, mailbox, self.shutdown, monitor.status,
            files, None, Scenery(self._resolved, world), objection=_objection,
        )  # fmt: skip
        self._adapters = Adapters(hub, self._ending)
        before = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        tasks = [self._loop.create_task(monitor.run()), self._loop.create_task(self._attend(outlet, mailbox))]
        self._begun.set_result(None)
        try:
            await self._ending.wait()
            log.info("shutting down: %s", self._reason)
            stepped.stop()
            while not stepped.give_up(Refused("shutdown", "the server is shutting down")):
                await asyncio.sleep(ATTEND_S)
            outlet.say(hub.event("shutdown", self._reason))
            outlet.drain()
            await files.finish()
        finally:
            stepped.stop()
            await self._adapters.end()
            await cancel(tasks)
            sys.setswitchinterval(before)

    async def _attend(self, outlet: Outlet, mailbox: Mailbox) -> None:
        while True:
            is_asked = outlet.is_heard or mailbox.wake.is_set()
            await asyncio.sleep(ATTEND_S if is_asked else IDLE_S)
            self.stepped.attend()

    async def _start(self, adapters: Mapping[str, Any]) -> dict[str, str]:
        try:
            await self._adapters.start(adapters)
        except StartFailed as failed:
            raise Refused("denied", str(failed), "adapters") from None
        return {name: self._hub.stats[name].address for name in adapters}

    async def _follow(self, world: World) -> None:
        self.stepped.follow(world)
        self._hub.scenery = Scenery(self._resolved, world)


def _objection(path: str) -> Fault | None:
    if path not in _BY_THE_PROGRAM:
        return None
    return Fault("denied", f"a program steps this world: {path} is only for worlds that a server steps", path)


_RUNNING: weakref.WeakSet[Hosted] = weakref.WeakSet()
"""Those that must end with the process, whose threads it does not wait for."""


def _end_with_process() -> None:
    for hosted in [*_RUNNING]:
        hosted.close()


# Adapters need threads of executors to end in order, and Python ends these before it calls what is registered with `atexit`. The function
# that `concurrent.futures` registers itself with is not public; without it, adapters end less quietly.
getattr(threading, "_register_atexit", atexit.register)(_end_with_process)
