"""An autopilot as a part of its world: it hears its sensors, and acts before the bodies move."""

from __future__ import annotations

from copy import copy
from typing import Any, ClassVar

from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.state import Estimate, Memory, Orders
from uwserver.ports import Sample
from uwserver.world.part import Part, Stage, State


class PilotState(State, frozen=True):
    """What an autopilot believes, remembers, and was told; nobody changes these copies."""

    estimate: Estimate
    memory: Memory
    orders: Orders


class Piloting(Part):
    """One autopilot; it steps with its divisor."""

    state_type = PilotState
    stage: ClassVar[Stage] = Stage.PILOTS

    def __init__(self, pilot: Autopilot) -> None:
        self.pilot = pilot
        self.hears = tuple(pilot.craft.estimator.sources)
        self.next_tick = 0

    @property
    def path(self) -> str:
        """``<vehicle>/autopilot``."""
        return self.pilot.craft.path

    def before(self, tick: int, t_ns: int) -> None:
        """Fly, when it is due."""
        divisor = self.pilot.divisor
        if tick % divisor == 0:
            self.pilot.step(t_ns)
        self.next_tick = tick - tick % divisor + divisor

    def hear(self, sample: Sample, t_ns: int) -> None:
        """Take the sample into the estimate."""
        self.pilot.take(sample, t_ns)

    def leave(self, why: str) -> None:
        """Answer who waits for the end of a way."""
        self.pilot.preempt(why)

    def save(self) -> PilotState:
        """All that it remembers; the call that waits is not part of it."""
        pilot = self.pilot
        return PilotState(copy(pilot.estimate), copy(pilot.memory), copy(pilot.orders))

    def check(self, state: Any) -> None:
        """They are of this vehicle."""
        self.pilot.check(state.estimate, state.memory, state.orders)

    def load(self, state: PilotState) -> None:
        """Go on from there."""
        self.pilot.load(copy(state.estimate), copy(state.memory), copy(state.orders))
        self.next_tick = 0
