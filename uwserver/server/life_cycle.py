"""The life cycle of a server: simulation thread, adapters, signals, recording, health, and the orderly end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from msgspec import UNSET

from uwserver.adapter import CannotListen
from uwserver.ports import Progress, Reply
from uwserver.recording.parts import ONE_FILE, Rotation
from uwserver.recording.recorder import Recorder
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import Scenery
from uwserver.server.adapters import START_TIMEOUT_S, START_WORK_NS, STOP_TIMEOUT_S, Adapters, StartFailed, cancel
from uwserver.server.context import Hub, TickProvider
from uwserver.server.http import serve_http
from uwserver.server.playback import Playback
from uwserver.server.process import signals_received
from uwserver.server.profiling import Profiling
from uwserver.server.recordings import Recordings
from uwserver.server.state_files import StateFiles, state_folder
from uwserver.server.status import Metrics, Monitor
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import SystemTime, Timing, processor_ns
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.thread import Simulation
from uwserver.units import NANOSECONDS

log = logging.getLogger(__name__)

SWITCH_INTERVAL_S = 0.0005
"""How long a thread may keep the interpreter. Python's default of 5 ms is longer than a tick."""

_POLL_S = 0.1
STOP_WORK_NS = NANOSECONDS
"""Processor time in which the present tick must end. Only a tick that never ends takes so long."""


@dataclass(frozen=True)
class Options:
    """Values of the command line that change a scenario.

    Attributes:
        seed: instead of the scenario's.
        timing: how time passes; None as in the scenario.
        record: file to write.
        until_s: simulation time at which the server ends.
        begin: a saved state to start from.
        save_at: times (s) at which the state is saved, and the files.
        profile_s: wall time (s) after which the profile of ticks is shown, again and again, and at the end; None for never.
        shown: adapter whose address people want first: the start waits for it a moment, though it may fail; "" for none.
        announce: called once peers can connect, with the addresses by adapter name.
        tell: takes the tables of `profile_s`.
        rotation: when the recording goes on in another file.
        foxglove: whether a recording has channels for Foxglove, Lichtblick and rerun, too.
    """

    seed: int | None = None
    timing: Timing | None = None
    record: Path | None = None
    until_s: float | None = None
    begin: bytes | None = None
    save_at: tuple[tuple[float, Path], ...] = ()
    profile_s: float | None = None
    shown: str = ""
    announce: Callable[[dict[str, str]], None] = field(default=lambda addresses: None)
    tell: Callable[[str], None] = print
    rotation: Rotation = ONE_FILE
    foxglove: bool = True


def timing_of(resolved: Resolved) -> Timing:
    """Return the clock of a scenario."""
    clock = resolved.scenario.world.clock
    return Timing(
        clock.mode, clock.speed, clock.paused, clock.lockstep_clients, clock.lockstep_timeout_s, clock.on_loss,
        None if clock.max_speed is UNSET else clock.max_speed,
    )  # fmt: skip


class Server:
    """One world with its adapters. `run` is its whole life.

    Attributes:
        live: the simulation; None while a recording is played.
        hub: what the adapters share.
    """

    def __init__(self, resolved: Resolved, options: Options, playback: Playback | None = None) -> None:
        """Take a scenario, whose world runs, or whose recording is played."""
        self._resolved = resolved
        self._options = options
        self._ending = asyncio.Event()
        self._reason, self._gave_up = "", False
        self._signalled = math.inf  # time of the first signal, s
        self._loop = asyncio.get_running_loop()
        time, bus, mailbox = SystemTime(), Bus(self._call_soon), Mailbox()
        self._monitor = Monitor(lambda: self.hub, time.now_ns)
        self.live: Simulation | None = None
        self._simulation: TickProvider
        self._recorder: Recorder | None = None
        name, tell = resolved.scenario.server.name, (self.shutdown, self._monitor.status)
        if playback is not None:
            player, self.hub = playback.start(name, resolved, (time, bus, mailbox), tell)
            self._simulation = player
            return
        world = build(resolved, options.seed)
        timing = options.timing or timing_of(resolved)
        self._simulation = self.live = Simulation(world, timing, time, bus, mailbox)
        files = StateFiles(state_folder(resolved), self.live, mailbox, self._call_soon)
        profiling = Profiling(self.live, time.now_ns, self._call_soon, self._loop.call_later)
        self.hub = Hub(name, self.live, bus, mailbox, *tell, files, profiling, Scenery(resolved, world))
        if options.record:
            self._recorder = Recorder(options.record, world, resolved, options.rotation, foxglove=options.foxglove)
        self.hub.recordings = Recordings(resolved, self.live, self._recorder, foxglove=options.foxglove)

    def shutdown(self, reason: str) -> None:
        """Begin the orderly end. Loop thread; may be called more than once."""
        if not self._ending.is_set():
            log.info("shutting down: %s", reason)
            self._reason = reason
            self._ending.set()

    async def run(self) -> int:
        """Serve until told to end.

        Returns:
            Exit status: 0 after an orderly end, 1 if the world stopped by a fault or the recording is incomplete.

        Raises:
            StartFailed: see there.
        """
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(sys.setswitchinterval, sys.getswitchinterval())
            sys.setswitchinterval(SWITCH_INTERVAL_S)
            if threading.current_thread() is threading.main_thread():
                stack.enter_context(signals_received(self._loop, self._received))
            if self.hub.recordings is not None:
                stack.push_async_callback(self.hub.recordings.finish)
            if self.live is not None:
                self._prepare(self.live, stack)
            await self._start_http(stack)
            adapters = Adapters(self.hub, self._ending)
            stack.push_async_callback(adapters.end)
            await adapters.start(self._resolved.scenario.adapters, self._options.shown)
            monitor = self._loop.create_task(self._monitor.run(), name="monitor")
            stack.push_async_callback(cancel, [monitor])
            thread = threading.Thread(target=self._simulate, name="simulation", daemon=True)
            self._options.announce({name: stats.address for name, stats in self.hub.stats.items()})
            if self._options.profile_s is not None and self.hub.profiling is not None:
                self.hub.profiling.tell_every(self._options.profile_s, self._options.tell)
            thread.start()
            # Also when this task is cancelled: the recorder closes next, and no other thread may use the world then.
            stack.callback(self._join, thread)
            stack.callback(self._simulation.stop)
            await self._ending.wait()
            event = self.hub.event("shutdown", self._reason or "the server ends")
            self._simulation.stop()
            await asyncio.to_thread(self._join, thread)
            if self.hub.profiling is not None:
                self.hub.profiling.finish()
            self.hub.bus.say(event)
            self.hub.bus.drain()
            if self.hub.files is not None:
                await self.hub.files.finish()
            if self.hub.recordings is not None:
                await self.hub.recordings.finish()
            for t_s, path in self._options.save_at:
                if self._simulation.world.t_ns < t_s * NANOSECONDS - 1.0:
                    log.warning("%s was not written: the run ended before %g s", path, t_s)
        incomplete = self._recorder is not None and not self._recorder.is_complete
        return 1 if self._simulation.failure or incomplete else 0

    # -- parts ----------------------------------------------------------------------------------------------------------------------

    def _simulate(self) -> None:
        self._simulation.run()
        # After an orderly stop `shutdown` has been called already, and keeps its first reason.
        reason = self._simulation.failure or f"simulation time reached {self._options.until_s} s"
        self._call_soon(lambda: self.shutdown(reason))

    def _join(self, thread: threading.Thread) -> None:
        """Wait for the end of the present tick. The limit is processor time, because on a busy machine, or while a kernel is compiled, a
        healthy tick may take long."""
        before, since = processor_ns(), self._loop.time()
        while thread.is_alive() and not self._gave_up:
            thread.join(_POLL_S)
            worked = processor_ns() - before
            if worked > STOP_WORK_NS or (worked < START_WORK_NS and self._loop.time() - since > START_TIMEOUT_S):
                break
        if thread.is_alive() and not self._gave_up:
            self._gave_up = True
            text = f"the present tick does not end within {STOP_WORK_NS / NANOSECONDS:g} s of processor time"
            log.error("%s: the simulation is cut off", text)
            if self._recorder is not None:
                self._recorder.abandon(text)
            if self.hub.recordings is not None:
                self.hub.recordings.abandon(text)

    def _prepare(self, live: Simulation, stack: contextlib.ExitStack | contextlib.AsyncExitStack) -> None:
        """Do everything that must be done before the first tick of a world."""
        live.world.prepare()
        if self._recorder is not None:
            stack.enter_context(self._recorder.running(live, self.hub.bus))
        if self._options.begin is not None and (refused := live.begin_from(self._options.begin)):
            raise StartFailed(f"the run cannot begin from the saved state: {refused}")
        for t_s, path in self._options.save_at:
            tick = live.world.ticks.at(t_s)
            if tick < live.world.tick:
                raise StartFailed(f"the state at {t_s:g} s cannot be saved: the run begins later")
            if self.hub.files is not None:
                live.call_at(tick, partial(self.hub.files.save_now, path, _log_fault))
        if self._options.until_s is not None:
            live.until_tick = live.world.ticks.at(self._options.until_s)

    def _call_soon(self, function: Callable[[], None]) -> None:
        # The last replies of a stopped simulation may come after the loop has closed.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(function)

    async def _start_http(self, stack: contextlib.AsyncExitStack) -> None:
        config = self._resolved.scenario.server
        if not config.metrics:
            return
        metrics = Metrics(self.hub, self._monitor)
        serving = serve_http(
            config.metrics_bind, config.metrics_port, self._monitor.status, metrics.text, config.allowed_hosts
        )
        try:
            port = await stack.enter_async_context(serving)
        except CannotListen as error:
            log.warning("no /health and /metrics: %s", error)
            return
        log.info("health and metrics on http://%s:%d/health and /metrics", config.metrics_bind, port)

    def _received(self, number: signal.Signals) -> None:
        """End the server in order at the first signal; end the process at once at a second one."""
        now = self._loop.time()
        # A supervisor may signal both the process and its group, so a second signal counts only some time after the first.
        if now - self._signalled > STOP_TIMEOUT_S:
            os._exit(128 + number)
        self._signalled = min(self._signalled, now)
        self.shutdown(number.name)


def _log_fault(answer: Reply | Progress) -> None:
    if isinstance(answer, Reply) and answer.fault is not None:
        log.error("%s", answer.fault.text)
