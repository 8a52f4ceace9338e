"""Free objects as bodies in water: mass, added mass and drag in closed form from their shape.

The numbers below but Lamb's were written down without the tables at hand: treat them as guesses until someone compares them. The value for
a cylinder of no length (0) is ours. Re-dependence, rounded edges and the free surface are left out:
- added mass of a sphere: 2/3 pi rho r^3 (Lamb 1932);
- of a box or cylinder along an axis: DNV-RP-C205 (2010) appendix D, table D-2, square plates and prisms, of the same frontal area;
- of a cylinder across its axis: the same table, right circular cylinder; turning: the strips of a body so long (C205 6.4);
- drag coefficients: Hoerner, Fluid-Dynamic Drag (1965), ch. 3: sphere 0.47, cube 1.05, cylinder end-on 0.9 and across 1.0; turning: strips;
- a linear part that equals the quadratic one at 2 cm/s (or as fast at the rim), so that a thing comes to rest: a guess.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import UNSET

from uwserver.frames import Vec3
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, rigid_body_inertia
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import SHAPE_BOX, SHAPE_SPHERE
from uwserver.scenario.solids.tables import BoxObject, CylinderObject, ObjectEntry, SphereObject
from uwserver.scenario.water.tables import Environment

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


def volume(entry: ObjectEntry) -> float:
    """Volume of an object, m3."""
    if isinstance(entry, SphereObject):
        return 4.0 / 3.0 * math.pi * entry.radius_m**3
    if isinstance(entry, CylinderObject):
        return math.pi * entry.radius_m**2 * entry.length_m
    return math.prod(entry.size_m)


def mass(entry: ObjectEntry) -> float:
    """Mass of an object, kg."""
    if entry.mass_kg is not UNSET:
        return float(entry.mass_kg)
    assert entry.density_kgpm3 is not UNSET
    return float(entry.density_kgpm3) * volume(entry)


def object_params(entry: ObjectEntry, environment: Environment) -> BodyParams:
    """Kernel parameters of a checked object in the scenario's water."""
    rho, g, m = environment.density, environment.gravity, mass(entry)
    edges = _edges(entry)
    added, drag = rho * _added_mass(entry), 0.5 * rho * _drag(entry)
    reach = 0.5 * max(edges)
    rest = _REST_SPEED * drag / np.array([1.0, 1.0, 1.0, reach, reach, reach])
    return BodyParams(
        M_RB=rigid_body_inertia(m, m * np.diag(_inertia(entry)), (0.0, 0.0, 0.0)),
        M_A=np.diag(added),
        D_L=np.diag(rest),
        D_Q=np.diag(drag),
        D_S=np.zeros((6, 6)),
        weight=m * g,
        buoyancy=rho * g * volume(entry),
        r_g=(0.0, 0.0, 0.0),
        r_b=(0.0, 0.0, 0.0),
        shapes=(_buoyancy(entry),),
        displaced=rho * volume(entry),
        gravity_growth=environment.growth,
    )


def _edges(entry: ObjectEntry) -> Vec3:
    """Of the box around it."""
    if isinstance(entry, BoxObject):
        return entry.size_m
    across = 2.0 * entry.radius_m
    return (entry.length_m if isinstance(entry, CylinderObject) else across, across, across)


def _inertia(entry: ObjectEntry) -> Vec3:
    """Of a homogeneous body about its centre, over its mass, m2."""
    x, y, z = (edge * edge / 12.0 for edge in _edges(entry))
    if isinstance(entry, SphereObject):
        return (0.4 * entry.radius_m**2,) * 3
    if isinstance(entry, CylinderObject):
        r = entry.radius_m**2
        return (0.5 * r, 0.25 * r + x, 0.25 * r + x)
    return (y + z, z + x, x + y)


def _added_mass(entry: ObjectEntry) -> FloatArray:
    """(6) over the water's density."""
    if isinstance(entry, SphereObject):
        return np.array([2.0 / 3.0 * math.pi * entry.radius_m**3] * 3 + [0.0] * 3)
    x, y, z = _edges(entry)
    if isinstance(entry, CylinderObject):
        across = float(np.interp(x / y, _CYLINDER_LENGTH, _CYLINDER)) * volume(entry)
        along = _prism(x, math.pi * entry.radius_m**2)
        return np.array([along, across, across, 0.0, across * x * x / 12.0, across * x * x / 12.0])
    a = [_prism(x, y * z), _prism(y, z * x), _prism(z, x * y)]
    turning = [(a[1] * z * z + a[2] * y * y), (a[2] * x * x + a[0] * z * z), (a[0] * y * y + a[1] * x * x)]
    return np.array([*a, *(t / 12.0 for t in turning)])


def _prism(length: float, area: float) -> float:
    """Added mass over density of a prism along its `length`, of the square that has the frontal `area`."""
    side = math.sqrt(area)
    return float(np.interp(length / side, _PRISM_LENGTH, _PRISM)) * side**3


def _drag(entry: ObjectEntry) -> FloatArray:
    """(6) drag coefficient times area; turning: of strips, times length^3."""
    if isinstance(entry, SphereObject):
        r = entry.radius_m
        return np.array([_DRAG_SPHERE * math.pi * r * r] * 3 + [_SPIN_DRAG * r**5] * 3)
    x, y, z = _edges(entry)
    if isinstance(entry, CylinderObject):
        r = entry.radius_m
        across = _DRAG_ACROSS * x * 2.0 * r
        # Strips: 2 times the integral of C_D w s^3 from 0 to half the length.
        turning = _DRAG_ACROSS * 2.0 * r * x**4 / 32.0
        return np.array([_DRAG_END * math.pi * r * r, across, across, _SPIN_DRAG * r**4 * x, turning, turning])
    strips = [x * (y**4 + z**4), y * (x**4 + z**4), z * (x**4 + y**4)]
    return _DRAG_BOX * np.array([y * z, z * x, x * y, *(s / 32.0 for s in strips)])


def _buoyancy(entry: ObjectEntry) -> BuoyancyShape:
    if isinstance(entry, SphereObject):
        return BuoyancyShape(SHAPE_SPHERE, (0.0, 0.0, 0.0), (entry.radius_m,) * 3, volume(entry))
    x, y, z = (0.5 * edge for edge in _edges(entry))
    if isinstance(entry, CylinderObject):  # a box of the same length and volume
        y = z = 0.5 * math.sqrt(math.pi) * entry.radius_m
    return BuoyancyShape(SHAPE_BOX, (0.0, 0.0, 0.0), (x, y, z), volume(entry))
