"""Lockstep: how far time may go. Named clients grant ticks from the loop; drivers do so on the simulation thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Mapping
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
"""Wall time that a driver is waited for at a time; between two such waits calls are answered."""

GLANCE_S = 0.004
"""Wall time that samples may wait for the loop while a driver steps: a wake-up for each tick would cost as much as the tick."""
GATHER_S = 0.02
"""Wall time that they may wait where nobody paces the world, for the same reason: with 500 wake-ups a second instead of 100, one client took twice
as much from a single vehicle, and with 50 the loop is a tenth less at work than with 100."""


class Seat:
    """A driver and the client that it is.

    Attributes:
        ports: those by which it reads samples; None before the first tick.
        answer_at: tick after which its peer is answered; None when nothing is owed to it.
        held: taken while the driver is called, so that nobody takes its socket away meanwhile.
    """

    def __init__(
        self, client: str, source: str, driver: Driver, on_reply: OnReply, ports: Mapping[str, Port] | None
    ) -> None:
        self.client = client
        self.source = source
        self.driver = driver
        self.on_reply = on_reply
        self.ports = ports
        self.answer_at: int | None = None
        self.held = threading.Lock()


class Lockstep:
    """The barrier of a simulation, and those who drive it. Simulation thread, but for `drive`.

    Attributes:
        barrier: who has granted how far.
    """

    def __init__(
        self,
        timing: Timing,
        time: Time,
        bus: Bus,
        say: Callable[[Literal["paused", "resumed"], str], None],
        pause: Callable[[str], None],
    ) -> None:
        """For one simulation.

        Args:
            timing, time, bus: of it.
            say: tells an event and its text.
            pause: stops time, for a reason.
        """
        self.barrier = Barrier(timing.lockstep_clients)
        self._timing = timing
        self._time = time
        self._bus = bus
        self._say = say
        self._pause = pause
        self._seats: dict[str, Seat] = {}
        """Replaced, never changed in place: both threads may come and go."""
        self._seating = threading.Lock()
        self._waiting_since: int | None = None
        self._told_lost: list[str] = []
        self._woken = 0

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
        with self._seating:
            if client in self._seats:
                raise Refused("busy", f'the world has a driver "{client}" already', client)
            self.barrier.join(client)
            self._seats = {**self._seats, client: seat}
        return lambda: self._leave(seat)

    def _leave(self, seat: Seat) -> None:
        with self._seating:
            if self._seats.get(seat.client) is seat:
                self._seats = {name: other for name, other in self._seats.items() if other is not seat}
                self.barrier.leave(seat.client)
        with seat.held:  # at most one look of the simulation thread, which is the last
            pass

    # -- the tick -------------------------------------------------------------------------------------------------------------------

    @property
    def asks(self) -> bool:
        """Whether there are drivers: waiting for them is the only sleep that is needed then."""
        return bool(self._seats)

    def orders(self, tick: int, ports: Mapping[str, Port]) -> Iterator[Command]:
        """Wait a moment for each driver that has not yet granted `tick`; yields the commands that come with its grant."""
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
        """Whether the samples of this tick wake the loop; those that do not wait for others, or for `Bus.flush`."""
        if not self._seats and self._timing.mode != "freerun":
            return True
        now = self._time.now_ns()
        if now - self._woken < (GLANCE_S if self._seats else GATHER_S) * NANOSECONDS:
            return False
        self._woken = now
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
        """Show a tick to the drivers, and let those answer whose order is carried out with it."""
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
            except Exception as error:  # a driver's fault must not end the simulation
                log.exception('the driver "%s" failed', seat.client)
                text = f"{type(error).__name__}: {error}"
        self._leave(seat)
        self._bus.reply(seat.on_reply, Reply(0, 0, fault=Refused("internal", text, seat.client).fault))
        return None

    def restart(self, tick: int, t_ns: int) -> None:
        """The world went to another time: nothing beyond `tick` is granted, and what was ordered is over."""
        self.barrier.restart(tick)
        for seat in self._seats.values():
            if seat.answer_at is not None:
                self._answer(seat, t_ns)

    # -- loss -----------------------------------------------------------------------------------------------------------------------

    def is_granted(self, tick: int) -> bool:
        """Whether `tick` may begin; if not, what the scenario says of lost clients is done."""
        missing = self.barrier.missing(tick)
        if not missing:
            self._waiting_since = None
            self._told_lost = []
            return True
        now = self._time.now_ns()
        if self._waiting_since is None:
            self._waiting_since = now
        timeout = self._timing.lockstep_timeout_s
        if timeout and now - self._waiting_since > timeout * NANOSECONDS:
            self._lost(missing)
        return False

    def wait_anew(self) -> None:
        """Give those who are late the whole time-out again."""
        self._waiting_since = None

    def _lost(self, missing: list[str]) -> None:
        if self._timing.on_loss == "continue":
            self.barrier.excuse(missing)
            self._say("resumed", f"lockstep goes on without {', '.join(missing)}: no step within the time-out")
        elif self._timing.on_loss == "pause":
            self._waiting_since = None
            late = ", ".join(missing)
            self._pause(f"lockstep: no step from {late} within the time-out; world/resume waits for them again")
        elif missing != self._told_lost:
            self._told_lost = missing
            self._say("paused", f"lockstep waits for {', '.join(missing)}")


def _readable(output: TickOutput, seat: Seat) -> list[Sample]:
    """What a driver can understand: the fields of a sensor are those that it found when it began, or it goes without."""
    if output.ports is None or output.ports is seat.ports:
        return output.samples
    if seat.ports is None:
        seat.ports = output.ports
    ports = seat.ports
    return [sample for sample in output.samples if has_same_fields(sample.port, ports, output.ports)]
