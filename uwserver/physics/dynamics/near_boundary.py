"""How the added mass of a hull changes near a level bottom and near the surface, by the method of images (compiled).

A bottom mirrors the flow, as if the hull moved beside its image: added mass grows. The surface, for motions that are quick against sqrt(g/a), has a
constant potential, so its image has the opposite sign: added mass falls. As M_A then depends on the depth z, Lagrange's equations have two more
terms: -z_dot dM_A/dz nu_r, and the force nu_r^T dM_A/dz nu_r / 2 along z, which draws a moving body to the bottom. With both terms energy is
conserved.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.physics.dynamics.immersion import depth_below, upward
from uwserver.physics.dynamics.scratch import EXTRA, MOMENTUM
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, separate
from uwserver.physics.kernel.layout import NEAR_CYLINDER, NEAR_SPHERE

_IMAGES = 400
_LEAST = 1e-12
_STEP = 1e-4
"""Step of the difference quotient for the derivative, in radii."""


@compiled
def sum_of_images(height: float, sign: float, power: int) -> float:
    """Return the strength of all images of a dipole at a distance `height` (radii, at least 1) from a plane, over its own strength.

    The first image is the one in the plane; each following one is the image of the last in the body. power: 2 for a circle, 3 for a sphere on its
    axis; sign: 1 for a wall, -1 for a surface of constant potential.
    """
    total, strength, offset = 0.0, 1.0, 0.0
    for _ in range(_IMAGES):
        offset = 1.0 / (2.0 * height - offset)
        strength *= sign * offset**power
        total += strength
        if abs(strength) < _LEAST:
            break
    return total


@compiled
def growth(form: int, height: float, sign: float) -> tuple[float, float]:
    """Return what is added to the factors (1) of added mass along a plane and perpendicular to it, at `height` (radii).

    Cylinder along the plane: exact, M = rho pi a^2 (1 + 2 sum of images) in both directions across it, 1 + a^2 / (2 h^2) far away and
    pi^2/3 - 1 at the wall (Yamamoto, Nath and Slotta 1974). Sphere: exact square to the plane, M = 2/3 pi rho a^3 (1 + 3 sum of images),
    1 + 3/8 (a/h)^3 far away; along it the first term, 3/16 (a/h)^3 (Lamb 1932, art. 98-99; Brennen 1982), which is 4 % too small at the wall.
    """
    height = max(height, 1.0)
    if form == NEAR_CYLINDER:
        both = 2.0 * sum_of_images(height, sign, 2)
        return both, both
    return sign * 0.1875 / height**3, 3.0 * sum_of_images(height, sign, 3)


@compiled
def _both(form: int, depth: float, clearance: float) -> tuple[float, float]:
    """Return the factors along surface and bottom and perpendicular to them, at a depth and a height above the bottom in radii."""
    along, square = growth(form, depth, -1.0)
    if clearance < np.inf:
        more_along, more_square = growth(form, clearance, 1.0)
        along += more_along
        square += more_square
    return 1.0 + along, 1.0 + square


@separate
def set_near_mass(body: Any, x: float, y: float, z: float, t: float, flow: Array, w: Any) -> None:
    """Set w.M_A and w.M_A_z of a body whose origin is at (x, y, z) (N, m) at t (s), and whose rotation is w.R.

    The factors apply to axes of B: the hull is assumed to lie level, and a cylinder along x. Depth and height are those of the centre of buoyancy.
    """
    a, b, R = body.near_radius, body.r_b, w.R
    upward(flow, R, w.small[0])
    up = w.small[0]
    depth = (depth_below(flow, x, y, z, t) - up[0] * b[0] - up[1] * b[1] - up[2] * b[2]) / a
    below = R[2, 0] * b[0] + R[2, 1] * b[1] + R[2, 2] * b[2]
    clearance = (body.floor - z - below) / a
    along, square = _both(body.near_form, depth, clearance)
    along_1, square_1 = _both(body.near_form, depth + _STEP, clearance - _STEP)
    along_0, square_0 = _both(body.near_form, depth - _STEP, clearance + _STEP)
    root, slope = w.work[EXTRA], w.work[MOMENTUM]  # work space between two calls of `fossen.derivative`
    for i in range(6):
        if body.near_form == NEAR_SPHERE:
            moved, beside = i < 3, i < 2
        else:
            moved, beside = i % 3 > 0, True
        if not moved:
            root[i], slope[i] = 1.0, 0.0
        elif beside:
            root[i], slope[i] = math.sqrt(along), (along_1 - along_0) / (2.0 * _STEP * a)
        else:
            root[i], slope[i] = math.sqrt(square), (square_1 - square_0) / (2.0 * _STEP * a)
        slope[i] /= 2.0 * root[i]
    for i in range(6):
        for j in range(6):
            w.M_A[i, j] = root[i] * body.M_A[i, j] * root[j]
            w.M_A_z[i, j] = (slope[i] * root[j] + root[i] * slope[j]) * body.M_A[i, j]
