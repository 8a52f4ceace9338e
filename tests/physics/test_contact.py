"""Impulses through the whole 6x6 inertia against closed forms: hits, rest, friction, balance of momentum, and what must not happen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.colliders import Balls, Floor
from uwserver_bench.proofs.contact_forms import DIAGONAL, FEET, HITS, OFF_DIAGONAL, break_away, hit, jacobian, vehicle

from uwserver.frames import conjugate, quat_from_rpy, rotate
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q

DT = 1.0 / 240.0
ZERO = np.zeros((6, 6))


def total(body: BodyParams) -> FloatArray:
    return body.M_RB + body.M_A


def place(hydro: Hydrodynamics, row: int, p: FloatArray, rpy: tuple[float, float, float], nu: FloatArray) -> None:
    hydro.state[row, :3] = p
    hydro.state[row, Q : Q + 4] = quat_from_rpy(*rpy)
    hydro.state[row, NU : NU + 6] = nu


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", HITS)
def test_a_hit_on_the_world(name: str, e: float) -> None:
    nu, expected, impulse, closed_form = hit(name, e)
    np.testing.assert_allclose(nu, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())
    assert impulse == pytest.approx(closed_form, rel=1e-7)


@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize("offset", [0.0, 0.12])
@pytest.mark.parametrize("M_A", [ZERO, DIAGONAL, OFF_DIAGONAL], ids=["dry", "diagonal", "off-diagonal"])
def test_a_hit_between_bodies(M_A: FloatArray, offset: float, e: float) -> None:
    first, second = vehicle(M_A), vehicle(2.0 * M_A, mass=20.0)
    hydro = Hydrodynamics([first, second], 1e-9)
    rpy = ((0.2, -0.3, 0.5), (-0.4, 0.1, 1.0))
    q = [quat_from_rpy(*angles) for angles in rpy]
    apart = np.array([math.sqrt(0.5**2 - offset**2), offset, 0.0])
    nu = [np.array([0.0, 0.0, 0.0, 0.1, 0.2, -0.1]), np.array([0.1, 0.2, -0.3, 0.0, 0.1, 0.3])]
    nu[0][:3] = rotate(conjugate(q[0]), (1.0, 0.0, 0.0))
    place(hydro, 0, -apart, rpy[0], nu[0])
    place(hydro, 1, np.zeros(3), rpy[1], nu[1])
    hydro.collider = Balls({0: ((0.0, 0.0, 0.0), 0.2), 1: ((0.0, 0.0, 0.0), 0.3)}, restitution=e)
    assert hydro.advance(0.0) < 0
    normal = -apart / 0.5
    J = [jacobian(q[0], -0.2 * normal, normal), -jacobian(q[1], 0.3 * normal, normal)]
    response = [np.linalg.solve(total(b), j) for b, j in zip((first, second), J, strict=True)]
    closing = sum(j @ v for j, v in zip(J, nu, strict=True))
    impulse = -(1.0 + e) * closing / sum(j @ r for j, r in zip(J, response, strict=True))
    assert impulse > 0.0
    for row in (0, 1):
        expected = nu[row] + response[row] * impulse
        np.testing.assert_allclose(hydro.state[row, NU:], expected, rtol=0.0, atol=1e-7)


def world_momentum(body: BodyParams, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Linear momentum and angular momentum about N's origin, of body and water, in N."""
    h = total(body) @ x[NU:]
    q = tuple(x[Q : Q + 4])
    linear, angular = np.array(rotate(q, tuple(h[:3]))), np.array(rotate(q, tuple(h[3:])))
    return linear, angular + np.cross(x[:3], linear)


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("e", [0.5, 0.0])
def test_momentum_is_conserved_across_a_hit(e: float, friction: float) -> None:
    """Through whole ticks at 240 Hz, with spinning anisotropic bodies, and while they stay in contact."""
    bodies = [vehicle(DIAGONAL), vehicle(2.0 * DIAGONAL, mass=20.0)]
    hydro = Hydrodynamics(bodies, DT)
    place(hydro, 0, np.array([-0.6, -0.1, 0.0]), (0.2, -0.3, 0.5), np.array([1.0, -0.2, 0.1, 0.3, 0.2, -0.4]))
    place(hydro, 1, np.zeros(3), (-0.4, 0.1, 1.0), np.array([0.0, 0.1, 0.0, 0.0, 0.5, 0.3]))
    balls = Balls(
        {0: ((0.05, 0.0, 0.0), 0.2), 1: ((0.0, 0.02, 0.0), 0.3)}, restitution=e, friction=friction, margin=0.01
    )
    hydro.collider = balls
    before = [world_momentum(b, x) for b, x in zip(bodies, hydro.state, strict=True)]
    hit = False
    for k in range(120):
        assert hydro.advance(k * DT) < 0
        hit = hit or bool(hydro.touched.impulse.any())
    assert hit
    after = [world_momentum(b, x) for b, x in zip(bodies, hydro.state, strict=True)]
    scale = float(np.linalg.norm(before[0][0]))
    for i in (0, 1):
        np.testing.assert_allclose(after[0][i] + after[1][i], before[0][i] + before[1][i], rtol=0.0, atol=1e-7 * scale)


@pytest.mark.parametrize("M_A", [DIAGONAL, OFF_DIAGONAL], ids=["diagonal", "off-diagonal"])
@pytest.mark.parametrize("damping", [0.0, 100.0])
def test_a_heavy_vehicle_rests(M_A: FloatArray, damping: float) -> None:
    """Damping does not count: what rests does not move within the tick either."""
    hydro = Hydrodynamics([vehicle(M_A, heavy=20.0, damping=damping)], DT)
    place(hydro, 0, np.array([0.0, 0.0, -0.1]), (0.0, 0.0, 0.3), np.zeros(6))
    hydro.collider = Floor({0: FEET}, friction=0.5)
    start = hydro.state.copy()
    for k in range(2400):
        assert hydro.advance(k * DT) < 0
        if k > 240:
            load = -hydro.touched.impulse[:, 2].sum() / DT
            assert load == pytest.approx(20.0, rel=1e-3 if damping else 1e-5)
            assert np.abs(hydro.state[0, NU:]).max() < 1e-7  # no jitter
    np.testing.assert_allclose(hydro.state[0], start[0], atol=2e-5)  # no creep
    nu_dot, _ = hydro.rates_of_change(0.0)
    assert np.abs(nu_dot).max() < (5e-3 if damping else 1e-4)  # an accelerometer on it feels gravity alone


def test_a_dropped_vehicle_comes_to_rest_without_gaining_energy() -> None:
    body = vehicle(OFF_DIAGONAL, heavy=20.0)
    hydro = Hydrodynamics([body], DT)
    place(hydro, 0, np.array([0.0, 0.0, -0.5]), (0.3, -0.2, 0.3), np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.5]))
    hydro.collider = Floor({0: (*FEET, (0.0, 0.0, -0.1))}, friction=0.4, restitution=0.3)
    energy = math.inf
    for k in range(4800):
        assert hydro.advance(k * DT) < 0
        x = hydro.state[0]
        now = 0.5 * x[NU:] @ total(body) @ x[NU:] - 20.0 * x[2]
        # A tick in contact is first order: what it may be wrong by is the potential energy of one tick's fall.
        assert now <= energy + 2e-4 + 20.0 * abs(x[NU + 2]) * DT, k
        energy = now
    assert np.abs(hydro.state[0, NU:]).max() < 1e-6


DIRECTIONS = {"diagonal": (DIAGONAL, (45,)), "off-diagonal": (OFF_DIAGONAL, (0, 45, 135, 270))}
"""Degrees in which each M_A is tried in every run of the tests; in the others those that are slow try it."""


@pytest.mark.parametrize(
    ("M_A", "degrees"),
    [
        pytest.param(M_A, degrees, id=f"{name}-{degrees}", marks=() if degrees in often else pytest.mark.slow)
        for name, (M_A, often) in DIRECTIONS.items()
        for degrees in range(0, 360, 45)
    ],
)
def test_coulomb_break_away(M_A: FloatArray, degrees: int) -> None:
    """Loose (1 mm/s) at mu N in every direction: a cone, not a box."""
    assert break_away(M_A, math.radians(degrees)) == pytest.approx(0.5 * 20.0, rel=0.02)


def test_a_sliding_vehicle_stops_where_coulomb_says() -> None:
    """v0^2 / (2 mu g') along the plane, g' from the total inertia along the motion."""
    friction, heavy, v0 = 0.3, 20.0, 0.8
    body = vehicle(DIAGONAL, heavy=heavy)
    hydro = Hydrodynamics([body], 1e-3)
    place(hydro, 0, np.array([0.0, 0.0, -0.1]), (0.0, 0.0, 0.0), np.array([v0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    hydro.collider = Floor({0: tuple((x, y, 0.1) for x, y, _ in FEET)}, friction=friction)
    for k in range(6000):
        assert hydro.advance(k * 1e-3) < 0
    deceleration = friction * heavy / total(body)[0, 0]
    assert hydro.state[0, 0] == pytest.approx(v0**2 / (2.0 * deceleration), rel=5e-3)
    assert np.abs(hydro.state[0, NU:]).max() < 1e-7


def test_penetration_is_recovered_without_a_push() -> None:
    hydro = Hydrodynamics([vehicle(DIAGONAL, heavy=20.0)], DT)
    place(hydro, 0, np.array([0.0, 0.0, -0.08]), (0.0, 0.0, 0.0), np.zeros(6))  # 2 cm deep
    hydro.collider = Floor({0: FEET}, friction=0.5)
    for k in range(240):
        assert hydro.advance(k * DT) < 0
        assert np.abs(hydro.state[0, NU:]).max() < 1e-7
    assert hydro.state[0, 2] == pytest.approx(-0.1, abs=2e-5)


def test_a_contact_without_impulse_changes_no_bit() -> None:
    """Moving away from a floor that is near: the tick is the free RK4 step."""
    free = Hydrodynamics([vehicle(OFF_DIAGONAL, damping=3.0)], DT)
    near = Hydrodynamics([vehicle(OFF_DIAGONAL, damping=3.0)], DT)
    near.collider = Floor({0: FEET}, friction=0.5, margin=10.0)
    for hydro in (free, near):
        place(hydro, 0, np.array([0.0, 0.0, -0.2]), (0.1, 0.2, 0.0), np.array([0.4, 0.1, -0.5, 0.2, 0.1, 0.3]))
    for k in range(100):
        free.advance(k * DT)
        near.advance(k * DT)
        assert len(near.touched.impulse) > 0
        np.testing.assert_array_equal(near.state, free.state)


def test_islands_do_not_disturb_each_other() -> None:
    """A vehicle at rest moves by the same bits whether another one, far away, hits the ground or is not there."""
    alone = Hydrodynamics([vehicle(OFF_DIAGONAL, heavy=20.0)], DT)
    both = Hydrodynamics([vehicle(OFF_DIAGONAL, heavy=20.0), vehicle(DIAGONAL, heavy=50.0)], DT)
    for hydro in (alone, both):
        place(hydro, 0, np.array([0.0, 0.0, -0.15]), (0.1, 0.0, 0.0), np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
        hydro.collider = Floor(dict.fromkeys(range(len(hydro)), FEET), friction=0.5, restitution=0.2)
    place(both, 1, np.array([9.0, 0.0, -0.3]), (0.5, 0.4, 0.0), np.zeros(6))
    for k in range(600):
        alone.advance(k * DT)
        both.advance(k * DT)
        np.testing.assert_array_equal(both.state[0], alone.state[0])


def test_a_vehicle_on_a_crate() -> None:
    """Two bodies stacked: the lower contact carries both weights."""
    crate = replace(vehicle(2.0 * DIAGONAL, heavy=30.0, mass=20.0))
    hydro = Hydrodynamics([crate, vehicle(OFF_DIAGONAL, heavy=20.0)], DT)
    place(hydro, 0, np.array([0.0, 0.0, -0.3]), (0.0, 0.0, 0.0), np.zeros(6))
    place(hydro, 1, np.array([0.0, 0.0, -0.8]), (0.0, 0.0, 0.0), np.zeros(6))
    balls = Balls({0: ((0.0, 0.0, 0.0), 0.3), 1: ((0.0, 0.0, 0.0), 0.2)})
    floor = Floor({0: tuple((x, y, 0.3) for x, y, _ in FEET)}, friction=0.5)

    class Both:
        def find_contacts(self, state: FloatArray, dt: float):  # type: ignore[no-untyped-def]
            parts = [c.find_contacts(state, dt) for c in (floor, balls)]
            return type(parts[0])(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    hydro.collider = Both()
    for k in range(480):
        assert hydro.advance(k * DT) < 0
    impulses = hydro.touched.impulse / DT
    assert -impulses[:4, 2].sum() == pytest.approx(50.0, rel=1e-4)
    assert impulses[4, 2] == pytest.approx(20.0, rel=1e-4)
