"""A read-only view of one vehicle's state."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uwserver.frames import Quat, Vec3, rpy_from_quat
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.layout import NU, P, Q


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose: p_NB (m) and q_NB (w x y z)."""

    p_NB: Vec3
    q_NB: Quat

    @property
    def rpy(self) -> Vec3:
        """Roll, pitch, yaw, rad."""
        return rpy_from_quat(self.q_NB)


@dataclass(frozen=True, slots=True, repr=False)
class Vehicle:
    """Live view of one body. Each property is read from the arrays of the world at the time of the call.

    Attributes:
        name: in the scenario.
        model: name in the vehicle file.
        row: in the arrays.
        hydro: the arrays.
    """

    name: str
    model: str
    row: int
    hydro: Hydrodynamics

    @property
    def pose(self) -> Pose:
        """p_NB (m), q_NB."""
        return Pose(self.p_NB, self.q_NB)

    @property
    def p_NB(self) -> Vec3:
        """Position of the body origin in N, m."""
        x, y, z = self.hydro.state[self.row, P : P + 3].tolist()
        return (x, y, z)

    @property
    def q_NB(self) -> Quat:
        """Attitude, w x y z."""
        w, x, y, z = self.hydro.state[self.row, Q : Q + 4].tolist()
        return (w, x, y, z)

    @property
    def nu(self) -> tuple[float, ...]:
        """v_NB_B (m/s) and w_NB_B (rad/s), six components in B."""
        return tuple(self.hydro.state[self.row, NU : NU + 6].tolist())

    @property
    def is_held(self) -> bool:
        """Whether it stays where it starts, until something on board acts (`start = "held"`)."""
        return self.hydro.is_held(self.row)

    @property
    def wrench(self) -> tuple[float, ...]:
        """Force (N) and moment (N m) of all actuators about the body origin in B, from the present lag states.

        A prescribed wrench that varies with time is taken at t = 0 of its sine; with a sea, at the present time. A commanded wrench is
        exact.
        """
        sea = self.hydro.sea
        _, tau = self.hydro.rates_of_change(0.0 if sea is None else float(sea.uniform[6]))
        return tuple(tau[self.row].tolist())

    def __repr__(self) -> str:
        north, east, down = self.p_NB
        roll, pitch, yaw = self.pose.rpy
        place = f"p_NB = ({north:.3f}, {east:.3f}, {down:.3f}) m, roll, pitch, yaw = ({roll:.3f}, {pitch:.3f}, {yaw:.3f}) rad"
        speed = "held until the first command" if self.is_held else f"speed {math.hypot(*self.nu[:3]):.3f} m/s"
        return f"<{self.name} ({self.model}): {place}, {speed}>"
