"""Turns the sticks of a pilot into commands of thrusters, shafts, fins or a wrench, for any vehicle, and gives its thrust when it is held fast.

The mix is that of a pilot's box in manual mode. Each propulsor gets a share of a stick according to its position and direction, and nothing
corrects the motion. Thrusters and propellers push along x, y and z of B and turn about z, with the smallest sum of squares that does nothing else
on these four axes; pitch and roll are ignored. Fins turn, pitch and hold roll according to the wrench of each fin at speed ahead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from msgspec import UnsetType

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU
from uwserver.scenario.vehicle.tables import VehicleFile

DEPTH = 500.0
"""Depth in m at which the surface has no effect."""
_HEAVY = 1e12
"""Mass in kg and inertia in kg m2 of a body that no thrust moves."""
_DT, _SPUN_UP_S = 0.02, 10.0
_SMALL = 0.02
"""Angle in rad of a fin to measure its effect, and the part of an effect that counts as none."""
_AXES = (0, 1, 2, 5)
"""Surge, sway, heave and yaw in a wrench."""


def bollard(body: BodyParams, tell: Sequence[Callable[[Hydrodynamics, int], None]]) -> FloatArray:
    """Return the wrench (n, 6) in B about the origin, N and N m, of n commands, after shafts and lags have settled.

    Args:
        body: parameters of the vehicle.
        tell: functions that command the vehicle in a row of the world.
    """
    zero, eye = np.zeros((6, 6)), np.eye(6)
    fast = replace(
        body, M_RB=_HEAVY * eye, M_A=zero, D_L=zero, D_Q=zero, D_S=zero, weight=0.0, buoyancy=0.0, displaced=0.0
    )
    hydro = Hydrodynamics([fast] * len(tell), _DT)
    hydro.state[:, 2] = DEPTH
    for row, command in enumerate(tell):
        command(hydro, row)
    for k in range(round(_SPUN_UP_S / _DT)):
        hydro.advance(k * _DT)
    wrench: FloatArray = hydro.rates_of_change(_SPUN_UP_S)[1]
    return wrench


class Sticks(NamedTuple):
    """The positions of a pilot's sticks, from -1 to 1 of full command, except for two angles in rad.

    Attributes:
        surge, sway, heave, yaw: thrust and moment in B.
        rudder: angle, rad; positive turns to starboard.
        planes: angle, rad; positive dives.
        sink: ballast; 1 is as heavy as possible, -1 as light as possible.
        nose_down: moving masses; 1 is as far forward as possible.
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


class Helm:
    """The sticks of one vehicle.

    Attributes:
        body: parameters of the vehicle.
        rudder, planes: largest angle, rad; 0 without fins for it.
        stalls: smallest angle of attack at which a foil of the fins stalls, rad; infinite without foils.
    """

    def __init__(self, vehicle: VehicleFile, body: BodyParams) -> None:
        """Take a checked vehicle and its parameters. Actuators of kinds of an extension stay at rest."""
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
        self.stalls = min((foil.stall for foil in body.appendages.foils if foil.servo), default=np.inf)

    def has(self, stick: str) -> bool:
        """Tell whether a stick of `Sticks` moves anything."""
        if stick in ("rudder", "planes"):
            return bool(getattr(self, stick) > 0.0)
        if stick in ("sink", "nose_down"):
            return bool((self._sink if stick == "sink" else self._down).any())
        column = Sticks._fields.index(stick)
        return any(part[..., column].any() for part in self._mix)

    @property
    def glides(self) -> bool:
        """Whether the vehicle is driven by ballast and a moving mass, and by no propulsor."""
        return self.has("sink") and self.has("nose_down") and not self.has("surge")

    def tell(self, hydro: Hydrodynamics, row: int, sticks: Sticks) -> None:
        """Command the body in a row of the world, until the next command."""
        record, asked = hydro.bodies[row], np.array(sticks[:4])
        thrusters, shafts, wrench = self._mix
        first, count = int(record["thruster_first"]), int(record["thruster_count"])
        hydro.thrusters["command"][first : first + count] = np.clip(thrusters @ asked, -1.0, 1.0)
        hydro.thrusters["fresh"][first : first + count] = 1
        first, count = int(record["servo_first"]), int(record["servo_count"])
        values = self._neutral.copy()
        values[self._shafts] += shafts @ asked
        values[self._fins] += self._turn * sticks.rudder + self._dive * sticks.planes
        values += abs(sticks.sink) * self._sink[int(sticks.sink < 0.0)]
        values += abs(sticks.nose_down) * self._down[int(sticks.nose_down < 0.0)]
        servos = hydro.servos[first : first + count]
        hydro.servos["command"][first : first + count] = np.clip(values, servos["low"], servos["high"])
        hydro.wrenches["bias"][int(record["wrench_first"]), list(_AXES)] = wrench @ asked


def _mix(vehicle: VehicleFile, body: BodyParams) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the commands per unit of the sticks surge, sway, heave and yaw. A stick that moves nothing has a column of zeros.

    They are the commands of thrusters (n, 4), the speeds of shafts in rad/s (m, 4), and force in N and moment in N m on these axes (4, 4).
    """
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
    if any(actuator.message == "Wrench" for actuator in vehicle.actuators.values()) and not shares.any():
        own = vehicle.autopilot
        if not isinstance(own, UnsetType) and not isinstance(own.max_wrench, UnsetType):
            wrench = np.diag([own.max_wrench[axis] for axis in _AXES])
    return shares[: len(thrusters)], shares[len(thrusters) :] * highs[:, None], wrench


def _push(hydro: Hydrodynamics, row: int, thruster: int) -> None:
    """Set one thruster of the body in a row to full command."""
    k = int(hydro.bodies["thruster_first"][row]) + thruster
    hydro.thrusters["command"][k], hydro.thrusters["fresh"][k] = 1.0, 1


def _spin(hydro: Hydrodynamics, row: int, servo: int, speed: float) -> None:
    """Command one shaft of the body in a row to a speed, rad/s."""
    hydro.servos["command"][int(hydro.bodies["servo_first"][row]) + servo] = speed


def _column(r: Sequence[float], axis: Sequence[float]) -> FloatArray:
    """Return the wrench (6) about the origin of a unit force at r along an axis."""
    unit = np.array(axis) / np.linalg.norm(axis)
    column: FloatArray = np.concatenate([unit, np.cross(r, unit)])
    return column


def _shares(columns: FloatArray) -> FloatArray:
    """Return the parts (n, 4) of full command that n propulsors get for full surge, sway, heave and yaw.

    Args:
        columns: (6, n) wrench of each propulsor at full command, N and N m.
    """
    rows = columns[list(_AXES)]
    shares = np.zeros((columns.shape[1], 4))
    if columns.shape[1] == 0:
        return shares
    # Moments are divided by a typical arm, so that forces and moments weigh alike in the pseudo-inverse.
    arm = max(float(np.abs(columns[3:]).max()), 1e-9) / max(float(np.abs(columns[:3]).max()), 1e-9)
    scaled = rows / np.array([[1.0], [1.0], [1.0], [max(arm, 1e-9)]])
    inverse = np.linalg.pinv(scaled, rcond=0.05)
    made = scaled @ inverse
    for k in range(4):
        largest = float(np.abs(inverse[:, k]).max())
        # The vehicle can command an axis only if the result is mostly on this axis.
        if made[k, k] > 0.5 and largest > 0.0:
            shares[:, k] = inverse[:, k] / largest
    shares[np.abs(shares) < _SMALL] = 0.0
    return shares


def _weights(body: BodyParams) -> tuple[FloatArray, FloatArray]:
    """Return what to add to the neutral of servos, (2, servos) for each stick: ballast for heavy and light, moving masses for forward and aft."""
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
    """Return the wrench (6, n) per radian of each fin at 1 m/s ahead."""
    if not fins:
        return np.zeros((6, 0))
    # The last row has all fins at neutral; the others differ from it by one fin.
    hydro = Hydrodynamics([body] * (len(fins) + 1), 0.01)
    hydro.state[:, 2], hydro.state[:, NU] = DEPTH, 1.0
    for row, fin in enumerate(fins):
        hydro.servos["value"][int(hydro.bodies["servo_first"][row]) + fin] = _SMALL
    nu_dot = hydro.rates_of_change(0.0)[0]
    effects: FloatArray = ((nu_dot[:-1] - nu_dot[-1]) @ (body.M_RB + body.M_A).T).T / _SMALL
    return effects


def _direction(effects: FloatArray, axis: int, limits: FloatArray) -> tuple[FloatArray, float]:
    """Return the angle of each fin per angle of the stick, and the largest angle of the stick, rad.

    Args:
        effects: (6, n) wrench per radian of each fin.
        axis: 4 to dive, about y, or 5 to turn to starboard, about z.
        limits: (n) largest angle of each fin, rad.
    """
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
