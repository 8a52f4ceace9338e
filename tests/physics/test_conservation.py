"""Energy and momentum without damping, Coriolis forces that do no work, and the Galilean shift by a current."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from uwserver_bench.proofs.motion import momentum, record

from uwserver.frames import conjugate, multiply, quat_from_rpy, rotate
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.energy import kinetic_energy, relative_velocities
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, P, Q
from uwserver.validation.oracle import build, load_oracle

ZERO = np.zeros((6, 6))


def undamped(body: BodyParams) -> BodyParams:
    """Without damping and restoring forces."""
    return replace(body, D_L=ZERO, D_Q=ZERO, D_S=ZERO, weight=0.0, buoyancy=0.0)


def start(hydro: Hydrodynamics) -> None:
    """Deep, tilted and moving in all axes."""
    hydro.state[:, P : P + 3] = 1.0, -2.0, 50.0
    hydro.state[:, Q : Q + 4] = quat_from_rpy(0.3, -0.2, 1.1)
    hydro.state[:, NU : NU + 6] = 0.5, -0.2, 0.1, 0.2, -0.1, 0.3


def test_energy_and_momentum_of_the_free_body_drift_below_1e_9(oracles: Path) -> None:
    hydro = build(load_oracle(oracles / "kirchhoff_free_60s.json"))
    hydro.dt = 1.0 / 240.0
    energy, before = hydro.kinetic_energy()[0], momentum(hydro)[0]
    record(hydro, 60.0)
    after = momentum(hydro)[0]
    assert abs(hydro.kinetic_energy()[0] / energy - 1.0) <= 1e-9
    assert np.linalg.norm(after[:3] - before[:3]) <= 1e-9 * np.linalg.norm(before[:3])
    assert np.linalg.norm(after[3:] - before[3:]) <= 1e-9 * np.linalg.norm(before[3:])


def test_energy_and_momentum_with_the_centre_of_gravity_off_the_origin(full_body: BodyParams) -> None:
    hydro = Hydrodynamics([undamped(full_body)], 1.0 / 240.0)
    start(hydro)
    energy, before = hydro.kinetic_energy()[0], momentum(hydro)[0]
    record(hydro, 60.0)
    after = momentum(hydro)[0]
    assert abs(hydro.kinetic_energy()[0] / energy - 1.0) <= 1e-9
    assert np.linalg.norm(after - before) <= 1e-9 * np.linalg.norm(before)


def test_kinetic_energy_counts_the_water_relative_to_the_current(full_body: BodyParams) -> None:
    hydro = Hydrodynamics([full_body], 0.01)
    start(hydro)
    hydro.currents[0] = 0.3, -0.4, 0.1
    q = tuple(hydro.state[0, Q : Q + 4])
    nu = hydro.state[0, NU : NU + 6]
    nu_r = nu - np.array([*rotate(conjugate(q), (0.3, -0.4, 0.1)), 0.0, 0.0, 0.0])
    np.testing.assert_allclose(relative_velocities(hydro.state, hydro.currents)[0], nu_r, rtol=1e-13)
    expected = 0.5 * (nu @ full_body.M_RB @ nu + nu_r @ full_body.M_A @ nu_r)
    assert hydro.kinetic_energy()[0] == pytest.approx(expected, rel=1e-13)


def test_coriolis_forces_do_no_work(full_body: BodyParams) -> None:
    """Without other forces nu^T M nu_dot = -nu^T C(nu) nu, which vanishes for every velocity."""
    hydro = Hydrodynamics([undamped(full_body)] * 50, 0.01)
    start(hydro)
    hydro.state[:, NU : NU + 6] = np.random.default_rng(3).normal(size=(50, 6))
    nu_dot, _ = hydro.rates_of_change(0.0)
    M = full_body.M_RB + full_body.M_A
    nu = hydro.state[:, NU : NU + 6]
    power = np.einsum("ni,ij,nj->n", nu, M, nu_dot)
    scale = np.linalg.norm(nu, axis=1) * np.linalg.norm(nu_dot @ M, axis=1)
    assert np.all(np.abs(power) <= 1e-13 * scale)
    assert np.all(scale > 1e-2)


def test_a_uniform_current_is_a_shift_of_the_still_water_run(full_body: BodyParams) -> None:
    """All terms on: damping, added mass, harmonic wrench, weight against buoyancy."""
    current = np.array([0.4, -0.3, 0.15])
    hydro = Hydrodynamics([full_body, full_body], 1.0 / 240.0)
    start(hydro)
    for wrench in hydro.wrenches:
        wrench["bias"] = 20.0, -3.0, 2.0, 0.5, 0.2, 1.0
        wrench["amplitude"] = 10.0, 8.0, 6.0, 0.5, 0.4, 0.3
        wrench["omega"] = 0.5, 0.3, 0.7, 0.9, 1.1, 0.4
        wrench["harmonic"] = 1
    hydro.currents[1] = current
    hydro.state[1, NU : NU + 3] += rotate(conjugate(tuple(hydro.state[1, Q : Q + 4])), tuple(current))
    times, states = record(hydro, 60.0)
    shift: FloatArray = states[:, 1, :3] - states[:, 0, :3] - times[:, None] * current
    assert np.abs(shift).max() <= 1e-8
    turn = [multiply(conjugate(a[Q : Q + 4]), b[Q : Q + 4])[1:] for a, b in states[::240]]
    assert np.abs(turn).max() <= 1e-9
    assert np.linalg.norm(states[-1, 0, :3] - states[0, 0, :3]) > 1.0


def test_kinetic_energy_of_each_row_is_its_own(full_body: BodyParams) -> None:
    hydro = Hydrodynamics([full_body, undamped(full_body)], 0.01)
    hydro.state[1, NU] = 2.0
    assert kinetic_energy(hydro.bodies, hydro.state, hydro.currents).tolist() == pytest.approx(
        [0.0, 2.0 * (full_body.M_RB + full_body.M_A)[0, 0]]
    )
