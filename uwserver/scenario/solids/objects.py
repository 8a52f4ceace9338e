"""Free objects as bodies in water: mass, added mass and drag in closed form from their shape.

All numbers but Lamb's were written from memory: treat them as guesses until someone compares them with the sources. The value for a cylinder of
zero length is our own. Dependence on the Reynolds number, rounded edges and the free surface are neglected:
- added mass of a sphere: 2/3 pi rho r^3 (Lamb 1932);
- of a box or cylinder along an axis: DNV-RP-C205 (2010) appendix D, table D-2, square plates and prisms, of the same frontal area;
- of a cylinder across its axis: the same table, right circular cylinder; turning: by strips along the length (C205 6.4);
- drag coefficients: Hoerner, Fluid-Dynamic Drag (1965), ch. 3: sphere 0.47, cube 1.05, cylinder end-on 0.9 and across 1.0; turning: strips;
- a linear part that equals the quadratic one at 2 cm/s (for turning: at 2 cm/s of the rim), so that an object comes to rest: a guess.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import UNSET

from uwserver.frames import Vec3
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, rigid_body_inertia
from uwserver.physics.kernel.layout import SHAPE_BOX, SHAPE_SPHERE
from uwserver.scenario.solids.tables import CylinderObject, ObjectEntry, SphereObject
from uwserver.scenario.world.tables import Environment

_PRISM_LENGTH = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 10.0)
_PRISM = (0.455, 0.68, 0.72, 0.72, 0.76, 0.75, 0.78, 0.77, 0.80)
"""Added mass over rho a^3 of a square prism a x a x b along b, against b / a: C_A b/a of table D-2; 0: the square plate, 0.579 pi/4."""
_CYLINDER_LENGTH = (0.0, 1.2, 2.5, 5.0, 9.0, 50.0)
_CYLINDER = (0.0, 0.62, 0.78, 0.90, 0.96, 1.0)
"""Added mass over that of the displaced water, of a cylinder across its axis, against length / diameter."""
_DRAG_SPHERE, _DRAG_BOX, _DRAG_END, _DRAG_ACROSS = 0.47, 1.05, 0.9, 1.0
_SPIN_DRAG = 0.02
"""Torque on a spinning ball over rho w^2 r^5 / 2, at Re 1e5 (Sawatzki, Acta Mechanica 9, 1970)."""
_REST_SPEED = 0.02
"""Speed at which linear and quadratic drag are equal, m/s."""

Six = tuple[float, float, float, float, float, float]


class _Form(NamedTuple):
    """Properties of a homogeneous body that follow from its shape.

    Attributes:
        volume: m3.
        edges: edges of the box around it, m.
        inertia: about its centre, over its mass, m2.
        added: added mass over the density of the water.
        drag: drag coefficient times area; for turning: of strips, times length^3.
        buoyancy: kind and half edges of the shape that displaces water.
    """

    volume: float
    edges: Vec3
    inertia: Vec3
    added: Six
    drag: Six
    buoyancy: tuple[int, Vec3]


def volume(entry: ObjectEntry) -> float:
    """Return the volume of an object, m3."""
    return _form(entry).volume


def mass(entry: ObjectEntry) -> float:
    """Return the mass of an object, kg."""
    if entry.mass_kg is not UNSET:
        return float(entry.mass_kg)
    assert entry.density_kgpm3 is not UNSET
    return float(entry.density_kgpm3) * volume(entry)


def object_params(entry: ObjectEntry, environment: Environment) -> BodyParams:
    """Return the kernel parameters of a checked object in the water of the scenario."""
    rho, g, m, form = environment.density, environment.gravity, mass(entry), _form(entry)
    drag = 0.5 * rho * np.array(form.drag)
    reach = 0.5 * max(form.edges)
    kind, size = form.buoyancy
    return BodyParams(
        M_RB=rigid_body_inertia(m, m * np.diag(form.inertia), (0.0, 0.0, 0.0)),
        M_A=np.diag(rho * np.array(form.added)),
        D_L=np.diag(_REST_SPEED * drag / np.array([1.0, 1.0, 1.0, reach, reach, reach])),
        D_Q=np.diag(drag),
        D_S=np.zeros((6, 6)),
        weight=m * g,
        buoyancy=rho * g * form.volume,
        r_g=(0.0, 0.0, 0.0),
        r_b=(0.0, 0.0, 0.0),
        shapes=(BuoyancyShape(kind, (0.0, 0.0, 0.0), size, form.volume),),
        displaced=rho * form.volume,
        gravity_growth=environment.growth,
    )


def _form(entry: ObjectEntry) -> _Form:
    if isinstance(entry, SphereObject):
        return _sphere(entry.radius_m)
    return _cylinder(entry.radius_m, entry.length_m) if isinstance(entry, CylinderObject) else _box(*entry.size_m)


def _sphere(r: float) -> _Form:
    added, drag, spin = 2.0 / 3.0 * math.pi * r**3, _DRAG_SPHERE * math.pi * r * r, _SPIN_DRAG * r**5
    return _Form(
        volume=4.0 / 3.0 * math.pi * r**3,
        edges=(2.0 * r,) * 3,
        inertia=(0.4 * r**2,) * 3,
        added=(added, added, added, 0.0, 0.0, 0.0),
        drag=(drag, drag, drag, spin, spin, spin),
        buoyancy=(SHAPE_SPHERE, (r,) * 3),
    )


def _cylinder(r: float, length: float) -> _Form:
    volume = math.pi * r**2 * length
    inertia = 0.25 * r**2 + length * length / 12.0
    added = float(np.interp(length / (2.0 * r), _CYLINDER_LENGTH, _CYLINDER)) * volume
    added_turning = added * length * length / 12.0
    drag = _DRAG_ACROSS * length * 2.0 * r
    # By strips: 2 times the integral of C_D w s^3 from 0 to half the length.
    turning = _DRAG_ACROSS * 2.0 * r * length**4 / 32.0
    side = 0.5 * math.sqrt(math.pi) * r  # of a box of the same length and volume
    return _Form(
        volume=volume,
        edges=(length, 2.0 * r, 2.0 * r),
        inertia=(0.5 * r**2, inertia, inertia),
        added=(_prism(length, math.pi * r**2), added, added, 0.0, added_turning, added_turning),
        drag=(_DRAG_END * math.pi * r * r, drag, drag, _SPIN_DRAG * r**4 * length, turning, turning),
        buoyancy=(SHAPE_BOX, (0.5 * length, side, side)),
    )


def _box(x: float, y: float, z: float) -> _Form:
    xx, yy, zz = x * x / 12.0, y * y / 12.0, z * z / 12.0
    a, b, c = _prism(x, y * z), _prism(y, z * x), _prism(z, x * y)
    strips = x * (y**4 + z**4) / 32.0, y * (x**4 + z**4) / 32.0, z * (x**4 + y**4) / 32.0
    turning = (b * z * z + c * y * y) / 12.0, (c * x * x + a * z * z) / 12.0, (a * y * y + b * x * x) / 12.0
    d, e, f, s, t, u = (_DRAG_BOX * each for each in (y * z, z * x, x * y, *strips))
    return _Form(
        volume=x * y * z,
        edges=(x, y, z),
        inertia=(yy + zz, zz + xx, xx + yy),
        added=(a, b, c, *turning),
        drag=(d, e, f, s, t, u),
        buoyancy=(SHAPE_BOX, (0.5 * x, 0.5 * y, 0.5 * z)),
    )


def _prism(length: float, area: float) -> float:
    """Return the added mass over density of a prism along its `length`, taken as a square prism with the same frontal `area`."""
    side = math.sqrt(area)
    return float(np.interp(length / side, _PRISM_LENGTH, _PRISM)) * side**3
