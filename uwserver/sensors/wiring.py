"""What the instruments inside a vehicle are wired to: its thrusters, and the contacts of its hull."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.bodies import Hydrodynamics


class Electric(NamedTuple):
    """How much power a thruster draws and how fast it turns. Both follow from its thrust, as for any propeller at rest.

    Attributes:
        power: W per N**1.5 of open-water thrust, forward and reverse.
        speed: shaft speed, rad/s per sqrt(N), forward and reverse.
    """

    power: tuple[float, float]
    speed: tuple[float, float]

    def draw(self, thrust: float) -> float:
        """Return the electric power (W) at an open-water thrust (N)."""
        return self.power[thrust < 0.0] * math.pow(abs(thrust), 1.5)

    def turn(self, thrust: float) -> float:
        """Return the shaft speed (rad/s), with the sign of the thrust (N)."""
        return math.copysign(self.speed[thrust < 0.0] * math.sqrt(abs(thrust)), thrust)


ELECTRIC = np.dtype([("wired", "i8"), ("power", "f8", (2,)), ("speed", "f8", (2,))])
"""`Electric` of a thruster, for compiled code. Each row of the bodies' thrusters has one."""


class Touch(NamedTuple):
    """One contact of the hull in the last tick.

    Attributes:
        other: row of the other body; -1 for something that does not move.
        point: the point of contact, m in N.
        impulse: impulse on this body, N s in N.
    """

    other: int
    point: Vec3
    impulse: Vec3


class Wiring:
    """The rows of one vehicle that its own instruments read.

    Attributes:
        hydro, row: arrays of the world, and the row of the body.
        electrics: the thrusters whose power and speed are known, by name.
    """

    def __init__(
        self, hydro: Hydrodynamics, row: int, thrusters: Mapping[str, int], electrics: Mapping[str, Electric]
    ) -> None:
        """Args:
        hydro: arrays of the world.
        row: row of the body.
        thrusters: rows of its thrusters, by name.
        electrics: those of its thrusters whose power and speed are known, by name.
        """
        self.hydro, self.row = hydro, row
        self._thrusters, self.electrics = thrusters, electrics
        self._wired = np.array([thrusters[name] for name in electrics], dtype=np.int64)
        rows = [(1, electric.power, electric.speed) for electric in electrics.values()]
        self._electric_rows: Any = np.array(rows, ELECTRIC)

    def fill(self, electrics: Any) -> None:
        """Write ELECTRIC of the vehicle's thrusters into the array of all thrusters."""
        electrics[self._wired] = self._electric_rows

    def _thrust(self, row: int) -> float:
        """Return the open-water thrust of a row at rest, N: after the lag, before inflow and installation."""
        thruster = self.hydro.thrusters[row]
        lag = self.hydro.lags[int(thruster["lag"])]
        force = float(lag["C"] @ thruster["x"] + lag["D"] * thruster["demand"]) * float(thruster["efficiency"])
        return force / float(thruster["installed"])

    def place_of(self, name: str) -> int:
        """Return the number of a thruster among those of the vehicle, in the order of rows; -1 if its power and speed are not known."""
        first = int(self.hydro.bodies["thruster_first"][self.row])
        return self._thrusters[name] - first if name in self.electrics else -1

    def power(self) -> float:
        """Return the electric power that all thrusters draw, W."""
        return math.fsum(
            electric.draw(self._thrust(self._thrusters[name])) for name, electric in self.electrics.items()
        )

    @property
    def voltage(self) -> float:
        """Supply of the first wired thruster, V; 0 without any."""
        return float(self.hydro.thrusters["voltage"][self._wired[0]]) if len(self._wired) else 0.0

    def touches(self) -> list[Touch]:
        """Return the contacts of the last tick that carry an impulse, the strongest first."""
        contacts, impulses, _ = self.hydro.touched
        found = []
        for k in range(len(impulses)):
            a, b = int(contacts.body_a[k]), int(contacts.body_b[k])
            if self.row not in (a, b):
                continue
            sign = 1.0 if a == self.row else -1.0
            ix, iy, iz = (sign * float(component) for component in impulses[k])
            px, py, pz = contacts.point[k].tolist()
            if ix or iy or iz:
                found.append(Touch(b if a == self.row else a, (px, py, pz), (ix, iy, iz)))
        return sorted(found, key=lambda touch: -math.hypot(*touch.impulse))
