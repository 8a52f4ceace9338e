"""What an autopilot knows of its vehicle: its parts, and the actuators that it holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from uwserver.autopilot.allocation import Allocation, Given
from uwserver.autopilot.estimator import Estimator, Known
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.outputs import Outputs
from uwserver.autopilot.state import Estimate, Memory, Mode, Orders, Six
from uwserver.ports import Items

STOPS_M, PASSES_M = 0.15, 1.0
"""Distance at which a place counts as reached where nothing else is said: of a vehicle that can stop there, and of one that cannot."""


class Hand(Protocol):
    """What an actuator can be told."""

    def apply(self, value: Given) -> None:
        """Carry out a command."""

    def neutral(self) -> None:
        """Go to the safe state."""


class Held(Protocol):
    """An actuator of the vehicle, which nobody else commands while the autopilot is armed."""

    active: bool
    refusal: str
    last_value: Items

    @property
    def actuator(self) -> Hand:
        """The actuator itself."""


class Helm(Protocol):
    """A way to control a kind of vehicle."""

    def speed(self, e: Estimate, m: Memory, known: Known) -> float:
        """Ahead, m/s."""

    def demand(self, e: Estimate, m: Memory, o: Orders, known: Known) -> Six:
        """The wrench (N, N m in B) that carries out the orders."""


@dataclass(frozen=True)
class Craft:
    """What the autopilot knows of its vehicle.

    Attributes:
        path: ``<vehicle>/autopilot``.
        estimator, allocation, helm: its parts.
        held: the actuators, in the order of the allocation's commands.
        blocked: others on the same devices.
        outputs: commands of `held` as parts of full ones.
        gains: at the start.
        divisor: ticks of a step.
        dt: of a step, s.
        flies: it cannot stay in a place.
        up: depth of the origin (m) from which on it has come up.
        mode, armed: at the start.
        on_leak, on_low_battery: what it does then.
    """

    path: str
    estimator: Estimator
    allocation: Allocation
    helm: Helm
    held: Sequence[Held]
    blocked: Sequence[Held]
    outputs: Outputs
    gains: Gains
    divisor: int
    dt: float
    flies: bool = False
    up: float = 0.3
    mode: Mode = "manual"
    armed: bool = False
    on_leak: str = "surface"
    on_low_battery: str = "surface"

    @property
    def arrival_m(self) -> float:
        """Distance at which a place counts as reached where nothing else is said, m."""
        return STOPS_M if not self.flies and 1 in self.allocation.axes else PASSES_M
