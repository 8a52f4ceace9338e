"""No shipped vehicle gains energy at any step from 1 to 20 ms, nor is fed by the water that should brake it; stiffer bodies are sub-stepped, and then
stepped implicitly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_tables import DOCS, tables
from uwserver_bench.proofs.closed_forms import ZERO6, table_a1
from uwserver_bench.proofs.motion import DEEP, decay_rise, energy_excess, record

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.appendage_params import Appendages, DerivativeParams
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU
from uwserver.validation.energy import largest_feed

SHIPPED = Path(__file__).parents[2] / "scenarios" / "uwserver_scenarios" / "vehicles"
VEHICLES = tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


TABLE = tables(DOCS / "validation.md")["Stability of every vehicle from 1 to 20 ms"]
"""Energy that each gains, of runs of a minute at four rates and of decays of 20 s; `make docs-check` proves that it is what the kernel does."""


def test_no_vehicle_gains_energy_in_the_runs_of_the_report() -> None:
    """Bar: 1e-6 of the energy a step."""
    assert [row["vehicle"] for row in TABLE] == list(VEHICLES)
    gained = [
        (row["vehicle"], at, float(excess.removeprefix("< ")))
        for row in TABLE
        for at, excess in row.items()
        if at != "vehicle"
    ]
    assert len(gained) == 5 * len(VEHICLES)
    assert [each for each in gained if each[2] > 1e-6] == []


@pytest.mark.parametrize(("dt", "seconds"), [(0.001, 3.0), (0.02, 20.0)])
def test_kinetic_energy_never_rises_beyond_the_work_done(
    load_vehicle: Callable[..., BodyParams], dt: float, seconds: float
) -> None:
    """In less time than those of the report, and at its ends."""
    excess = energy_excess([load_vehicle(name) for name in VEHICLES], dt, seconds)
    assert dict(zip(VEHICLES, excess > 1e-6, strict=True)) == dict.fromkeys(VEHICLES, False)


def test_the_energy_criterion_finds_a_body_that_gains_energy() -> None:
    pumped = replace(table_a1(), D_L=np.diag([-1.0, -1.0, -1.0, 0.0, 0.0, 0.0]), D_Q=ZERO6)
    assert energy_excess([pumped], 0.01, 5.0)[0] > 1e-4


@pytest.mark.parametrize("name", VEHICLES)
def test_free_decay_never_gains_energy(load_vehicle: Callable[..., BodyParams], name: str) -> None:
    """100 random velocities, also astern, sideways and turning; the work of hull derivatives is no input. Bar: 1e-6 of the energy a step."""
    assert decay_rise(load_vehicle(name), 0.01, 3.0).max() <= 1e-6


def with_terms(body: BodyParams, **coefficients: float) -> BodyParams:
    """Without damping, and with these derivatives of the hull."""
    terms = tuple(
        DerivativeParams("XYZKMN".index(n[0]), "uvwpqr".index(n[1]), "uvwpqr".index(n[2]), c)
        for n, c in coefficients.items()
    )
    return replace(body, D_L=0.02 * np.eye(6), D_Q=ZERO6, appendages=Appendages(derivatives=terms))


def test_a_hull_that_loses_its_munk_moment_without_the_pair_is_found() -> None:
    """Muw alone feeds; with Xwq and Zuq, whose sum is its opposite, it does no work."""
    alone, paired = with_terms(table_a1(), Muw=-9.0), with_terms(table_a1(), Muw=-9.0, Xwq=12.0, Zuq=-3.0)
    assert decay_rise(alone, 0.01, 5.0).max() > 1e-4
    assert largest_feed(alone, 2.0).rate > 0.1
    assert decay_rise(paired, 0.01, 5.0).max() <= 1e-6
    assert largest_feed(paired, 2.0).rate < 0.0


def light(damping: float, quadratic: float = 0.0) -> BodyParams:
    """1 kg with the given damping in every axis."""
    eye = np.eye(6)
    return BodyParams(eye, 0.1 * eye, damping * eye, quadratic * eye, ZERO6, 0.0, 0.0, (0.0,) * 3, (0.0,) * 3)


def surge_after(body: BodyParams, force: float, dt: float, seconds: float, u0: float = 0.0) -> FloatArray:
    hydro = Hydrodynamics([body], dt)
    hydro.state[0, NU] = u0
    hydro.wrenches["bias"][0, 0] = force
    _, states = record(hydro, seconds)
    velocities: FloatArray = states[:, 0, NU]
    return velocities


@pytest.mark.parametrize("damping", [50.0, 200.0, 500.0, 1000.0])
def test_substeps_follow_a_fast_decay(damping: float) -> None:
    """rate * dt up to 18 needs up to 16 sub-steps; RK4 alone would explode beyond 2.8."""
    u = surge_after(light(damping), 0.0, 0.02, 0.1, u0=1.0)
    expected = np.exp(-damping / 1.1 * 0.02 * np.arange(len(u)))
    assert np.abs(u - expected).max() <= 0.02
    assert np.all(np.diff(u) <= 0.0)


@pytest.mark.parametrize("damping", [3e3, 1e5, 1e8])
def test_beyond_the_substeps_the_implicit_rule_holds_the_terminal_velocity(damping: float) -> None:
    u = surge_after(light(damping), 10.0, 0.02, 2.0, u0=1.0)
    assert np.all(np.abs(u) <= 1.0)
    assert u[-1] == pytest.approx(10.0 / damping, rel=1e-9)


@pytest.mark.parametrize("quadratic", [1e3, 1e6])
@pytest.mark.parametrize("force", [10.0, 1e4])
def test_quadratic_damping_from_rest_under_a_sudden_force(quadratic: float, force: float) -> None:
    """At rest the damping has no rate yet: the step must foresee the velocity that the force will give."""
    u = surge_after(light(0.0, quadratic), force, 0.02, 4.0)
    assert u[-1] == pytest.approx((force / quadratic) ** 0.5, rel=1e-6)


@pytest.mark.parametrize("speed_damping", [1e3, 1e6])
def test_speed_proportional_damping_settles_without_ringing(speed_damping: float) -> None:
    body = replace(light(0.0), D_S=speed_damping * np.eye(6))
    u = surge_after(body, 100.0, 0.02, 4.0)
    assert u[-1] == pytest.approx((100.0 / speed_damping) ** 0.5, rel=1e-6)


@pytest.mark.parametrize("name", ["bluerov2_heavy", "eca_a9", "lauv"])
def test_a_thousand_times_the_damping_never_diverges(load_vehicle: Callable[..., BodyParams], name: str) -> None:
    body: BodyParams = load_vehicle(name)
    stiff = replace(body, D_L=1e3 * body.D_L, D_Q=1e3 * body.D_Q, D_S=1e3 * body.D_S)
    hydro = Hydrodynamics([stiff], 0.02)
    hydro.state[0, 2] = DEEP
    rng = np.random.default_rng(5)
    for k in range(1500):
        if k % 25 == 0:
            hydro.wrenches["bias"][0] = body.weight * rng.uniform(-1.0, 1.0, 6) * (1, 1, 1, 0.1, 0.1, 0.1)
        assert hydro.advance(k * 0.02) < 0
        assert np.abs(hydro.state[0, NU:]).max() < 5.0


def test_a_diverging_body_is_named() -> None:
    """Damping with the wrong sign: the kernel says which row left the world of finite numbers."""
    hydro = Hydrodynamics([light(1.0), light(-30.0)], 0.02)
    hydro.state[:, NU] = 1.0
    assert max(hydro.advance(k * 0.02) for k in range(200)) == 1
