"""An autopilot as a part of its world: it hears its sensors, and acts before the bodies move."""

from __future__ import annotations

from typing import Any, ClassVar

from msgspec import Struct

from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.state import Estimate, Memory, Orders
from uwserver.ports import Sample
from uwserver.world.part import Part, Stage, State, read_record, record


class PilotState(State, frozen=True):
    """Records of what an autopilot believes, remembers, and was told."""

    estimate: bytes
    memory: bytes
    orders: bytes


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
        return PilotState(record(pilot.estimate), record(pilot.memory), record(pilot.orders))

    def check(self, state: Any) -> None:
        """The records are an autopilot's, and of this vehicle."""
        self.pilot.check(*self._read(state))

    def load(self, state: PilotState) -> None:
        """Go on from there."""
        self.pilot.load(*self._read(state))
        self.next_tick = 0

    def _read(self, state: PilotState) -> tuple[Estimate, Memory, Orders]:
        pilot, found = self.pilot, list[Struct]()
        for data, like in (
            (state.estimate, pilot.estimate),
            (state.memory, pilot.memory),
            (state.orders, pilot.orders),
        ):
            found.append(read_record(data, like))
        estimate, memory, orders = found
        return estimate, memory, orders  # type: ignore[return-value]  # of the types that were asked for
