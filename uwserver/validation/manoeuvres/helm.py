"""What a vehicle can be told, whatever drives it: sticks of a pilot become commands of thrusters, shafts, fins or a wrench.

The mix is that of a pilot's box in manual mode: each propulsor gets its share of a stick by where it sits and where it pushes, and nobody corrects.
Thrusters and propellers push along B's x, y, z and turn about z with the least sum of squares that makes nothing else of these four; pitch and
roll are nobody's business. Fins turn, pitch and hold roll by what each does when the vehicle goes ahead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from msgspec import UnsetType

from uwserver.actuators import ForceTorqueConfig
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.validation.manoeuvres.bollard import DEPTH, bollard

_SMALL = 0.02
"""rad, of a fin to see what it does; and what part of an effect counts as none."""
_AXES = (0, 1, 2, 5)


class Sticks(NamedTuple):
    """What a pilot asks for. Of full command, -1..1, but for the angles (rad) of rudder (positive: to starboard) and planes (positive: dive).

    Attributes:
        sink: of ballast: 1 as heavy as it gets, -1 as light.
        nose_down: of moving masses: 1 as far forward as they go.
    """

    surge: float = 0.0
    sway: float = 0.0
    heave: float = 0.0
    yaw: float = 0.0
    rudder: float = 0.0
    planes: float = 0.0
    sink: float = 0.0
    nose_down: float = 0.0


GLIDE_DOWN = Sticks(sink=1.0, nose_down=1.0)


@dataclass(frozen=True)
class _Mix:
    """Commands per unit of each stick: of thrusters (n, 4) and shafts in rad/s (m, 4) for surge, sway, heave and yaw; of the wrench (4).

    A stick that moves nothing has a column of zeros.
    """

    thrusters: FloatArray
    shafts: FloatArray
    wrench: FloatArray


class Helm:
    """Sticks of one vehicle.

    Attributes:
        body: its parameters.
        rudder, planes: largest angle, rad; 0 without fins for it.
        stalls: smallest angle of attack at which one of the fins' foils stalls, rad; infinite without foils.
    """

    def __init__(self, vehicle: VehicleFile, body: BodyParams) -> None:
        """Of a checked vehicle and its parameters. Actuators of kinds of an extension are left at rest."""
        self.body = body
        servos = body.appendages.servos
        self._mix = _mix(vehicle, body)
        self._shafts = [k for k, servo in enumerate(servos) if servo.name.startswith("propellers.")]
        self._fins = [k for k, servo in enumerate(servos) if servo.name.startswith("fins.")]
        self._neutral = np.array([servo.neutral for servo in servos])
        self._sink, self._down = _weights(body)
        effects = _fin_effects(body, self._fins)
        limits = np.array([servos[k].high for k in self._fins])
        self._turn, self.rudder = _direction(effects, 5, limits)
        self._dive, self.planes = _direction(effects, 4, limits)
        foils = [foil.stall for foil in body.appendages.foils if foil.servo]
        self.stalls = min(foils, default=np.inf)

    def has(self, stick: str) -> bool:
        """Whether a stick of `Sticks` moves anything."""
        if stick in ("rudder", "planes"):
            return bool(getattr(self, stick) > 0.0)
        if stick in ("sink", "nose_down"):
            return bool((self._sink if stick == "sink" else self._down).any())
        column = Sticks._fields.index(stick)
        return any(part[..., column].any() for part in (self._mix.thrusters, self._mix.shafts, self._mix.wrench))

    @property
    def glides(self) -> bool:
        """Whether ballast and a moving mass drive it, and no propulsor."""
        return self.has("sink") and self.has("nose_down") and not self.has("surge")

    def tell(self, hydro: Hydrodynamics, row: int, sticks: Sticks) -> None:
        """Command the body in this row from now on."""
        record, asked, mix = hydro.bodies[row], np.array(sticks[:4]), self._mix
        first, count = int(record["thruster_first"]), int(record["thruster_count"])
        rows = slice(first, first + count)
        hydro.thrusters["command"][rows] = np.clip(mix.thrusters @ asked, -1.0, 1.0)
        hydro.thrusters["fresh"][rows] = 1
        first, count = int(record["servo_first"]), int(record["servo_count"])
        values = self._neutral.copy()
        values[self._shafts] += mix.shafts @ asked
        values[self._fins] += self._turn * sticks.rudder + self._dive * sticks.planes
        values += abs(sticks.sink) * self._sink[int(sticks.sink < 0.0)]
        values += abs(sticks.nose_down) * self._down[int(sticks.nose_down < 0.0)]
        servos = hydro.servos[first : first + count]
        hydro.servos["command"][first : first + count] = np.clip(values, servos["low"], servos["high"])
        wrench = hydro.wrenches["bias"][int(record["wrench_first"])]
        wrench[list(_AXES)] = mix.wrench @ asked


def _mix(vehicle: VehicleFile, body: BodyParams) -> _Mix:
    thrusters, propellers = body.thrusters, body.appendages.propellers
    names = [servo.name for servo in body.appendages.servos]
    servos = [names.index(propeller.servo) for propeller in propellers]
    highs = np.array([body.appendages.servos[k].high for k in servos])
    placed = [(t.r, t.axis) for t in thrusters] + [(p.r, p.axis) for p in propellers]
    columns = np.array([_column(r, axis) for r, axis in placed]).reshape(-1, 6)
    alone = [partial(_push, thruster=k) for k in range(len(thrusters))]
    alone += [partial(_spin, servo=k, speed=high) for k, high in zip(servos, highs.tolist(), strict=True)]
    strengths = np.einsum("ni,ni->n", bollard(body, alone)[:, :3], columns[:, :3])
    shares = _shares((columns * np.maximum(strengths, 1e-9)[:, None]).T)
    wrench = np.zeros((4, 4))
    if any(isinstance(actuator, ForceTorqueConfig) for actuator in vehicle.actuators.values()) and not shares.any():
        own = vehicle.autopilot
        if not isinstance(own, UnsetType) and not isinstance(own.max_wrench, UnsetType):
            wrench = np.diag([own.max_wrench[axis] for axis in _AXES])
    split = len(thrusters)
    return _Mix(shares[:split], shares[split:] * highs[:, None], wrench)


def _push(hydro: Hydrodynamics, row: int, thruster: int) -> None:
    """One thruster of the body in this row at full command."""
    k = int(hydro.bodies["thruster_first"][row]) + thruster
    hydro.thrusters["command"][k], hydro.thrusters["fresh"][k] = 1.0, 1


def _spin(hydro: Hydrodynamics, row: int, servo: int, speed: float) -> None:
    """One shaft of the body in this row at its speed, rad/s."""
    hydro.servos["command"][int(hydro.bodies["servo_first"][row]) + servo] = speed


def _column(r: Sequence[float], axis: Sequence[float]) -> FloatArray:
    unit = np.array(axis) / np.linalg.norm(axis)
    column: FloatArray = np.concatenate([unit, np.cross(r, unit)])
    return column


def _shares(columns: FloatArray) -> FloatArray:
    """(n, 4) part of full command of n propulsors for full surge, sway, heave and yaw; `columns` is (6, n), the wrench of each at full command."""
    rows = columns[list(_AXES)]
    shares = np.zeros((columns.shape[1], 4))
    if columns.shape[1] == 0:
        return shares
    arm = max(float(np.abs(columns[3:]).max()), 1e-9) / max(float(np.abs(columns[:3]).max()), 1e-9)
    scaled = rows / np.array([[1.0], [1.0], [1.0], [max(arm, 1e-9)]])
    inverse = np.linalg.pinv(scaled, rcond=0.05)
    made = scaled @ inverse
    for k in range(4):
        largest = float(np.abs(inverse[:, k]).max())
        # What comes out beside the axis asked for must be small, or the axis is not this vehicle's to command.
        if made[k, k] > 0.5 and largest > 0.0:
            shares[:, k] = inverse[:, k] / largest
    shares[np.abs(shares) < _SMALL] = 0.0
    return shares


def _weights(body: BodyParams) -> tuple[FloatArray, FloatArray]:
    """(2, servos) each: what ballast adds to the neutral for as heavy and as light as it gets, and moving masses for forward and aft."""
    servos = body.appendages.servos
    names = [servo.name for servo in servos]
    sink, down = np.zeros((2, len(servos))), np.zeros((2, len(servos)))
    for weight in body.appendages.weights:
        k = names.index(weight.servo)
        low, high = servos[k].low - servos[k].neutral, servos[k].high - servos[k].neutral
        if weight.force != 0.0:
            sink[:, k] = (high, low) if weight.force > 0.0 else (low, high)
        elif weight.moment[0] != 0.0:
            down[:, k] = (high, low) if weight.moment[0] > 0.0 else (low, high)
    return sink, down


def _fin_effects(body: BodyParams, fins: Sequence[int]) -> FloatArray:
    """(6, n) wrench per radian of each fin at 1 m/s ahead."""
    if not fins:
        return np.zeros((6, 0))
    hydro = Hydrodynamics([body] * (len(fins) + 1), 0.01)
    hydro.state[:, 2], hydro.state[:, NU] = DEPTH, 1.0
    for row, fin in enumerate(fins):
        hydro.servos["value"][int(hydro.bodies["servo_first"][row]) + fin] = _SMALL
    nu_dot = hydro.rates_of_change(0.0)[0]
    effects: FloatArray = ((nu_dot[:-1] - nu_dot[-1]) @ (body.M_RB + body.M_A).T).T / _SMALL
    return effects


def _direction(effects: FloatArray, axis: int, limits: FloatArray) -> tuple[FloatArray, float]:
    """Angle of each fin for an angle of all together about y (dive) or z (to starboard), and the largest such angle, rad."""
    none = np.zeros(effects.shape[1]), 0.0
    if effects.shape[1] == 0:
        return none
    inverse = np.linalg.pinv(effects[3:], rcond=0.05)
    if float(effects[axis] @ inverse[:, axis - 3]) < 0.5:
        return none
    angles = inverse[:, axis - 3] * (1.0 if axis == 5 else -1.0)
    angles = angles / np.abs(angles).max()
    angles[np.abs(angles) < _SMALL] = 0.0
    moving = angles != 0.0
    return angles, float((limits[moving] / np.abs(angles[moving])).min())
