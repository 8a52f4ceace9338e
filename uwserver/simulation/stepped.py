"""A world that a program steps on its own thread, while a server shows it to clients. There is no simulation thread then."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from uwserver.ports import Event, Refused
from uwserver.ports.crossing import TickOutput
from uwserver.ports.sample_batch import Samples
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Time, Timing
from uwserver.simulation.goal import Goals
from uwserver.simulation.intake import Intake
from uwserver.simulation.mailbox import Mailbox
from uwserver.simulation.readers import Readers
from uwserver.simulation.thread import STEERING_NS, Simulation
from uwserver.world.driving import checked_ticks
from uwserver.world.world import Diverged, World


class Outlet(Bus):
    """Gives the output of ticks to the program, and to the loop what somebody there takes."""

    def __init__(self, wake_loop: Callable[[Callable[[], None]], object], time: Time) -> None:
        """Begin without sinks; the arguments are those of `Bus`."""
        super().__init__(wake_loop, time)
        self._made: list[TickOutput] = []

    @property
    def is_heard(self) -> bool:
        """Whether a sink takes samples. Any thread."""
        return bool(self._sample_sinks)

    def publish(self, output: TickOutput, wake: bool = True) -> None:
        """Hand a tick over, as `Bus.publish` does, and keep it for the program. The program's thread."""
        self._made.append(output)
        if self._sample_sinks or output.replies or output.events:
            super().publish(_own(output), wake)

    def take(self) -> list[TickOutput]:
        """Return what was published since the last call. The program's thread."""
        made, self._made = self._made, []
        return made


def _own(output: TickOutput) -> TickOutput:
    """Return a copy for the loop: each side makes samples of the rows, and the loop adds later ticks."""
    return TickOutput(
        output.tick, output.t_ns, [*output.made], output.replies, output.events, output.ports, output.jumps, output.batch,
        output.ticks,
    )  # fmt: skip


class Stepped(Simulation):
    """Makes ticks when its program asks for them, at the pace of the clock: while clients have paused the world, the program waits.

    What clients ask for is done on the program's thread, in `step` and `sync`. Only readers are served by the loop too, while the program
    does something else (`attend`).

    Attributes:
        in_use: locked by the thread that uses the world.
    """

    def __init__(self, world: World, timing: Timing, time: Time, outlet: Outlet, mailbox: Mailbox) -> None:
        """Prepare to step a world; nothing runs yet. Loop thread."""
        super().__init__(world, timing, time, outlet, mailbox)
        self.readers = Readers(world, outlet, self._steering, makes_all=True)
        self.in_use = threading.RLock()
        self._outlet = outlet
        self._diverged: Diverged | None = None

    # -- the program's thread -------------------------------------------------------------------------------------------------------

    def step(self, n: int, events: deque[Event]) -> Samples:
        """Run n ticks, as `Driven.step`, and return the samples delivered in them; since the last one, if clients have set the time
        meanwhile. After `stop`, ticks are made without clients.

        Args:
            n: ticks, a whole number above 0.
            events: gets what happens.

        Raises:
            Refused: n is no whole number above 0; nothing is stepped.
            Diverged: the state of a body is not finite. It has the samples of this call.
        """
        left, samples, jumps = checked_ticks(n), Samples(), self.world.jumps
        while left > 0:
            with self.in_use:
                outputs = self._quick_ticks(left) if self._is_quiet else self._ticks(left)
            if outputs is None:
                samples.join(self.world.step(left, events))
                break
            for output in outputs:
                left -= output.ticks
                if output.jumps != jumps:
                    jumps, samples = output.jumps, Samples()
                if output.batch is not None:
                    samples.add(output.batch)
                if output.made:
                    samples.add(output.made)
                if output.events:
                    events += output.events
            if self._diverged is not None:
                diverged, self._diverged = self._diverged, None
                self.paused = False  # the program decides what comes now
                diverged.samples = samples
                raise diverged
        return samples

    def _ticks(self, most: int) -> list[TickOutput] | None:
        """Do what clients have asked for, and make ticks if they let it. Returns what that gives; None if clients see no more ticks."""
        self._follow_jump()
        if self.failure:
            self._carry_out()  # a client may reset the world
        if self.failure or self._stop.is_set():
            return None
        self.until_tick = self.world.tick + most
        self._turn()
        return self._outlet.take()

    @property
    def _is_quiet(self) -> bool:
        """Whether ticks can be made without a look at clients: nobody takes samples, has asked for anything or sets the pace."""
        return (
            self.timing.mode == "freerun"
            and not (
                self._outlet.is_heard or self.mailbox.wake.is_set() or self.paused or self.failure or len(self._goals)
            )
            and self.world.jumps == self._jumps
        )

    def _quick_ticks(self, most: int) -> list[TickOutput]:
        try:
            output = self.world.advance(most=most, posted=self.mailbox.wake.posted)
        except Diverged as diverged:
            self._fail(diverged)
            return self._outlet.take()
        self.lateness.ticks += output.ticks
        if not (output.replies or output.events):
            return [output]
        self.bus.publish(output)
        return self._outlet.take()

    def sync(self) -> list[TickOutput]:
        """Do what clients have asked for, without a tick, and return what that gives."""
        with self.in_use:
            self._follow_jump()
            if not self._stop.is_set():
                self._steer()
                self._carry_out()
                self.bus.flush()
            return self._outlet.take()

    def take_events(self) -> list[Event]:
        """Return the events that no tick has given yet, as `World.take_events`, and tell clients of them."""
        with self.in_use:
            events = self.world.take_events()
            self._follow_jump()
            if events and not self._stop.is_set():
                world = self.world
                self.bus.publish(TickOutput(world.tick, world.t_ns, [], [], events, world.ports, world.jumps))
                self._outlet.take()
        return events

    def keep_time(self, timing: Timing) -> None:
        """Let ticks follow wall time in another way from now on."""
        with self.in_use:
            self.timing = timing
            self.pace.speed = timing.pace or timing.speed
            self.pace.release()

    def follow(self, world: World) -> None:
        """Go on with another world of the same scenario. Loop thread, while the program waits for it."""
        self._goals.give_up(Refused("preempted", "the world begins anew with another seed"))
        self.world, self.failure = world, ""
        self.readers = Readers(world, self.bus, self._steering, makes_all=True)
        self._goals, self._jumps = Goals(world, self.bus, self._time, self._stay_paused), world.jumps
        self._intake = Intake(world, self.mailbox.posted, self._time, self._stop)
        self._record = self._intake.ticked
        self.pace.release()
        self.lockstep.restart(world.tick, world.t_ns)

    def _fail(self, error: Diverged) -> None:
        super()._fail(error)
        self._diverged = error

    # -- the loop -------------------------------------------------------------------------------------------------------------------

    def attend(self) -> None:
        """Serve readers if the program does something else at present, and hand over what waits for the loop. Loop thread."""
        if self._stop.is_set():
            return
        if len(self._steering) and self.in_use.acquire(blocking=False):
            try:
                self._steer()
            finally:
                self.in_use.release()
        self.bus.flush()

    def give_up(self, refused: Refused) -> bool:
        """Refuse all requests that still wait, after `stop`. Loop thread. Returns whether that was possible now: it is not while the
        program's thread uses the world."""
        if not self.in_use.acquire(blocking=False):
            return False
        try:
            self._refuse_waiting(refused)
        finally:
            self.in_use.release()
        return True

    def _steer(self) -> None:
        for steered in self._intake.within(STEERING_NS, self._steering):
            steered.action()
