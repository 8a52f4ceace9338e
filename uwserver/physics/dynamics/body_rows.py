"""The rows of one body in the kernel's arrays, made once for all equal bodies, and how they are appended to the rows of a world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from uwserver.physics.dynamics.appendage_params import appendage_rows, servo_rows
from uwserver.physics.dynamics.params import (
    BodyParams,
    ForceTable,
    Lag,
    body_row,
    line_of,
    shape_rows,
    thruster_row,
    wrench_rows,
)
from uwserver.physics.dynamics.strip_params import strip_rows
from uwserver.physics.kernel.arrays import IntArray, Records, joined
from uwserver.physics.kernel.layout import WORLD

_SERVED = ("foils", "propellers", "weights", "derivatives")
"""Arrays whose rows name a servo."""


class BodyRows(NamedTuple):
    """Rows of one body at rest, by the names of the arrays. Numbers of servos count from the body's first one; numbers of tables and lags are not
    set yet."""

    bodies: Records
    shapes: Records
    thrusters: Records
    wrenches: Records
    servos: Records
    foils: Records
    propellers: Records
    weights: Records
    derivatives: Records
    hulls: Records
    strips: Records


_KINDS = {name: "wrench" if name == "wrenches" else name[:-1] for name in BodyRows._fields[1:]}
"""The name that a BODY row uses for its range of each array."""


def rows_of(body: BodyParams, wave_number: float = 0.0) -> BodyRows:
    """Return all rows of a body. Copy them before changing them.

    Args:
        body: its parameters.
        wave_number: the largest of the waves of the sea, rad/m; 0 without waves.
    """
    made = BodyRows(
        bodies=body_row(body),
        shapes=shape_rows(body),
        thrusters=joined([thruster_row(thruster, 0, 0) for thruster in body.thrusters], WORLD["thrusters"]),
        wrenches=wrench_rows(body.wrenches),
        servos=servo_rows(body.appendages),
        **appendage_rows(body.appendages, 0),
        strips=strip_rows(line_of(body), body.r_b, wave_number),
    )
    for name, kind in _KINDS.items():
        made.bodies[f"{kind}_count"] = len(getattr(made, name))
    return made


def appended(present: Mapping[str, Records], bodies: Sequence[BodyRows]) -> dict[str, Records]:
    """Return new arrays of all kinds: the present rows unchanged, followed by those of further bodies.

    Args:
        present: by the names of `BodyRows`; other entries do not matter.
        bodies: in their order.
    """
    rows = {
        name: joined([present[name], *[getattr(each, name) for each in bodies]], WORLD[name])
        for name in BodyRows._fields
    }
    added = rows["bodies"][len(present["bodies"]) :]
    for name, kind in _KINDS.items():
        counts: IntArray = added[f"{kind}_count"]
        added[f"{kind}_first"] = len(present[name]) + np.cumsum(counts) - counts
    for name in _SERVED:
        new = rows[name][len(present[name]) :]
        if len(new):
            first = np.repeat(added["servo_first"], added[f"{_KINDS[name]}_count"])
            new["servo"] += np.where(new["servo"] < 0, 0, first)
    return rows


def table_numbers(bodies: Sequence[BodyParams], tables: dict[ForceTable, int], lags: dict[Lag, int]) -> IntArray:
    """Return (m, 2) the row of the force table and of the lag of each thruster of these bodies. New tables and lags get the next numbers."""
    known: dict[BodyParams, list[tuple[int, int]]] = {}
    for body in bodies:
        if body not in known:
            known[body] = [
                (tables.setdefault(each.table, len(tables)), lags.setdefault(each.lag, len(lags)))
                for each in body.thrusters
            ]
    return np.array([pair for body in bodies for pair in known[body]], dtype=np.int64).reshape(-1, 2)
