"""A body that follows poses from outside, and its ports: its pose with the age of that pose, and its distance from another body."""

from __future__ import annotations

import math
from functools import cache
from typing import ClassVar

import numpy as np

from uwserver.frames import conjugate, multiply, rpy_from_quat
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.layout import NU, P, Q
from uwserver.ports import NOWHERE_M, Field, Sample, Value
from uwserver.sensors.base import IdealSensor, Scope, blank
from uwserver.world.external.motion import Bytes, Moving
from uwserver.world.external.pose_source import PoseSource
from uwserver.world.parts.part import Stage, Stateless

NOTHING_MOVES: Bytes = np.zeros(0, np.int8)
UNYIELDING_KG = 1e9
"""Mass, and moments of inertia in kg m2, of a body that others cannot push. A hit by a body of one ton at 10 m/s changes its speed by 10
um/s until the end of the tick, when its source is asked again."""
_APART_M = 1e3
"""Distance between bodies that are nowhere."""


class External(Stateless):
    """Moves a body to the pose that its source gives, after each step of the kernel.

    If the pose is not known, the body is nowhere: high above the water, where no ray and no contact finds it (`NOWHERE_M`). The part has no
    state of its own: the pose stands in the arrays of the bodies, and a live source keeps its newest pose (`pose_source.NewestPose`).
    """

    stage: ClassVar[Stage] = Stage.FORCES

    def __init__(
        self, name: str, hydro: Hydrodynamics, row: int, source: PoseSource, ghost: bool, moving: Moving | None = None
    ) -> None:
        """Take over a body that was added with `led_params`.

        Args:
            name: name of the vehicle.
            hydro, row: the arrays, and the row of the body in them.
            source: gives the poses, in simulation time.
            ghost: nothing touches the body, so the kernel need not move it within a tick either.
            moving: gives the outputs of its actuators, for viewers; None if it has none.
        """
        self._path, self._hydro, self._row = f"{name}/external", hydro, row
        self.source, self._ghost, self._moving = source, ghost, moving

    @property
    def path(self) -> str:
        """``<vehicle>/external``."""
        return self._path

    def achieved(self, t_ns: int) -> Bytes:
        """Return the outputs of its actuators at a simulation time, each -127..127, as in `SceneState.achieved`."""
        return NOTHING_MOVES if self._moving is None else self._moving.achieved(t_ns)

    def follow_source(self, t_ns: int) -> None:
        """Move the body to the pose of its source at this time. The velocity is the one with which it hits others in the coming tick."""
        pose, hydro, row = self.source.at(t_ns), self._hydro, self._row
        state = hydro.state[row]
        if pose is None:
            state[:] = 0.0
            state[P + 2] = -(NOWHERE_M + _APART_M * (row + 1))
            state[Q] = 1.0
            hydro.bodies["retired"][row] = 1
            return
        state[P : P + 3], state[Q : Q + 4], state[NU : NU + 6] = pose.p_NB, pose.q_NB, pose.nu
        hydro.bodies["retired"][row] = 1 if self._ghost else 0

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        """Move the body to its pose again after the kernel has moved it, and before sensors read."""
        self.follow_source(t_ns)


@cache
def led_params() -> BodyParams:
    """Return the parameters of a body without water, weight or damping, which others cannot push."""
    nothing = np.zeros((6, 6))
    none = (0.0, 0.0, 0.0)
    return BodyParams(UNYIELDING_KG * np.eye(6), nothing, nothing, nothing, nothing, 0.0, 0.0, none, none, length=0.0)


def is_nowhere(p_NB: tuple[float, ...]) -> bool:
    """Return whether a position (m, N) is that of a body whose pose is not known."""
    return p_NB[2] <= -NOWHERE_M


class ExternalState(IdealSensor):
    """Measures the pose of an external body, and the age of that pose."""

    doc = "Pose of the body as its source gives it, and the age of that pose. Not valid while it is nowhere; age and count are given nevertheless."
    fields = (
        Field("p_NB", "m", "position of the body origin", "N", (3,)),
        Field("q_NB", "1", "attitude, w x y z", "NB", (4,)),
        Field("v_NB_B", "m/s", "velocity", "B", (3,)),
        Field("w_NB_B", "rad/s", "angular velocity", "B", (3,)),
        Field("age", "s", "time since the newest pose of the source; missing before the first"),
        Field("count", "1", "number of poses from the source so far", type="int"),
    )

    def __init__(self, source: PoseSource) -> None:
        super().__init__()
        self._source = source

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Return the pose, its age and the count; valid if the body is somewhere."""
        age, count = self._source.age_s(scope.t_ns), self._source.count(scope.t_ns)
        if is_nowhere(scope.p_NB):
            return False, [*blank(self.fields[:4]), age, count]
        return True, [scope.p_NB, scope.q_NB, scope.v_NB_B, scope.w_NB_B, age, count]


class Difference(IdealSensor):
    """Measures how far a body is from another one at the same instant."""

    doc = "Difference between its pose and that of another body at the same instant. Not valid while one of the two is nowhere."
    fields = (
        Field("difference_p_NB", "m", "its position minus that of the other body", "N", (3,)),
        Field("distance", "m", "length of this difference"),
        Field("horizontal", "m", "length of the horizontal part"),
        Field("heading", "rad", "its heading minus that of the other body, -pi..pi"),
        Field("angle", "rad", "angle of the turn from the other body's attitude to its own"),
    )

    def __init__(self, other: str) -> None:
        """Compare with the body `other`. Samples are invalid while there is no body of this name."""
        super().__init__()
        self._other = other

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Return the difference; valid if both bodies are somewhere."""
        other = scope.vehicles.get(self._other)
        if other is None or is_nowhere(other.p_NB) or is_nowhere(scope.p_NB):
            return False, blank(self.fields)
        p = (scope.p_NB[0] - other.p_NB[0], scope.p_NB[1] - other.p_NB[1], scope.p_NB[2] - other.p_NB[2])
        heading = rpy_from_quat(scope.q_NB)[2] - rpy_from_quat(other.q_NB)[2]
        heading = math.atan2(math.sin(heading), math.cos(heading))
        w, *xyz = multiply(conjugate(other.q_NB), scope.q_NB)
        return True, [p, math.hypot(*p), math.hypot(p[0], p[1]), heading, 2.0 * math.atan2(math.hypot(*xyz), abs(w))]
