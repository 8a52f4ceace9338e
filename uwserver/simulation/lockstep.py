"""Lockstep: how far time may go. Named clients grant ticks from the loop; drivers grant them on the simulation thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeVar

from uwserver.adapter import Driver, Order
from uwserver.ports import Command, OnReply, Port, Refused, Reply, Sample
from uwserver.ports.checks import checked_command, find
from uwserver.ports.crossing import TickOutput, has_same_fields
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Barrier, Time, Timing
from uwserver.units import NANOSECONDS

log = logging.getLogger(__name__)

T = TypeVar("T")

POLL_S = 0.02
"""Wall time of one wait for a driver. Between two waits calls are answered."""

GLANCE_S = 0.004
"""Wall time that samples may wait for the loop while a driver steps: waking the loop for each tick would take as long as the tick."""
GATHER_S = 0.02
"""Wall time that samples may wait if nothing paces the world, for the same reason. With 500 wake-ups a second instead of 100, one client
slowed a single vehicle twice as much; with 50, the loop works a tenth less than with 100."""


@dataclass(eq=False)
class DriverClient:
    """A driver and its client.

    Attributes:
        client, source: the client in the barrier, and the source of its commands.
        on_reply: is told if the driver fails.
        ports: the ports by which it reads samples; None before the first tick.
        answer_at: the tick after which its peer gets an answer; None if it waits for none.
        held: locked while the driver is called, so that its socket is not closed meanwhile.
    """

    client: str
    source: str
    driver: Driver
    on_reply: OnReply
    ports: Mapping[str, Port] | None
    answer_at: int | None = None
    held: threading.Lock = field(default_factory=threading.Lock)


class Lockstep:
    """The barrier of a simulation, and its drivers. Simulation thread, except `drive`.

    Attributes:
        barrier: how far each client has granted.
    """

    def __init__(
        self,
        timing: Timing,
        time: Time,
        bus: Bus,
        say: Callable[[Literal["paused", "resumed"], str], None],
        pause: Callable[[str], None],
    ) -> None:
        """Begin without drivers.

        Args:
            timing, time, bus: those of the simulation.
            say: sends an event and its text.
            pause: stops time, for a reason.
        """
        self.barrier = Barrier(timing.lockstep_clients)
        self._timing = timing
        self._time = time
        self._bus = bus
        self._say = say
        self._pause = pause
        # Replaced, never changed in place, as both threads add and remove drivers.
        self._drivers: dict[str, DriverClient] = {}
        self._drivers_lock = threading.Lock()
        self._waiting_since: int | None = None
        self._reported_lost: list[str] = []
        self._last_wake_ns = 0

    # -- from the loop --------------------------------------------------------------------------------------------------------------

    def drive(self, client: str, source: str, driver: Driver, on_reply: OnReply) -> Callable[[], None]:
        """See `uwserver.adapter.AdapterContext.drive`.

        Raises:
            Refused: see there.
        """
        if client not in self.barrier.clients or self._timing.mode != "lockstep":
            names = f'mode = "lockstep" and lockstep_clients = ["{client}"]'
            raise Refused("denied", f'"{client}" sets the pace of the world: give [world.clock] {names}', client)
        entry = DriverClient(client, source, driver, on_reply, self._bus.ports)
        with self._drivers_lock:
            if client in self._drivers:
                raise Refused("busy", f'the world has a driver "{client}" already', client)
            self.barrier.join(client)
            self._drivers = {**self._drivers, client: entry}
        return lambda: self._leave(entry)

    def _leave(self, entry: DriverClient) -> None:
        with self._drivers_lock:
            if self._drivers.get(entry.client) is entry:
                self._drivers = {name: other for name, other in self._drivers.items() if other is not entry}
                self.barrier.leave(entry.client)
        with entry.held:  # The simulation thread may be in a last call of the driver; wait for its end.
            pass

    # -- the tick -------------------------------------------------------------------------------------------------------------------

    @property
    def asks(self) -> bool:
        """Whether there are drivers. Waiting for them is then the only sleep that is needed."""
        return bool(self._drivers)

    def orders(self, tick: int, ports: Mapping[str, Port]) -> Iterator[Command]:
        """Wait a moment for each driver that has not yet granted `tick`. Yields the commands that come with their grants."""
        for entry in self._drivers.values():
            if tick >= self.barrier.granted(entry.client):
                order = self._order(entry)
                if order is not None:
                    entry.answer_at = self.barrier.grant(entry.client, order.ticks, tick)
                    yield from self._commands(entry, order, ports)

    def _order(self, entry: DriverClient) -> Order | None:
        if self.barrier.is_excused(entry.client):
            return self._call(entry, lambda driver: driver.order(0.0))
        order = self._call(entry, lambda driver: driver.order(GLANCE_S))
        if order is None:
            self._bus.flush()
            order = self._call(entry, lambda driver: driver.order(POLL_S))
        return order

    def wakes(self) -> bool:
        """Return whether the samples of this tick wake the loop. Otherwise they wait for later ones, or for `Bus.flush`."""
        if not self._drivers and self._timing.mode != "freerun":
            return True
        now = self._time.now_ns()
        if now - self._last_wake_ns < (GLANCE_S if self._drivers else GATHER_S) * NANOSECONDS:
            return False
        self._last_wake_ns = now
        return True

    def _commands(self, entry: DriverClient, order: Order, ports: Mapping[str, Port]) -> Iterator[Command]:
        for path, value in order.commands:
            try:
                find("port", path, ports)
                yield Command(path, checked_command(ports[path], value), entry.source)
            except Refused as refused:
                fault = refused.fault
                self._call(entry, lambda driver: driver.refuse(fault))  # noqa: B023  # called at once

    def ticked(self, output: TickOutput) -> None:
        """Show a tick to the drivers, and let drivers answer whose order ends with it."""
        for entry in self._drivers.values():
            samples = _readable(output, entry)
            self._call(entry, lambda driver: driver.see(output.t_ns, samples))  # noqa: B023  # called at once
            if entry.answer_at is not None and output.tick >= entry.answer_at:
                self._answer(entry, output.t_ns)

    def _answer(self, entry: DriverClient, t_ns: int) -> None:
        entry.answer_at = None
        self._call(entry, lambda driver: driver.answer(t_ns))

    def _call(self, entry: DriverClient, work: Callable[[Driver], T]) -> T | None:
        with entry.held:
            if self._drivers.get(entry.client) is not entry:
                return None
            try:
                return work(entry.driver)
            except Exception as error:  # A fault of a driver must not end the simulation.
                log.exception('the driver "%s" failed', entry.client)
                text = f"{type(error).__name__}: {error}"
        self._leave(entry)
        self._bus.reply(entry.on_reply, Reply(0, 0, fault=Refused("internal", text, entry.client).fault))
        return None

    def restart(self, tick: int, t_ns: int) -> None:
        """Drop all grants and orders beyond `tick`, as the world was put to another time."""
        self.barrier.restart(tick)
        for entry in self._drivers.values():
            if entry.answer_at is not None:
                self._answer(entry, t_ns)

    # -- loss -----------------------------------------------------------------------------------------------------------------------

    def is_granted(self, tick: int) -> bool:
        """Return whether `tick` may begin. If it may not, treat lost clients as the scenario says."""
        missing = self.barrier.missing(tick)
        if not missing:
            self._waiting_since = None
            self._reported_lost = []
            return True
        now = self._time.now_ns()
        if self._waiting_since is None:
            self._waiting_since = now
        timeout = self._timing.lockstep_timeout_s
        if timeout and now - self._waiting_since > timeout * NANOSECONDS:
            self._lost(missing)
        return False

    def wait_anew(self) -> None:
        """Give late clients the whole time-out again."""
        self._waiting_since = None

    def _lost(self, missing: list[str]) -> None:
        if self._timing.on_loss == "continue":
            self.barrier.excuse(missing)
            self._say("resumed", f"lockstep goes on without {', '.join(missing)}: no step within the time-out")
        elif self._timing.on_loss == "pause":
            self._waiting_since = None
            late = ", ".join(missing)
            self._pause(f"lockstep: no step from {late} within the time-out; world/resume waits for them again")
        elif missing != self._reported_lost:
            self._reported_lost = missing
            self._say("paused", f"lockstep waits for {', '.join(missing)}")


def _readable(output: TickOutput, entry: DriverClient) -> list[Sample]:
    """Return the samples that a driver can read: those of ports whose fields have not changed since it began."""
    if output.ports is None or output.ports is entry.ports:
        return output.samples
    if entry.ports is None:
        entry.ports = output.ports
    ports = entry.ports
    return [sample for sample in output.samples if has_same_fields(sample.port, ports, output.ports)]
