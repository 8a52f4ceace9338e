"""What an autopilot knows of its vehicle: the sensors that it reads, the place, the dynamics, and the actuators that it commands."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from uwserver.actuators.base import Actuator
from uwserver.autopilot.allocation import Allocation, Shaft
from uwserver.autopilot.config import Gains, Mode
from uwserver.autopilot.rows import SENSOR
from uwserver.autopilot.state import STILL, Estimate, Six
from uwserver.frames import IDENTITY, Quat, Vec3
from uwserver.modifiers.columns import columns_of
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Field, Items, Value
from uwserver.ports.checks import bind

FIELDS: Mapping[str, tuple[str, ...]] = {
    "Imu": ("f_S", "w_S"),
    "Attitude": ("q_NS",),
    "FluidPressure": ("pressure",),
    "Dvl": ("v_S", "altitude", "figure_of_merit"),
    "Range": ("range",),
    "NavSatFix": ("latitude", "longitude", "horizontal_accuracy"),
    "Pose": ("p_NS", "q_NS"),
    "BeaconFix": ("beacon", "range", "p_beacon_S"),
    "BeaconRange": ("beacon", "range"),
    "Leak": ("leak",),
    "BatteryState": ("charge",),
}
"""The fields that it reads of each standard message that it can use. Of a pressure sensor with a field `depth` it reads that instead."""
MESSAGES = tuple(FIELDS)
IMU, ATTITUDE, PRESSURE, DVL, ALTIMETER, GPS, MOTION_CAPTURE, USBL, LBL, LEAK, BATTERY = range(len(MESSAGES))
"""Codes of the messages."""
STOPS_M, PASSES_M = 0.15, 1.0
"""Default distance at which a place counts as reached: for a vehicle that can stop there, and for one that cannot."""
MEASURED = 0.01
"""Density of the error of a measured acceleration, m2/s3."""
UNMEASURED = 0.25
"""The same without an accelerometer: how much vehicles accelerate."""


def fields_used(message: str, fields: Collection[Field]) -> tuple[str, ...]:
    """Return the names of the fields that it reads from a sensor of a standard message; none if it cannot use the message."""
    if message == "FluidPressure" and any(field.name == "depth" for field in fields):
        return ("depth",)
    return FIELDS.get(message, ())


class SensorInput(NamedTuple):
    """One sensor that the autopilot reads.

    Attributes:
        message: that its fields fit.
        fields: fields of its port.
        p, q: mounting: p_BS (m) and q_BS.
        sigma: standard deviation of its position that the operator expects, m.
        north: angle of its north east of true north, rad.
        density, atmosphere: those of a pressure sensor: rho g (Pa/m), and the pressure at the surface (Pa); 0 if it measures depth.
    """

    message: str
    fields: tuple[Field, ...]
    p: Vec3 = STILL
    q: Quat = IDENTITY
    sigma: float = 0.05
    north: float = 0.0
    density: float = 0.0
    atmosphere: float = 0.0


@dataclass(frozen=True)
class SiteData:
    """What the operator knows of the place.

    Attributes:
        gravity: m/s2.
        latitude, longitude: those of the origin of N, rad.
        beacons: assumed p_N (m) of beacons, by name.
        start: p_N where dead reckoning begins; None: at the origin of N, with a large uncertainty.
    """

    gravity: float = 9.81
    latitude: float = 0.0
    longitude: float = 0.0
    beacons: Mapping[str, Vec3] = field(default_factory=dict)
    start: Vec3 | None = None


class SensorInputs:
    """The sensors of one vehicle, as rows.

    Attributes:
        ports: paths of the sensors, in the order of the rows.
        rows: a SENSOR for each.
        beacons: (n, 3) p_N of the beacons whose place is known, m.
        text_ports: paths of the sensors whose samples contain texts. Compiled code does not read these.
        messages: the standard messages of the sensors.
        site: what the operator knows of the place.
    """

    def __init__(self, sensors: Mapping[str, SensorInput], site: SiteData) -> None:
        """Read these sensors, given by port path. Raises ValueError if a port lacks a field."""
        self.ports, self.site = tuple(sensors), site
        self.messages = frozenset(sensor.message for sensor in sensors.values())
        self.rows: Any = np.zeros(len(sensors), SENSOR)
        self.beacons: FloatArray = np.array(list(site.beacons.values()), float).reshape(-1, 3)
        self._names = list(site.beacons)
        self._columns = {path: columns_of(sensor.fields) for path, sensor in sensors.items()}
        self.text_ports = tuple(path for path, sensor in sensors.items() if FIELDS[sensor.message][0] == "beacon")
        for row, (path, sensor) in zip(self.rows, sensors.items(), strict=True):
            row["kind"] = MESSAGES.index(sensor.message)
            row["place"][:] = self._places(path, sensor)
            row["p"], row["q"], row["sigma"], row["north"] = sensor.p, sensor.q, sensor.sigma, sensor.north
            row["density"], row["atmosphere"] = sensor.density, sensor.atmosphere

    def _places(self, path: str, sensor: SensorInput) -> list[int]:
        """Return the places of the fields in a row of the stream. A text has the place behind the last number."""
        columns = self._columns[path]
        places = [columns.first[k] for k in bind(path, sensor.fields, *fields_used(sensor.message, sensor.fields))]
        places = [columns.width if place < 0 else place for place in places]
        return places + [0] * (3 - len(places))

    def numbers(self, port: str, values: Sequence[Value]) -> tuple[int, FloatArray]:
        """Return the row of a port, and the values of a sample as numbers. The last number is the index of the beacon that a text names; -1 if its
        place is unknown."""
        columns = self._columns[port]
        numbers = np.full(columns.width + 1, -1.0)
        columns.pack(values, numbers[:-1])
        for k in columns.loose:
            if values[k] in self._names:
                numbers[-1] = self._names.index(str(values[k]))
        return self.ports.index(port), numbers


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
        inertia: inertia of each axis, added mass included, kg and kg m2.
        reach: largest wrench of each axis, N and N m; of a torpedo: of the propeller at rest, and of the fins at 1 m/s.
        linear, quadratic: damping of each axis, N s/m and N s2/m2; not used for a torpedo.
        righting: righting of a torpedo: moment of weight and buoyancy, over the sine of roll or pitch, N m.
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
        names: names of the devices, ``thrusters.t1``.
        blocked: slots of other actuators that move the same devices.
        gains: at the start.
        divisor: ticks per step.
        dt: length of a step, s.
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
