"""The numbers of a vehicle: mass, size, added mass, damping, righting arm and thrust, each with the status that it has in the vehicle's file.

The size comes from points on the surface of the vehicle's shapes, of which its picture is made too.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec
import numpy as np
from msgspec import UnsetType

from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import Box, Capsule, ConvexHull, Cylinder, Shape, Solid, Sphere
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.load.resolved import ResolvedVehicle
from uwserver.scenario.vehicle.appendage_tables import Sourced
from uwserver.scenario.vehicle.body import matrices
from uwserver.validation.manoeuvres.helm import Helm, Sticks, bollard
from uwserver.validation.manoeuvres.runs import floats

_AROUND, _ALONG = 36, 13
THRUSTS = {
    "ahead": ("surge", 1.0, 0),
    "astern": ("surge", -1.0, 0),
    "to starboard": ("sway", 1.0, 1),
    "down": ("heave", 1.0, 2),
    "up": ("heave", -1.0, 2),
    "turning": ("yaw", 1.0, 5),
}
"""A stick of `Sticks`, its full command, and the axis of the resulting wrench."""


def outline(solid: Solid) -> list[FloatArray]:
    """Return points (n, 3) for each shape, in the frame of the solid, m. Their convex hull is nearly the shape's."""
    return [np.array(part.p) + _points(part.shape) @ part.R.T for part in solid.shapes]


def _points(shape: Shape) -> FloatArray:
    if isinstance(shape, Box):
        return np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * shape.half
    if isinstance(shape, Sphere):
        return _ball(shape.radius)
    if isinstance(shape, Cylinder | Capsule):
        end = _ring(shape.radius, 0.0) if isinstance(shape, Cylinder) else _ball(shape.radius)
        return np.concatenate([end + np.array([x, 0.0, 0.0]) for x in (-shape.half_length, shape.half_length)])
    if isinstance(shape, ConvexHull):
        return shape.points
    raise TypeError(f"a vehicle has no {type(shape).__name__}")


def _ring(radius: float, x: float) -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
    return np.stack([np.full_like(angle, x), radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _ball(radius: float) -> FloatArray:
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ALONG)
    return np.concatenate([_ring(radius * float(np.cos(a)), radius * float(np.sin(a))) for a in latitude])


@dataclass(frozen=True)
class Particular:
    """A number, or the six numbers of a diagonal (surge, sway, heave, roll, pitch, yaw), with the statuses of the tables that they come from."""

    name: str
    unit: str
    values: tuple[float, ...]
    status: str


def particulars(resolved: ResolvedVehicle, body: BodyParams, helm: Helm) -> list[Particular]:
    """Return all numbers of a checked vehicle. `body` has its parameters in the water of the report."""
    file = resolved.vehicle
    rigid = file.rigid_body
    found = [
        Particular("mass", "kg", (rigid.mass_kg,), rigid.status),
        Particular("weight in the water", "N", (body.weight - body.buoyancy,), _statuses(rigid, file.buoyancy)),
    ]
    if resolved.solid is not None:
        size = np.ptp(np.concatenate(outline(resolved.solid)), axis=0)
        found.append(Particular("length, width, height of its collision shapes", "m", tuple(size.tolist()), ""))
    if not floats(body):
        arm = (body.weight * body.r_g[2] - body.buoyancy * body.r_b[2]) / max(body.weight, 1e-9)
        found.append(Particular("righting arm", "m", (arm,), _statuses(rigid, file.buoyancy)))
    found.append(
        Particular("moments of inertia about the origin", "kg m2", tuple(np.diag(body.M_RB)[3:].tolist()), rigid.status)
    )
    found.append(Particular("added mass, diagonal", "kg, kg m2", _diagonal(body.M_A), file.added_mass.status))
    M, damping = matrices(file), file.damping
    for name, matrix, tables in (
        ("linear damping, diagonal", M.D_L, (damping.linear, damping.at_rest)),
        ("quadratic damping, diagonal", M.D_Q, (damping.quadratic,)),
        ("damping by speed, diagonal", M.D_S, (damping.speed,)),
    ):
        if matrix.any():
            found.append(Particular(name, "SI", _diagonal(matrix), _statuses(*tables)))
    status = _statuses(*(*file.thrusters.values(), *file.propellers.values()) or (file.autopilot,))
    found += [Particular(f"thrust {name}" if axis < 5 else "moment of thrust", "N" if axis < 5 else "N m", (value,), status)
              for name, axis, value in _thrust(helm)]  # fmt: skip
    return found


def guesses(resolved: ResolvedVehicle) -> tuple[int, int]:
    """Return how many groups of numbers of hull, thrusters, fins and their devices are guesses, and how many groups there are."""
    tables = [resolved.vehicle, *{id(device): device for device in resolved.devices.values()}.values()]
    statuses = [sourced.status for table in tables for sourced in _sourced(table)]
    return statuses.count("guess"), len(statuses)


def _sourced(value: Any) -> Iterator[Sourced]:
    """Yield all tables with a source within a table, except published figures, autopilot and sensors."""
    if isinstance(value, Sourced):
        yield value
    if isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            if name not in ("published", "autopilot", "sensors"):
                yield from _sourced(getattr(value, name))
    elif isinstance(value, dict):
        for part in value.values():
            yield from _sourced(part)


def _statuses(*tables: Sourced | UnsetType) -> str:
    return ", ".join(dict.fromkeys(table.status for table in tables if not isinstance(table, UnsetType)))


def _diagonal(M: FloatArray) -> tuple[float, ...]:
    return tuple(np.diag(M).tolist())


def _thrust(helm: Helm) -> Iterator[tuple[str, int, float]]:
    """Yield name, axis and size (N or N m) of the thrust of each stick, with the vehicle held fast."""
    known = {name: each for name, each in THRUSTS.items() if helm.has(each[0])}
    commands = [partial(helm.tell, sticks=Sticks(**{stick: full})) for stick, full, _ in known.values()]
    wrench = bollard(helm.body, commands)
    for row, (name, (_, _, axis)) in enumerate(known.items()):
        yield name, axis, abs(float(wrench[row, axis]))
