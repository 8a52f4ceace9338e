"""Contact sensor: what the hull touches, where, and how hard."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from uwserver.modifiers.columns import NO_INT
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import Elsewhere, compiled
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
    TableSensor,
    conjugate,
    loop,
    p_NB,
    q_NB,
    record,
    rotate,
)
from uwserver.table import NonNegative

MOST_POINTS = 16
touched: Any = Elsewhere("uwserver.sensors.instant", "touched")


class ContactConfig(SensorTable, tag="contact", kw_only=True, frozen=True):
    """A sensor of the contacts of the present tick. If its rate is below that of the physics, it can miss a short blow.

    Attributes:
        points: number of contacts that it reports, the strongest first.
        threshold_Ns: smallest impulse that it detects.
    """

    message = "Contact"
    points: Annotated[int, Meta(ge=1, le=MOST_POINTS)] = 4
    threshold_Ns: NonNegative = 0.0

    def build(self, mount: Pose) -> Contact:
        """Return the sensor; its mount does not matter."""
        return Contact(self)


_RECORD = record(
    [
        ("points", "i8"), ("threshold", "f8"),
        # Work space of a reading: number of reported contacts, their numbers, and the squares of their impulses (N2 s2).
        ("reported", "i8"), ("contact", "i8", (MOST_POINTS,)), ("strength", "f8", (MOST_POINTS,)),
    ]
)  # fmt: skip
TOUCHING, COUNT, IMPULSE, BODY, POINTS = 0, 1, 2, 5, 6
"""Where each field begins in a reading. The impulses follow the points."""


@compiled
def _insert(row: Any, contact: int, strength: float) -> None:
    """Insert a contact into the reported ones, if it is among the strongest. Among equal ones the earlier comes first."""
    k = row.reported
    if k == row.points:
        k -= 1
        if strength <= row.strength[k]:
            return
    else:
        row.reported += 1
    while k > 0 and row.strength[k - 1] < strength:
        row.contact[k], row.strength[k] = row.contact[k - 1], row.strength[k - 1]
        k -= 1
    row.contact[k], row.strength[k] = contact, strength


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the contacts; always valid. Values are missing if there are fewer contacts than points."""
    body_a, body_b, point, impulse, contacts = touched(surroundings)
    count, x, y, z, row.reported = 0, 0.0, 0.0, 0.0, 0
    for k in range(contacts):
        mine = 1.0 if body_a[k] == head.body else -1.0 if body_b[k] == head.body else 0.0
        strength = impulse[k, 0] ** 2 + impulse[k, 1] ** 2 + impulse[k, 2] ** 2
        if mine == 0.0 or strength <= row.threshold**2:
            continue
        count += 1
        x, y, z = x + mine * impulse[k, 0], y + mine * impulse[k, 1], z + mine * impulse[k, 2]
        _insert(row, k, strength)
    to_B, p = conjugate(q_NB(head, surroundings)), p_NB(head, surroundings)
    whole = out.view(np.int64)
    out[:] = MISSING
    out[TOUCHING], whole[COUNT], whole[BODY] = 1.0 if count > 0 else 0.0, count, NO_INT
    x, y, z = rotate(to_B, (x, y, z))
    out[IMPULSE], out[IMPULSE + 1], out[IMPULSE + 2] = x + 0.0, y + 0.0, z + 0.0  # + 0.0 turns -0.0 into 0.0
    for n in range(row.reported):
        k, i, j = row.contact[n], POINTS + 3 * n, POINTS + 3 * (row.points + n)
        is_a = body_a[k] == head.body
        if n == 0:
            whole[BODY] = body_b[k] if is_a else body_a[k]
        out[i], out[i + 1], out[i + 2] = rotate(to_B, (point[k, 0] - p[0], point[k, 1] - p[1], point[k, 2] - p[2]))
        mine = 1.0 if is_a else -1.0
        out[j], out[j + 1], out[j + 2] = rotate(
            to_B, (mine * impulse[k, 0], mine * impulse[k, 1], mine * impulse[k, 2])
        )


class Contact(TableSensor[ContactConfig]):
    """Contacts of the whole hull."""

    doc = "Contacts of the hull with bodies and things in the last tick: bumper, landing, collision."
    kernel = SensorKernel(_RECORD, loop(measure))
    exact = True

    def __init__(self, config: ContactConfig) -> None:
        n = config.points
        self.fields = (
            Field("touching", "1", "whether anything is touched", type="bool"),
            Field("count", "1", "number of contacts", type="int"),
            Field("impulse_B", "N s", "impulse on this vehicle, summed over all contacts", "B", (3,)),
            Field(
                "body",
                "1",
                "row of the body with the strongest contact; -1 for something that does not move",
                type="int",
            ),
            Field("points_B", "m", "contact points, the strongest first; x y z of each", "B", (n, 3)),
            Field("impulses_B", "N s", "impulse on this vehicle at each point", "B", (n, 3)),
        )
        super().__init__(Pose(), config)

    def fill(self, row: Any) -> None:
        row["points"], row["threshold"] = self._config.points, self._config.threshold_Ns
