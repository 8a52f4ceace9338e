"""Every term of the equation against an independent form of it: Fossen's C(nu) matrices and plain formulas."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.motion import record

from uwserver.frames import conjugate, quat_from_rpy, rotate
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q

ZERO = np.zeros((6, 6))
RPY = (0.4, -0.3, 1.2)
NU0 = np.array([0.8, -0.5, 0.3, 0.4, -0.6, 0.7])
CURRENT = (0.3, -0.2, 0.1)


def cross_matrix(a: FloatArray) -> FloatArray:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def coriolis(M: FloatArray, nu: FloatArray) -> FloatArray:
    """C(nu) (6, 6), Fossen 2011 eq. 3.46: built from the momentum, skew-symmetric."""
    p = M @ nu
    C = np.zeros((6, 6))
    C[:3, 3:] = C[3:, :3] = -cross_matrix(p[:3])
    C[3:, 3:] = -cross_matrix(p[3:])
    return C


def expected_nu_dot(body: BodyParams, nu: FloatArray, tau: FloatArray) -> FloatArray:
    q = quat_from_rpy(*RPY)
    v_c = np.array(rotate(conjugate(q), CURRENT))
    nu_r = nu - np.concatenate([v_c, np.zeros(3)])
    nu_c_dot = np.concatenate([-np.cross(nu[3:], v_c), np.zeros(3)])
    down = np.array(rotate(conjugate(q), (0.0, 0.0, 1.0)))
    weight = np.concatenate([body.weight * down, np.cross(body.r_g, body.weight * down)])
    buoyancy = -np.concatenate([body.buoyancy * down, np.cross(body.r_b, body.buoyancy * down)])
    damping = body.D_L @ nu_r + body.D_Q @ (np.abs(nu_r) * nu_r) + abs(nu_r[0]) * body.D_S @ nu_r
    forces = tau + weight + buoyancy - damping - coriolis(body.M_RB, nu) @ nu - coriolis(body.M_A, nu_r) @ nu_r
    return np.linalg.solve(body.M_RB + body.M_A, forces + body.M_A @ nu_c_dot)


TERMS = ("M_A", "D_L", "D_Q", "D_S", "weight", "buoyancy")


def alone(body: BodyParams, term: str) -> BodyParams:
    """The body with one term only (M_RB stays)."""
    blank = {name: 0.0 if name in ("weight", "buoyancy") else ZERO for name in TERMS}
    return replace(body, **{**blank, term: getattr(body, term)})


@pytest.mark.parametrize("term", [*TERMS, "all", "diagonal D_Q"])
@pytest.mark.parametrize("frame", ["B", "N"])
def test_acceleration_is_that_of_the_equation(full_body: BodyParams, term: str, frame: str) -> None:
    body = full_body if term == "all" else alone(full_body, term.split()[-1])
    if term == "diagonal D_Q":
        body = replace(body, D_Q=np.diag(np.diag(body.D_Q)))
    wrench = np.array([3.0, -2.0, 1.0, 0.3, 0.2, -0.1])
    hydro = Hydrodynamics([body], 0.01)
    hydro.state[0, 2] = 30.0
    hydro.state[0, Q : Q + 4] = quat_from_rpy(*RPY)
    hydro.state[0, NU : NU + 6] = NU0
    hydro.currents[0] = CURRENT
    hydro.wrenches["bias"][0] = wrench
    hydro.wrenches["frame"][0] = int(frame == "N")
    q = conjugate(quat_from_rpy(*RPY))
    tau = np.array([*rotate(q, tuple(wrench[:3])), *rotate(q, tuple(wrench[3:]))]) if frame == "N" else wrench
    nu_dot, applied = hydro.rates_of_change(0.0)
    np.testing.assert_allclose(applied[0], tau, rtol=1e-13)
    np.testing.assert_allclose(nu_dot[0], expected_nu_dot(body, NU0, tau), rtol=1e-11, atol=1e-13)


def test_harmonic_wrench_is_evaluated_at_the_given_time(full_body: BodyParams) -> None:
    hydro = Hydrodynamics([full_body], 0.01)
    row = hydro.wrenches[0]
    row["bias"], row["amplitude"] = np.arange(6.0), 2.0 + np.arange(6.0)
    row["omega"], row["phase"], row["harmonic"] = 0.1 * np.arange(6.0), 0.2 * np.arange(6.0), 1
    _, tau = hydro.rates_of_change(3.7)
    k = np.arange(6.0)
    np.testing.assert_allclose(tau[0], k + (2.0 + k) * np.sin(0.37 * k + 0.2 * k), rtol=1e-14)


def test_a_force_in_N_accelerates_an_isotropic_body_along_a_parabola() -> None:
    """The body spins meanwhile; its path does not care."""
    body = BodyParams(10.0 * np.eye(6), 5.0 * np.eye(6), ZERO, ZERO, ZERO, 0.0, 0.0, (0.0,) * 3, (0.0,) * 3)
    hydro = Hydrodynamics([body], 1.0 / 240.0)
    hydro.wrenches["frame"][0] = 1
    hydro.wrenches["bias"][0] = 6.0, -3.0, 0.0, 0.0, 0.0, 1.5
    record(hydro, 4.0)
    np.testing.assert_allclose(hydro.state[0, :3], [0.5 * 0.4 * 16.0, -0.5 * 0.2 * 16.0, 0.0], atol=1e-8)
    assert hydro.state[0, NU + 5] == pytest.approx(0.4, rel=1e-9)


def test_a_circular_turn_in_a_current_drifts_with_the_water() -> None:
    """u = 1 m/s, r = 0.2 rad/s: a circle of 5 m whose centre moves with the current."""
    inertia, drag, u, r = 15.0, 8.0, 1.0, 0.2
    D = np.diag([drag, drag, drag, 2.0, 2.0, 2.0])
    body = BodyParams(10.0 * np.eye(6), 5.0 * np.eye(6), D, ZERO, ZERO, 0.0, 0.0, (0.0,) * 3, (0.0,) * 3)
    current = (0.3, -0.2, 0.0)
    hydro = Hydrodynamics([body], 1.0 / 240.0)
    hydro.currents[0] = current
    hydro.state[0, NU : NU + 6] = u + current[0], current[1], 0.0, 0.0, 0.0, r
    hydro.wrenches["bias"][0] = drag * u, inertia * u * r, 0.0, 0.0, 0.0, 2.0 * r
    times, states = record(hydro, 40.0)
    x = u / r * np.sin(r * times) + current[0] * times
    y = u / r * (1.0 - np.cos(r * times)) + current[1] * times
    assert np.abs(states[:, 0, 0] - x).max() <= 1e-8
    assert np.abs(states[:, 0, 1] - y).max() <= 1e-8


def test_quaternion_stays_of_unit_length(full_body: BodyParams) -> None:
    hydro = Hydrodynamics([full_body], 0.02)
    hydro.state[0, NU + 3 : NU + 6] = 3.0, -2.0, 4.0
    _, states = record(hydro, 5.0)
    assert math.isclose(float(np.linalg.norm(states[-1, 0, Q : Q + 4])), 1.0, rel_tol=1e-15)
