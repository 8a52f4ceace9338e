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

LOOK_S = 0.02
"""Wall time of one wait for a driver. Between two waits calls are answered."""

GLANCE_S = 0.004
"""Wall time that samples may wait for the loop while a driver steps: waking the loop for each tick would take as long as the tick."""
GATHER_S = 0.02
"""Wall time that samples may wait if nothing paces the world, for the same reason. With 500 wake-ups a second instead of 100, one client
slowed a single vehicle twice as much; with 50, the loop works a tenth less than with 100."""


@dataclass(eq=False)
class Seat:
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
            timing, time, bus: of the simulation.
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
        self._seats: dict[str, Seat] = {}
        self._seats_lock = threading.Lock()
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
        seat = Seat(client, source, driver, on_reply, self._bus.ports)
        with self._seats_lock:
            if client in self._seats:
                raise Refused("busy", f'the world has a driver "{client}" already', client)
            self.barrier.join(client)
            self._seats = {**self._seats, client: seat}
        return lambda: self._leave(seat)

    def _leave(self, seat: Seat) -> None:
        with self._seats_lock:
            if self._seats.get(seat.client) is seat:
                self._seats = {name: other for name, other in self._seats.items() if other is not seat}
                self.barrier.leave(seat.client)
        with seat.held:  # The simulation thread may be in a last call of the driver; wait for its end.
            pass

    # -- the tick -------------------------------------------------------------------------------------------------------------------

    @property
    def asks(self) -> bool:
        """Whether there are drivers. Waiting for them is then the only sleep that is needed."""
        return bool(self._seats)

    def orders(self, tick: int, ports: Mapping[str, Port]) -> Iterator[Command]:
        """Wait a moment for each driver that has not yet granted `tick`. Yields the commands that come with their grants."""
        for seat in self._seats.values():
            if tick >= self.barrier.granted(seat.client):
                order = self._order(seat)
                if order is not None:
                    seat.answer_at = self.barrier.grant(seat.client, order.ticks, tick)
                    yield from self._commands(seat, order, ports)

    def _order(self, seat: Seat) -> Order | None:
        if self.barrier.is_excused(seat.client):
            return self._call(seat, lambda driver: driver.order(0.0))
        order = self._call(seat, lambda driver: driver.order(GLANCE_S))
        if order is None:
            self._bus.flush()
            order = self._call(seat, lambda driver: driver.order(LOOK_S))
        return order

    def wakes(self) -> bool:
        """Return whether the samples of this tick wake the loop. Otherwise they wait for later ones, or for `Bus.flush`."""
        if not self._seats and self._timing.mode != "freerun":
            return True
        now = self._time.now_ns()
        if now - self._last_wake_ns < (GLANCE_S if self._seats else GATHER_S) * NANOSECONDS:
            return False
        self._last_wake_ns = now
        return True

    def _commands(self, seat: Seat, order: Order, ports: Mapping[str, Port]) -> Iterator[Command]:
        for path, value in order.commands:
            try:
                find("port", path, ports)
                yield Command(path, checked_command(ports[path], value), seat.source)
            except Refused as refused:
                fault = refused.fault
                self._call(seat, lambda driver: driver.refuse(fault))  # noqa: B023  # called at once

    def ticked(self, output: TickOutput) -> None:
        """Show a tick to the drivers, and let drivers answer whose order ends with it."""
        for seat in self._seats.values():
            samples = _readable(output, seat)
            self._call(seat, lambda driver: driver.see(output.t_ns, samples))  # noqa: B023  # called at once
            if seat.answer_at is not None and output.tick >= seat.answer_at:
                self._answer(seat, output.t_ns)

    def _answer(self, seat: Seat, t_ns: int) -> None:
        seat.answer_at = None
        self._call(seat, lambda driver: driver.answer(t_ns))

    def _call(self, seat: Seat, work: Callable[[Driver], T]) -> T | None:
        with seat.held:
            if self._seats.get(seat.client) is not seat:
                return None
            try:
                return work(seat.driver)
            except Exception as error:  # A fault of a driver must not end the simulation.
                log.exception('the driver "%s" failed', seat.client)
                text = f"{type(error).__name__}: {error}"
        self._leave(seat)
        self._bus.reply(seat.on_reply, Reply(0, 0, fault=Refused("internal", text, seat.client).fault))
        return None

    def restart(self, tick: int, t_ns: int) -> None:
        """Drop all grants and orders beyond `tick`, as the world was put to another time."""
        self.barrier.restart(tick)
        for seat in self._seats.values():
            if seat.answer_at is not None:
                self._answer(seat, t_ns)

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


def _readable(output: TickOutput, seat: Seat) -> list[Sample]:
    """Return the samples that a driver can read: those of ports whose fields have not changed since it began."""
    if output.ports is None or output.ports is seat.ports:
        return output.samples
    if seat.ports is None:
        seat.ports = output.ports
    ports = seat.ports
    return [sample for sample in output.samples if has_same_fields(sample.port, ports, output.ports)]
