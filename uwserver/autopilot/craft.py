"""What an autopilot knows of its vehicle: its parts, and the actuators that it holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from uwserver.autopilot.allocation import Allocation
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.sources import Hearing
from uwserver.autopilot.state import Estimate, Mode
from uwserver.autopilot.tracks import MEASURED, UNMEASURED
from uwserver.ports import Items

STOPS_M, PASSES_M = 0.15, 1.0
"""Distance at which a place counts as reached where nothing else is said: of a vehicle that can stop there, and of one that cannot."""


class Hand(Protocol):
    """What an actuator can be told, beside the commands that go straight into its rows."""

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

    def fill(self, craft: Any) -> None:
        """Write what it knows of the vehicle into a CRAFT."""


@dataclass(frozen=True)
class Craft:
    """What the autopilot knows of its vehicle.

    Attributes:
        path: ``<vehicle>/autopilot``.
        hearing, allocation, helm: its parts.
        held: the actuators, in the order of the allocation's devices.
        shares: how many devices each has.
        names: of the devices, ``thrusters.t1``.
        blocked: others on the same devices.
        gains: at the start.
        divisor: ticks of a step.
        dt: of a step, s.
        flies: it cannot stay in a place.
        up: depth of the origin (m) from which on it has come up.
        mode, armed: at the start.
        on_leak, on_low_battery: what it does then.
    """

    path: str
    hearing: Hearing
    allocation: Allocation
    helm: Helm
    held: Sequence[Held]
    shares: Sequence[int]
    names: tuple[str, ...]
    blocked: Sequence[Held]
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

    @property
    def sees_bottom(self) -> bool:
        """Whether a sensor of it can measure the altitude."""
        return not self.hearing.messages.isdisjoint(("Dvl", "Range"))

    @property
    def dives(self) -> bool:
        """Whether it can choose its depth: by thrust, or under way by its pitch."""
        return self.flies or 2 in self.allocation.axes

    def fill(self, craft: Any) -> None:
        """Write it into a CRAFT."""
        hearing, place = self.hearing, self.hearing.place
        craft["divisor"], craft["dt"], craft["up"] = self.divisor, self.dt, self.up
        craft["means"] = self.allocation.means
        craft["axes"][list(self.allocation.axes)] = 1
        craft["has_imu"], craft["has_attitude"] = "Imu" in hearing.messages, "Attitude" in hearing.messages
        craft["restlessness"] = MEASURED if "Imu" in hearing.messages else UNMEASURED
        craft["gravity"], craft["latitude"], craft["longitude"] = place.gravity, place.latitude, place.longitude
        self.helm.fill(craft)

    def begin(self) -> Estimate:
        """What is believed before the first sample."""
        start = self.hearing.place.start
        return Estimate() if start is None else Estimate(p=start, flat=(1.0, 0.0, 0.0, 1.0, 0.0, 0.01))
