"""The right-hand side against the equations in matrix form, written out anew; `tests/physics/test_terms.py` has each term for itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uwserver.frames import matrix, quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.fossen import derivative
from uwserver.physics.dynamics.params import BodyParams, rigid_body_inertia
from uwserver.physics.dynamics.scratch import ACTUATED, APPLIED, EXTERNAL, K1, NU_R, PASSIVE, STATE
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import Model

CURRENT = np.array([0.4, -0.3, 0.1])


def full(seed: int = 7) -> BodyParams:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    D = [rng.normal(size=(6, 6)) for _ in range(3)]
    M_RB = rigid_body_inertia(12.0, np.diag([0.4, 0.5, 0.6]), (0.05, -0.03, 0.08))
    return BodyParams(M_RB, root @ root.T + np.eye(6), *D, 117.0, 119.0, (0.05, -0.03, 0.08), (0.04, -0.02, -0.1))


def diagonal() -> BodyParams:
    D = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    return BodyParams(D + 1.0, D, D, 2.0 * D, 0.0 * D, 117.0, 119.0, (0.0, 0.0, 0.08), (0.0,) * 3)


def cross(a: FloatArray) -> FloatArray:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def coriolis(M: FloatArray, nu: FloatArray) -> FloatArray:
    """Fossen 2011, eq. 3.46: C = [0, -S(p_1); -S(p_1), -S(p_2)]."""
    p, C = M @ nu, np.zeros((6, 6))
    C[:3, 3:] = C[3:, :3] = -cross(p[:3])
    C[3:, 3:] = -cross(p[3:])
    return C


def expected(body: BodyParams, x: FloatArray, tau: FloatArray) -> FloatArray:
    """The derivative of a state (13) in the uniform current, fully submerged."""
    R, nu = np.array(matrix(x[3:7])), x[7:]
    nu_c = np.concatenate([R.T @ CURRENT, np.zeros(3)])
    nu_r, nu_c_dot = nu - nu_c, np.concatenate([-np.cross(nu[3:], nu_c[:3]), np.zeros(3)])
    D = body.D_L + body.D_Q * np.abs(nu_r) + body.D_S * abs(nu_r[0])
    down = R.T @ [0.0, 0.0, 1.0]
    weight, buoyancy = body.weight * down, -body.buoyancy * down
    restoring = np.concatenate([weight + buoyancy, np.cross(body.r_g, weight) + np.cross(body.r_b, buoyancy)])
    right = (
        tau
        + restoring
        - coriolis(body.M_RB, nu) @ nu
        - coriolis(body.M_A, nu_r) @ nu_r
        - D @ nu_r
        + body.M_A @ nu_c_dot
    )
    w, a, b, c = x[3:7]
    T = 0.5 * np.array([[-a, -b, -c], [w, -c, b], [c, w, -a], [-b, a, w]])
    return np.concatenate([R @ nu[:3], T @ nu[3:], np.linalg.solve(body.M_RB + body.M_A, right)])


def states(n: int) -> FloatArray:
    rows = np.random.default_rng(17).normal(size=(n, 13))
    rows[:, 2] = 50.0
    rows[:, 3:7] = [quat_from_rpy(*angles) for angles in np.random.default_rng(18).uniform(-1.5, 1.5, (n, 3))]
    return rows


def found(hydro: Hydrodynamics, x: FloatArray, *given: tuple[int, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Derivative and work rows, with some rows of the work given."""
    scratch = hydro.scratch
    scratch["work"] = 0.0
    scratch["s"][0, STATE] = x
    scratch["M_inv"][0] = hydro.bodies["M_inv"][0]
    for row, values in given:
        scratch["work"][0, row] = values
    model = Model(*(getattr(hydro, name) for name in Model._fields))
    derivative(model, hydro.bodies[0], hydro.flows[0], 0.0, 1.0, STATE, K1, 0, scratch[0])
    return scratch["s"][0, K1].copy(), scratch["work"][0].copy()


@pytest.mark.parametrize("body", [full(), full(8), diagonal()], ids=["full", "another", "diagonal"])
@pytest.mark.parametrize("x", states(4), ids=range(4))
def test_the_derivative_is_that_of_the_matrix_form(body: BodyParams, x: FloatArray) -> None:
    hydro = Hydrodynamics([body], 0.01)
    hydro.currents[0] = CURRENT
    wrench = np.array([3.0, -2.0, 1.0, 0.4, 0.5, -0.6])
    hydro.wrenches["bias"] = wrench
    rates, work = found(hydro, x)
    np.testing.assert_allclose(rates, expected(body, x, wrench), rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(work[APPLIED], wrench)
    R = np.array(matrix(x[3:7]))
    np.testing.assert_allclose(work[NU_R], x[7:] - np.concatenate([R.T @ CURRENT, np.zeros(3)]), rtol=0.0, atol=1e-14)


def test_what_appendages_and_others_give_is_added() -> None:
    """Of the applied wrench are those with a servo and the external one; what the hull itself does is not."""
    body, x = full(), states(1)[0]
    hydro = Hydrodynamics([body], 0.01)
    hydro.currents[0] = CURRENT
    given = np.random.default_rng(19).normal(size=(3, 6))
    rates, work = found(hydro, x, (ACTUATED, given[0]), (PASSIVE, given[1]), (EXTERNAL, given[2]))
    np.testing.assert_allclose(rates, expected(body, x, given.sum(axis=0)), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(work[APPLIED], given[0] + given[2], rtol=0.0, atol=1e-15)


def test_a_contact_acts_in_n_and_is_not_of_the_applied_wrench() -> None:
    """Its moment is about N's origin, and goes on with time: a force at a point that moves. `found` asks at t = 0."""
    body, x = full(), states(1)[0]
    hydro = Hydrodynamics([body], 0.01)
    hydro.currents[0] = CURRENT
    force, point, speed, since = (
        np.array([1.0, 2.0, 3.0]),
        x[:3] + np.array([0.4, 0.5, 0.6]),
        np.array([0.3, -2.0, 1.0]),
        -0.2,
    )
    moment, rate = np.cross(point + since * speed, force), np.cross(speed, force)
    hydro.bodies["in_contact"], hydro.bodies["contact"] = 1, [*force, *moment, *rate, since]
    R = np.array(matrix(x[3:7]))
    wrench = np.concatenate([R.T @ force, R.T @ np.cross(point - x[:3], force)])
    rates, work = found(hydro, x)
    np.testing.assert_allclose(rates, expected(body, x, wrench), rtol=1e-10, atol=1e-10)
    assert not work[APPLIED].any()
    hydro.bodies["in_contact"] = 0
    np.testing.assert_allclose(found(hydro, x)[0], expected(body, x, np.zeros(6)), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("frame", [0, 1])
def test_a_prescribed_wrench_is_harmonic_in_its_frame(frame: int) -> None:
    body, x = full(), states(1)[0]
    hydro = Hydrodynamics([replace(body, wrenches=2)], 0.01)
    hydro.currents[0] = CURRENT
    rng = np.random.default_rng(20)
    bias, amplitude, omega, phase = rng.normal(size=(4, 6))
    row = hydro.wrenches[1]
    row["frame"], row["bias"], row["amplitude"], row["omega"], row["phase"], row["harmonic"] = (
        frame,
        bias,
        amplitude,
        omega,
        phase,
        1,
    )
    wrench = bias + amplitude * np.sin(phase)
    R = np.array(matrix(x[3:7]))
    if frame == 1:
        wrench = np.concatenate([R.T @ wrench[:3], R.T @ wrench[3:]])
    np.testing.assert_allclose(found(hydro, x)[0], expected(body, x, wrench), rtol=1e-10, atol=1e-10)


def test_the_form_of_a_matrix_changes_nothing() -> None:
    """A diagonal matrix that is called full gives the same."""
    x = states(1)[0]
    named, general = (Hydrodynamics([diagonal()], 0.01) for _ in range(2))
    for name in ("M_RB", "M_A", "D_L", "D_Q", "D_S"):
        general.bodies[f"form_{name}"] = 2
    np.testing.assert_allclose(found(named, x)[0], found(general, x)[0], rtol=1e-13, atol=1e-13)


def test_the_norm_of_the_quaternion_does_not_count() -> None:
    body, x = full(), states(1)[0]
    hydro = Hydrodynamics([body], 0.01)
    longer = x.copy()
    longer[3:7] *= 1.01
    np.testing.assert_allclose(found(hydro, longer)[0][7:], found(hydro, x)[0][7:], rtol=1e-12, atol=1e-12)
