"""Measures of motion, on motions whose measures are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.motion import (
    DEEP,
    angular_frequency,
    decay_rise,
    energy_excess,
    momentum,
    potential_energy,
    random_wrenches,
    record,
)

from uwserver.frames import quat_from_rpy, rotate
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams

ZERO = np.zeros((6, 6))
BODY = BodyParams(
    np.diag([10.0] * 3 + [1.0] * 3),
    np.diag([4.0] * 3 + [0.5] * 3),
    np.eye(6),
    ZERO,
    ZERO,
    100.0,
    90.0,
    (0.0, 0.0, 0.1),
    (0.0,) * 3,
)


def test_momentum_is_that_of_body_and_water_in_n() -> None:
    hydro = Hydrodynamics([BODY], 0.01)
    q = quat_from_rpy(0.2, -0.3, 1.0)
    nu = np.array([1.0, -0.5, 0.3, 0.1, 0.2, -0.4])
    hydro.state[0] = 2.0, 3.0, 50.0, *q, *nu
    linear, spin = 14.0 * np.array(rotate(q, nu[:3])), 1.5 * np.array(rotate(q, nu[3:]))
    np.testing.assert_allclose(momentum(hydro)[0], [*linear, *(spin + np.cross([2.0, 3.0, 50.0], linear))], rtol=1e-12)


def test_potential_energy_falls_as_a_heavy_body_sinks_and_rises_as_its_weight_is_lifted() -> None:
    hydro = Hydrodynamics([BODY], 0.01)
    states = np.zeros((3, 1, 13))
    states[:, 0, 3] = 1.0
    states[1, 0, 2] = 2.0
    states[2, 0, 3:7] = quat_from_rpy(np.pi, 0.0, 0.0)
    energy = potential_energy(hydro, states)[:, 0]
    assert energy[1] - energy[0] == pytest.approx(-20.0)
    assert energy[2] - energy[0] == pytest.approx(2.0 * 100.0 * 0.1)


def test_a_record_begins_with_the_present_state_and_ends_with_the_last() -> None:
    hydro = Hydrodynamics([BODY, BODY], 0.01)
    hydro.state[:, 2] = DEEP
    start = hydro.state.copy()
    times, states = record(hydro, 0.5)
    assert states.shape == (51, 2, 13)
    np.testing.assert_allclose(times, 0.01 * np.arange(51), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(states[0], start)
    np.testing.assert_array_equal(states[-1], hydro.state)


def test_a_record_of_a_diverging_body_says_when() -> None:
    hydro = Hydrodynamics([BODY], 0.01)
    hydro.wrenches["bias"] = np.inf
    with pytest.raises(FloatingPointError, match=r"step 0 of 0\.01 s"):
        record(hydro, 1.0)


@pytest.mark.parametrize("omega", [0.5, 3.0])
def test_the_frequency_of_a_sine_is_found(omega: float) -> None:
    t = np.linspace(0.0, 40.0, 4001)
    assert angular_frequency(t, np.sin(omega * t + 0.3)) == pytest.approx(omega, rel=1e-4)
    with pytest.raises(ValueError, match="two upward crossings"):
        angular_frequency(t, np.ones(4001))


def test_drawn_wrenches_are_held_for_half_a_second_within_their_limits_and_repeat() -> None:
    wrench, again = (random_wrenches([BODY, BODY], 1000, 0.01, seed=3) for _ in range(2))
    drawn = [wrench(k) for k in range(1000)]
    given = [k for k, w in enumerate(drawn) if w is not None]
    assert given == list(range(0, 1000, 50))
    values = np.array([drawn[k] for k in given])
    assert (np.abs(values[..., :3]) <= 50.0).all()
    assert (np.abs(values[..., 3:]) <= 1.5).all()
    assert np.abs(values).std(axis=0).min() > 0.0
    np.testing.assert_array_equal(values[3], again(150))


def test_energy_does_not_grow_beyond_the_work() -> None:
    """And the measure can tell: at steps that RK4 without sub-steps could not do, a body gains none either."""
    excess = energy_excess([BODY, replace(BODY, D_L=5.0 * np.eye(6))], 0.01, 3.0)
    assert excess.shape == (2,)
    assert excess.max() < 1e-6


def test_a_free_decay_loses_energy_in_each_run_and_one_that_is_pumped_gains_it() -> None:
    assert decay_rise(BODY, 0.01, 2.0, count=7).shape == (7,)
    assert decay_rise(BODY, 0.01, 2.0, count=7).max() < 0.0
    assert decay_rise(replace(BODY, D_L=-np.eye(6)), 0.01, 2.0, count=7).min() > 1e-4


def test_a_free_decay_without_damping_keeps_its_energy_whatever_its_weight() -> None:
    assert np.abs(decay_rise(replace(BODY, D_L=ZERO), 0.01, 5.0, count=7)).max() < 1e-8
