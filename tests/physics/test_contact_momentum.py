"""Contacts that keep what they should: speed in rolling, momentum in hits, and in rocking as much energy as Housner says."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from uwserver_bench.proofs.colliders import Balls, Floor
from uwserver_bench.proofs.contact_forms import DIAGONAL, OFF_DIAGONAL, vehicle

from uwserver.frames import conjugate, matrix, quat_from_rpy, rotate
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.collision.contacts import Contacts
from uwserver.physics.collision.engine import missing_engine
from uwserver.physics.collision.solids import Solids
from uwserver.physics.dynamics.params import BodyParams, rigid_body_inertia
from uwserver.physics.geometry.shapes import Box, Placed, Solid
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q

DT = 1.0 / 240.0
ZERO = np.zeros((6, 6))
ORIGIN = (0.0, 0.0, 0.0)
BOXES = ((0.3, 0.2, 0.15), (0.25, 0.25, 0.2))


def neutral(M_RB: FloatArray, M_A: FloatArray, heavy: float = 0.0) -> BodyParams:
    return BodyParams(M_RB, M_A, ZERO, ZERO, ZERO, 1000.0 + heavy, 1000.0, ORIGIN, ORIGIN)


def box_inertia(mass: float, half: tuple[float, float, float]) -> FloatArray:
    a, b, c = (side * side for side in half)
    return rigid_body_inertia(mass, np.diag([b + c, a + c, a + b]) * mass / 3.0, ORIGIN)


# -- rolling --------------------------------------------------------------------------------------------------------------------------


@dataclass
class Ground:
    """A plane at z = 0 under a ball. `tiles`: length of its pieces along x, each of which is another contact; 0 for one piece."""

    radius: float
    tiles: float = 0.0

    def find_contacts(self, state: FloatArray, dt: float) -> Contacts:
        x, y, z = state[0, :3]
        gap, zero, one = -z - self.radius, np.zeros(1, np.int64), np.ones(1)
        key = zero + (int(x // self.tiles) if self.tiles else 0)
        point = np.array([[x, y, -0.5 * gap]])
        return Contacts(zero, zero - 1, point, np.array([[0.0, 0.0, -1.0]]), gap * one, key, 0.5 * one, 0.0 * one)


@pytest.mark.parametrize(("tiles", "bar"), [(0.0, 1e-5), (0.1, 1e-3), (0.01, 1e-5)])
def test_a_ball_that_rolls_keeps_its_speed_and_its_height(tiles: float, bar: float) -> None:
    """3 m/s for 20 s without resistance; also over tiles of several ticks and of less than one."""
    radius, mass, speed = 0.2, 40.0, 3.0
    M_RB = rigid_body_inertia(mass, 0.4 * mass * radius**2 * np.eye(3), ORIGIN)
    hydro = Hydrodynamics([neutral(M_RB, np.diag([0.4 * mass] * 3 + [0.0] * 3), heavy=40.0)], DT)
    hydro.state[0, 2], hydro.state[0, NU], hydro.state[0, NU + 4] = -radius, speed, -speed / radius
    hydro.collider = Ground(radius, tiles)
    deepest = 0.0
    for k in range(20 * 240):
        assert hydro.advance(k * DT) < 0
        deepest = max(deepest, abs(hydro.state[0, 2] + radius))
    v = np.array(matrix(hydro.state[0, Q : Q + 4])) @ hydro.state[0, NU : NU + 3]
    np.testing.assert_allclose(v, [speed, 0.0, 0.0], rtol=0.0, atol=bar * speed)
    assert deepest < 1e-5


# -- momentum -------------------------------------------------------------------------------------------------------------------------


def momentum(hydro: Hydrodynamics) -> FloatArray:
    """(6) of all bodies and their water: linear, and angular about a fixed point near them, in N."""
    found = np.zeros(6)
    for body, x in zip(hydro.params, hydro.state, strict=True):
        R, h = np.array(matrix(x[Q : Q + 4])), (body.M_RB + body.M_A) @ x[NU:]
        found[:3] += R @ h[:3]
        found[3:] += R @ h[3:] + np.cross(x[:3] - [0.0, 0.0, 20.0], R @ h[:3])
    return found


def two_boxes(seed: int, M_A: FloatArray, spin: float) -> Hydrodynamics:
    """At random attitudes in open water; the first flies at the second."""
    rng = np.random.default_rng(seed)
    hydro = Hydrodynamics(
        [neutral(box_inertia(m, half), m / 20.0 * M_A) for m, half in zip((30.0, 40.0), BOXES, strict=True)], DT
    )
    for row, (p, v) in enumerate((((-0.9, 0.05, 20.0), (1.5, 0.05, 0.0)), ((0.0, 0.0, 20.05), (0.0, 0.0, 0.1)))):
        q = quat_from_rpy(*rng.uniform(-3.0, 3.0, 3))
        hydro.state[row] = [*p, *q, *rotate(conjugate(q), v), *spin * rng.normal(size=3)]
    return hydro


@pytest.mark.skipif(missing_engine() is not None, reason="no engine for contacts is installed")
@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("M_A", [ZERO, DIAGONAL, OFF_DIAGONAL], ids=["dry", "diagonal", "off-diagonal"])
def test_boxes_that_hit_each_other_keep_their_momentum(M_A: FloatArray, friction: float, e: float) -> None:
    """The Kelvin impulse, of bodies and water, through hits and all that follows: sliding, rolling on each other, being in each other."""
    for seed in range(2):
        hydro = two_boxes(seed, M_A, spin=1.0)
        before, hit = momentum(hydro), 0
        with Solids() as solids:
            for row, half in enumerate(BOXES):
                solids.add_moving(Solid(f"box {row}", (Placed(Box(half)),), friction=friction, restitution=e), row)
            hydro.collider = solids
            for k in range(240):
                assert hydro.advance(k * DT) < 0
                hit += bool(hydro.touched.impulse.any())
        assert hit > 0
        np.testing.assert_allclose(momentum(hydro), before, rtol=0.0, atol=1e-6 * float(np.linalg.norm(before[:3])))


def test_bodies_that_are_taken_out_of_each_other_keep_their_momentum() -> None:
    """2 cm deep, spinning and sliding on each other."""
    hydro = Hydrodynamics([vehicle(OFF_DIAGONAL), vehicle(2.0 * DIAGONAL, mass=20.0)], DT)
    hydro.state[0, :3], hydro.state[1, :3] = (-0.48, 0.0, 20.0), (0.0, 0.0, 20.0)
    hydro.state[0, NU:], hydro.state[1, NU:] = (0.1, 0.4, -0.2, 0.3, 0.2, -0.4), (0.0, -0.3, 0.1, 0.2, 0.5, 0.1)
    hydro.collider = Balls({0: (ORIGIN, 0.2), 1: (ORIGIN, 0.3)}, friction=0.4)
    before = momentum(hydro)
    apart = np.linalg.norm(hydro.state[0, :3] - hydro.state[1, :3])
    for k in range(20):
        assert hydro.advance(k * DT) < 0
    assert np.linalg.norm(hydro.state[0, :3] - hydro.state[1, :3]) > apart + 0.015
    np.testing.assert_allclose(momentum(hydro), before, rtol=0.0, atol=1e-6 * float(np.linalg.norm(before[:3])))


# -- rocking --------------------------------------------------------------------------------------------------------------------------

HALF = (0.1, 0.25, 0.4)
CORNERS = tuple((x, y, HALF[2]) for x in (HALF[0], -HALF[0]) for y in (HALF[1], -HALF[1]))


def housner(M: FloatArray, weight: float, tilt: float) -> float:
    """Tilt (rad) that a block reaches on its other edge when it is let go at a tilt on one: Housner 1963, with the 6x6 inertia M.

    From one edge to the other the momentum about the latter stays, which leaves the share (t2 M t1)^2 / (t1 M t1 t2 M t2) of the energy,
    with t1 and t2 the velocity at 1 rad/s about each.
    """
    half, height = HALF[0], HALF[2]
    first, second = (np.array([-height, 0.0, x, 0.0, 1.0, 0.0]) for x in (half, -half))
    share = (second @ M @ first) ** 2 / ((first @ M @ first) * (second @ M @ second))
    reach, corner = math.hypot(half, height), math.atan2(half, height)
    energy = weight * reach * (math.cos(corner - tilt) - math.cos(corner))
    return corner - math.acos(share * energy / (weight * reach) + math.cos(corner))


@pytest.mark.parametrize("M_A", [ZERO, np.diag([25.0, 20.0, 5.0, 0.3, 0.8, 0.2])], ids=["dry", "with added mass"])
@pytest.mark.parametrize("degrees", [4.0, 7.0, 9.5, 10.5])
def test_a_block_rocks_as_far_as_housner_says(degrees: float, M_A: FloatArray) -> None:
    """Whenever within a tick it hits."""
    mass, weight, tilt = 80.0, 400.0, math.radians(degrees)
    body = neutral(box_inertia(mass, HALF), M_A, heavy=weight)
    hydro = Hydrodynamics([body], DT)
    q = quat_from_rpy(0.0, -tilt, 0.0)
    hydro.state[0, :3], hydro.state[0, Q : Q + 4] = -np.array(rotate(q, CORNERS[0])) * [1.0, 0.0, 1.0], q
    hydro.collider = Floor({0: CORNERS}, friction=1.5)
    tilts = []
    while len(tilts) < 2 or tilts[-1] < 0.0 or tilts[-1] >= tilts[-2]:
        assert hydro.advance(len(tilts) * DT) < 0
        tilts.append(2.0 * math.atan2(hydro.state[0, Q + 2], hydro.state[0, Q]))
        assert len(tilts) < 1000
    assert max(tilts) == pytest.approx(housner(body.M_RB + M_A, weight, tilt), rel=5e-3)
