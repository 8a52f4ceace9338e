"""What an autopilot knows of its vehicle: sensors, dynamics, and the actuators that it commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any, Protocol

from uwserver.actuators.base import Actuator
from uwserver.autopilot.allocation import Allocation
from uwserver.autopilot.fins import Shaft
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.sensor_inputs import SensorInputs
from uwserver.autopilot.state import Estimate, Mode, Six
from uwserver.autopilot.tracks import MEASURED, UNMEASURED
from uwserver.ports import Items

STOPS_M, PASSES_M = 0.15, 1.0
"""Default distance at which a place counts as reached: for a vehicle that can stop there, and for one that cannot."""


class Held(Protocol):
    """The slot of an actuator in the world. While the autopilot is armed, it refuses the commands of all others."""

    active: bool
    refusal: str
    last_value: Items

    @property
    def actuator(self) -> Actuator:
        """The actuator."""


@dataclass(frozen=True)
class Dynamics:
    """What the controllers know of the dynamics of a vehicle. A vehicle with a shaft is controlled as a torpedo (`torpedo`), others as one that
    hovers (`hover`).

    Attributes:
        inertia: of each axis, added mass included, kg and kg m2.
        reach: largest wrench of each axis, N and N m; of a torpedo: of the propeller at rest, and of the fins at 1 m/s.
        linear, quadratic: damping of each axis, N s/m and N s2/m2; not used for a torpedo.
        righting: of a torpedo: moment of weight and buoyancy, over the sine of roll or pitch, N m.
        shaft: the propeller of a torpedo.
    """

    inertia: Six
    reach: Six
    linear: Six = (0.0,) * 6
    quadratic: Six = (0.0,) * 6
    righting: float = 0.0
    shaft: Shaft | None = None


@dataclass(frozen=True)
class VehicleSpec:
    """What the autopilot knows of its vehicle.

    Attributes:
        path: ``<vehicle>/autopilot``.
        inputs: its sensors.
        allocation: its actuators.
        dynamics: its dynamics.
        held: slots of the actuators, in the order of the devices of the allocation.
        shares: number of devices of each of them.
        names: of the devices, ``thrusters.t1``.
        blocked: slots of other actuators that move the same devices.
        gains: at the start.
        divisor: ticks per step.
        dt: of a step, s.
        up: the vehicle is at the surface if its origin is above this depth, m.
        mode, armed: at the start.
        on_leak, on_low_battery: what it does then: "surface" or "warn".
    """

    path: str
    inputs: SensorInputs
    allocation: Allocation
    dynamics: Dynamics
    held: Sequence[Held]
    shares: Sequence[int]
    names: tuple[str, ...]
    blocked: Sequence[Held]
    gains: Gains
    divisor: int
    dt: float
    up: float = 0.3
    mode: Mode = "manual"
    armed: bool = False
    on_leak: str = "surface"
    on_low_battery: str = "surface"

    @property
    def is_torpedo(self) -> bool:
        """Whether it is controlled as a torpedo, which cannot stay in one place."""
        return self.dynamics.shaft is not None

    @property
    def arrival_m(self) -> float:
        """Default distance at which a place counts as reached, m."""
        return STOPS_M if not self.is_torpedo and 1 in self.allocation.axes else PASSES_M

    @property
    def sees_bottom(self) -> bool:
        """Whether it has a sensor that can measure the altitude."""
        return not self.inputs.messages.isdisjoint(("Dvl", "Range"))

    @property
    def dives(self) -> bool:
        """Whether it can choose its depth: by thrust, or by its pitch when it moves."""
        return self.is_torpedo or 2 in self.allocation.axes

    def fill(self, row: Any) -> None:
        """Write it into a SPEC."""
        messages, site, dynamics = self.inputs.messages, self.inputs.site, self.dynamics
        row["divisor"], row["dt"], row["up"], row["means"] = self.divisor, self.dt, self.up, self.allocation.means
        row["axes"][list(self.allocation.axes)] = 1
        row["has_imu"], row["has_attitude"] = "Imu" in messages, "Attitude" in messages
        row["restlessness"] = MEASURED if "Imu" in messages else UNMEASURED
        row["gravity"], row["latitude"], row["longitude"] = site.gravity, site.latitude, site.longitude
        row["inertia"], row["reach"], row["righting"] = dynamics.inertia, dynamics.reach, dynamics.righting
        row["linear"], row["quadratic"] = dynamics.linear, dynamics.quadratic
        if dynamics.shaft is not None:
            row["torpedo"], row["shaft"] = 1, astuple(dynamics.shaft)

    def begin(self) -> Estimate:
        """Return the estimate before the first sample."""
        start = self.inputs.site.start
        return Estimate() if start is None else Estimate(p=start, flat=(1.0, 0.0, 0.0, 1.0, 0.0, 0.01))
