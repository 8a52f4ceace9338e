"""The ports of an external body: its pose with its age, and its distance from another body."""

from __future__ import annotations

import math

from uwserver.frames import conjugate, multiply, rpy_from_quat
from uwserver.ports import Field, Value
from uwserver.sensors.base import IdealSensor, Scope, blank
from uwserver.world.external.body import is_nowhere
from uwserver.world.external.pose_source import PoseSource


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
