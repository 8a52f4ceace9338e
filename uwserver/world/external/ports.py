"""What an external body shows: its pose with its age, and how far it is from another one."""

from __future__ import annotations

import math

from uwserver.frames import conjugate, multiply, rpy_from_quat
from uwserver.ports import Field, Value
from uwserver.sensors.base import IdealSensor, Scope, blank
from uwserver.world.external.body import is_nowhere
from uwserver.world.external.source import Source


class ExternalState(IdealSensor):
    """Where an external body is, and how old that is."""

    doc = "Where the body is as its source tells, and how old that is. Not valid while it is nowhere: age and count are still told."
    fields = (
        Field("p_NB", "m", "position of the body origin", "N", (3,)),
        Field("q_NB", "1", "attitude, w x y z", "NB", (4,)),
        Field("v_NB_B", "m/s", "velocity", "B", (3,)),
        Field("w_NB_B", "rad/s", "angular velocity", "B", (3,)),
        Field("age", "s", "since the newest pose of the source; missing before the first"),
        Field("count", "1", "poses of the source until now", type="int"),
    )

    def __init__(self, source: Source) -> None:
        super().__init__()
        self._source = source

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Valid where the body is somewhere."""
        age, count = self._source.age_s(scope.t_ns), self._source.count(scope.t_ns)
        if is_nowhere(scope.p_NB):
            return False, [*blank(self.fields[:4]), age, count]
        return True, [scope.p_NB, scope.q_NB, scope.v_NB_B, scope.w_NB_B, age, count]


class Difference(IdealSensor):
    """How far a body is from another one, at the same instant."""

    doc = "Its pose less that of another body at the same instant. Not valid while one of the two is nowhere."
    fields = (
        Field("difference_p_NB", "m", "its position less the other's", "N", (3,)),
        Field("distance", "m", "length of this"),
        Field("horizontal", "m", "length of its horizontal part"),
        Field("heading", "rad", "its heading less the other's, -pi..pi"),
        Field("angle", "rad", "of the turn from the other's attitude to its own"),
    )

    def __init__(self, other: str) -> None:
        """other: name of the body to compare with; not valid while there is none of this name."""
        super().__init__()
        self._other = other

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Valid where both are somewhere."""
        other = scope.vehicles.get(self._other)
        if other is None or is_nowhere(other.p_NB) or is_nowhere(scope.p_NB):
            return False, blank(self.fields)
        p = (scope.p_NB[0] - other.p_NB[0], scope.p_NB[1] - other.p_NB[1], scope.p_NB[2] - other.p_NB[2])
        heading = rpy_from_quat(scope.q_NB)[2] - rpy_from_quat(other.q_NB)[2]
        heading = math.atan2(math.sin(heading), math.cos(heading))
        w, *xyz = multiply(conjugate(other.q_NB), scope.q_NB)
        return True, [p, math.hypot(*p), math.hypot(p[0], p[1]), heading, 2.0 * math.atan2(math.hypot(*xyz), abs(w))]
