"""The bodies of a world as programs in the same process see them: their states as arrays, and the way to set them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from uwserver.actuators.base import Body
from uwserver.actuators.teleport import Teleport
from uwserver.frames import matrix, quat_from_rpy, rpy_from_quat
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, P, Q
from uwserver.ports import Port, Refused
from uwserver.ports.checks import checked_command, shown, suggestion
from uwserver.world import World as Core
from uwserver.world.parts.vehicle import Vehicle as Row

HOW_TO_SET = "set_state(p_NB=..., q_NB=... or rpy=..., v_NB_B=..., w_NB_B=...)"
_OTHER_WORDS = {
    "position": "p_NB", "pos": "p_NB", "xyz": "p_NB", "location": "p_NB", "orientation": "q_NB", "quaternion": "q_NB", "quat": "q_NB",
    "attitude": "rpy", "euler": "rpy", "yaw": "rpy[2]", "roll": "rpy[0]", "pitch": "rpy[1]", "heading": "rpy[2]", "depth": "p_NB[2]",
    "linear_velocity": "v_NB_B", "twist": "velocity", "angular_velocity": "w_NB_B", "rates": "w_NB_B",
}  # fmt: skip
"""Words of other simulators, and the attribute that has it here."""


class Pose(NamedTuple):
    """Where a body is: ``p_NB, q_NB = vehicle.pose``.

    Attributes:
        p_NB: (3,) position of the body origin in N (north, east, down), m.
        q_NB: (4,) attitude, a unit quaternion w x y z that turns vectors of B into N.
    """

    p_NB: FloatArray
    q_NB: FloatArray

    @property
    def rpy(self) -> FloatArray:
        """(3,) roll, pitch and yaw, rad (z-y-x angles)."""
        return np.array(rpy_from_quat(self.q_NB.tolist()))

    @property
    def R_NB(self) -> FloatArray:
        """(3, 3) rotation matrix: ``v_N = R_NB @ v_B``."""
        return np.array(matrix(self.q_NB.tolist()))


class Velocity(NamedTuple):
    """How a body moves: ``v_NB_B, w_NB_B = vehicle.velocity``.

    Attributes:
        v_NB_B: (3,) velocity of the body origin in B (forward, right, down), m/s.
        w_NB_B: (3,) angular velocity in B, rad/s.
    """

    v_NB_B: FloatArray
    w_NB_B: FloatArray


class Vehicle:
    """One body of a world, a vehicle or a free object, as ``world.vehicles["rov"]``.

    Each attribute is read from the world when it is asked for, as an array that belongs to the caller. None can be assigned: `set_state`
    sets the state.
    """

    __slots__ = ("_core", "_name")
    _core: Callable[[], Core]
    _name: str

    def __init__(self, core: Callable[[], Core], name: str) -> None:
        """View a body by its name; `core` gives the world as the server steps it."""
        object.__setattr__(self, "_core", core)
        object.__setattr__(self, "_name", name)

    @property
    def name(self) -> str:
        """Name in the scenario, or of ``world/spawn``."""
        return self._name

    @property
    def model(self) -> str:
        """Name in the vehicle file, such as ``bluerov2_heavy``."""
        return self._row.model

    @property
    def pose(self) -> Pose:
        """Position and attitude."""
        return Pose(self.p_NB, self.q_NB)

    @property
    def velocity(self) -> Velocity:
        """Velocity and angular velocity, in B."""
        return Velocity(self.v_NB_B, self.w_NB_B)

    @property
    def p_NB(self) -> FloatArray:
        """(3,) position of the body origin in N (north, east, down), m."""
        return self._state(P, 3)

    @property
    def q_NB(self) -> FloatArray:
        """(4,) attitude, a unit quaternion w x y z that turns vectors of B into N."""
        return self._state(Q, 4)

    @property
    def rpy(self) -> FloatArray:
        """(3,) roll, pitch and yaw, rad (z-y-x angles)."""
        return self.pose.rpy

    @property
    def nu(self) -> FloatArray:
        """(6,) v_NB_B (m/s), then w_NB_B (rad/s), as Fossen's nu."""
        return self._state(NU, 6)

    @property
    def v_NB_B(self) -> FloatArray:
        """(3,) velocity of the body origin in B (forward, right, down), m/s."""
        return self._state(NU, 3)

    @property
    def w_NB_B(self) -> FloatArray:
        """(3,) angular velocity in B, rad/s."""
        return self._state(NU + 3, 3)

    @property
    def wrench(self) -> FloatArray:
        """(6,) force (N) and moment (N m) of all actuators about the body origin in B, from the present lag states."""
        return np.array(self._row.wrench)

    @property
    def is_held(self) -> bool:
        """Whether it stays where it starts, until something on board acts (`start = "held"`)."""
        return self._row.is_held

    def set_state(
        self,
        *,
        p_NB: ArrayLike | None = None,
        q_NB: ArrayLike | None = None,
        rpy: ArrayLike | None = None,
        v_NB_B: ArrayLike | None = None,
        w_NB_B: ArrayLike | None = None,
    ) -> None:
        """Put the body somewhere, at once, between two ticks. What is not given stays as it is; thrusters and their lags too.

        Args:
            p_NB: (3,) position of the body origin in N (north, east, down), m.
            q_NB: (4,) attitude, quaternion w x y z; it is normalised.
            rpy: (3,) instead of `q_NB`: roll, pitch and yaw, rad.
            v_NB_B: (3,) velocity of the body origin in B (forward, right, down), m/s.
            w_NB_B: (3,) angular velocity in B, rad/s.

        Raises:
            Refused: nothing is given, or both attitudes are; another shape, not finite, or too large; or the body follows a log or another
                program. Nothing has changed then.
        """
        core, row = self._core(), self._row
        if core.members[self.name].led:
            raise Refused("denied", f'"{self.name}" is moved from outside, by a log or another program', self.name)
        given = {"p_NB": p_NB, "q_NB": q_NB, "v_NB_B": v_NB_B, "w_NB_B": w_NB_B}
        if rpy is not None:
            if q_NB is not None:
                raise Refused("bad_argument", "the attitude is given twice: give q_NB or rpy", "rpy")
            given["q_NB"] = quat_from_rpy(*_angles(rpy))
        whole = {name: value for name, value in given.items() if value is not None}
        if not whole:
            raise Refused("bad_argument", f"nothing is given: {HOW_TO_SET}", self.name)
        teleport = Teleport(Body(core.hydro, row.row, {}, 0))
        port = Port(self.name, "actuator", "teleport", teleport.fields, teleport.doc)
        items = checked_command(port, whole)
        core.requests.changes += 1
        teleport.apply(items)  # type: ignore[arg-type]  # all of its fields are numbers

    @property
    def _row(self) -> Row:
        row = self._core().vehicles.get(self._name)
        if row is None:
            raise Refused("bad_argument", f'"{self._name}" is no longer in the world', self._name)
        return row

    def _state(self, first: int, count: int) -> FloatArray:
        row = self._row
        return row.hydro.state[row.row, first : first + count].copy()

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f'a vehicle\'s "{name}" cannot be assigned: world.vehicles["{self.name}"].{HOW_TO_SET}')

    def __getattr__(self, name: str) -> NoReturn:
        word = _OTHER_WORDS.get(name)
        there = [each for each in dir(type(self)) if not each.startswith("_")]
        hint = f": it is {word} here" if word else suggestion(name, there) + f"; there are: {', '.join(there)}"
        raise AttributeError(f'a vehicle has no "{name}"{hint}')

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Vehicle) and self._name == other._name and self._core() is other._core()

    def __hash__(self) -> int:
        return hash(self._name)

    def __repr__(self) -> str:
        (north, east, down), (roll, pitch, yaw) = self.p_NB, self.rpy
        place = f"p_NB = ({north:.3f}, {east:.3f}, {down:.3f}) m, roll, pitch, yaw = ({roll:.3f}, {pitch:.3f}, {yaw:.3f}) rad"
        speed = "held until the first command" if self.is_held else f"speed {math.hypot(*self.v_NB_B):.3f} m/s"
        return f"<{self.name} ({self.model}): {place}, {speed}>"


def _angles(rpy: ArrayLike) -> tuple[float, float, float]:
    try:
        roll, pitch, yaw = np.asarray(rpy, dtype=float)
        if np.isfinite([roll, pitch, yaw]).all():
            return float(roll), float(pitch), float(yaw)
    except (TypeError, ValueError):
        pass
    text = f'"rpy" must be three finite angles (rad): roll, pitch and yaw, not {shown(repr(rpy))}'
    raise Refused("bad_shape", text, "rpy")


class Vehicles(Mapping[str, Vehicle]):
    """The bodies of a world by name, free objects too; those that are in it at present."""

    def __init__(self, core: Callable[[], Core]) -> None:
        """View the bodies of the world that `core` gives."""
        self._core = core

    def __getitem__(self, name: str) -> Vehicle:
        there = self._core().vehicles
        if name not in there:
            raise KeyError(
                f'no vehicle "{name}"{suggestion(str(name), there)}; there are: {", ".join(there) or "none"}'
            )
        return Vehicle(self._core, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._core().vehicles)

    def __len__(self) -> int:
        return len(self._core().vehicles)

    def __repr__(self) -> str:
        return "\n".join(map(repr, self.values())) or "no vehicle"
