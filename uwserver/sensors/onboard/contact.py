"""Contact sensor: what the hull touches, where and how hard."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.frames import Vec3, conjugate, rotate
from uwserver.ports import Field, Value
from uwserver.sensors.base import IdealSensor, Pose, Scope, SensorTable
from uwserver.table import NonNegative


class ContactConfig(SensorTable, tag="contact", kw_only=True, frozen=True):
    """Reports the contacts of the tick at which it measures; at a rate below that of the physics a short blow can fall between two samples.

    Attributes:
        points: how many contacts it reports, the strongest first.
        threshold_Ns: a weaker impulse is not felt.
    """

    points: Annotated[int, Meta(ge=1, le=16)] = 4
    threshold_Ns: NonNegative = 0.0

    def build(self, mount: Pose) -> Contact:
        """The sensor; its mount does not matter."""
        return Contact(self)


class Contact(IdealSensor):
    """Contacts of the whole hull."""

    doc = "Contacts of the hull with bodies and things in the last tick: bumper, landing, collision."

    def __init__(self, config: ContactConfig) -> None:
        n = self._points = config.points
        self._threshold = config.threshold_Ns
        self.fields = (
            Field("touching", "1", "whether anything is touched", type="bool"),
            Field("count", "1", "number of contacts", type="int"),
            Field("impulse_B", "N s", "sum over all contacts, on this vehicle", "B", (3,)),
            Field("body", "1", "row of the body touched hardest; -1 for what does not move", type="int"),
            Field("points_B", "m", "contact points, the strongest first; x y z of each", "B", (n, 3)),
            Field("impulses_B", "N s", "on this vehicle at each point", "B", (n, 3)),
        )

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Always valid; missing values where there are fewer contacts."""
        touches = [] if scope.wiring is None else scope.wiring.touches()
        to_B = conjugate(scope.q_NB)
        found = [(t.other, rotate(to_B, _less(t.point, scope.p_NB)), rotate(to_B, t.impulse)) for t in touches]
        found = [touch for touch in found if sum(part**2 for part in touch[2]) > self._threshold**2]
        total = tuple(sum(entry[2][i] for entry in found) + 0.0 for i in range(3))
        missing = (None,) * (3 * max(0, self._points - len(found)))
        told = found[: self._points]
        points = tuple(x for _, point, _ in told for x in point) + missing
        impulses = tuple(x for _, _, impulse in told for x in impulse) + missing
        return True, [bool(found), len(found), total, found[0][0] if found else None, points, impulses]


def _less(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])
