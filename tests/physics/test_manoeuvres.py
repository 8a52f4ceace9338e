"""Whole manoeuvres of shipped vehicles against published figures and an independent solution: REMUS 100, Tethys, NPS AUV II."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.remus import OVERRIDE, RHO, SIMULATED, STEPS, Remus, remus_track

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import Environment, WorldTable
from uwserver.world import World

DEPTH = 200.0
FIVE = math.radians(5.0)
FULL_RPM = 1525.0


def ocean(model: str, rate_hz: float = 240.0, density: float = 1025.0, **override: object) -> World:
    entry = VehicleEntry(model=model, position_ned_m=(0.0, 0.0, DEPTH), override=override)
    scenario = Scenario(
        schema=1, world=WorldTable(rate_hz=rate_hz), environment=Environment(density_kgpm3=density), vehicles={"auv": entry}
    )  # fmt: skip
    return build(load(scenario, adapters={}))


def hold(world: World, seconds: float, **commands: dict[str, float | list[float]]) -> FloatArray:
    """State (13) after commands repeated before their watchdogs bark."""
    for _ in range(round(2.0 * seconds)):
        for port, value in commands.items():
            world.command(f"auv/{port}", **value)
        world.step(round(world.rate_hz) // 2)
    state: FloatArray = world.hydro.state[0].copy()
    return state


@pytest.fixture(scope="module")
def solved() -> list[FloatArray]:
    """States at the ends of the steps, of the equations of `uwserver_bench.proofs.remus` by DOP853."""
    return Remus().run(STEPS)


@pytest.fixture(scope="module")
def ours() -> list[FloatArray]:
    """The same of the kernel."""
    return remus_track(240.0)


def test_remus_steps_against_the_same_equations_by_another_integrator(
    ours: list[FloatArray], solved: list[FloatArray]
) -> None:
    """Bar: 1e-3 m at 100 s."""
    for got, wanted in zip(ours, solved, strict=True):
        np.testing.assert_allclose(got[:3], wanted[:3], atol=1e-6)
        np.testing.assert_allclose(got[NU:], wanted[6:12], atol=1e-7)


def test_remus_steps_against_the_figures_of_the_python_vehicle_simulator(ours: list[FloatArray]) -> None:
    """Bar: 0.02 m at 100 s. Its Euler steps move 4 mm from 2.5 to 1.25 ms; extrapolated to zero they meet ours."""
    coarse, fine = (np.array(SIMULATED[dt]) for dt in (0.0025, 0.00125))
    got = ours[-1][:3]
    assert np.linalg.norm(got - fine) <= 0.02
    assert np.linalg.norm(got - (2.0 * fine - coarse)) <= 1e-4


def test_the_variant_as_shipped_stays_near_the_simulators() -> None:
    """Where it is ours and not the simulator's (inflow of the propeller along its axis) it is 1.1 m away after 245 m."""
    got = remus_track(240.0, {"buoyancy": OVERRIDE["buoyancy"]})[-1][:3]
    assert np.linalg.norm(got - SIMULATED[0.00125]) <= 1.5


def test_the_remus_to_drive_goes_the_same_way_a_little_slower() -> None:
    """Its four-quadrant propeller gives the published 2.5 m/s, the simulator's curve 2.55."""
    start, neutral = np.array([0.0, 0.0, DEPTH]), OVERRIDE["buoyancy"]
    world = ocean("remus100", 240.0, RHO, buoyancy=neutral)
    for begin, end, (rudder, planes, rpm) in STEPS:
        got = hold(
            world, end - begin, rudder={"angle_rad": rudder}, stern_planes={"angle_rad": planes},
            propeller={"speed_radps": rpm / 60.0 * 2.0 * math.pi},
        )[:3] - start  # fmt: skip
    assert 1.0 < np.linalg.norm(got - SIMULATED[0.00125]) <= 10.0


def test_remus_with_the_whole_munk_moment_is_fossens_form(solved: list[FloatArray]) -> None:
    """Without the terms that the source leaves out, the kernel is M_A's own Kirchhoff form: a second right-hand side."""
    hull = {"derivatives": {"terms": dict.fromkeys(("Xwq", "Xvr", "Yur", "Zuq", "Muw", "Nuv"), 0.0)}}
    expected = Remus(munk=True).run(STEPS[:1])[0]
    world = ocean("remus100_pvs", 240.0, RHO, **OVERRIDE, hull=hull)
    got = hold(
        world, 25.0, rudder={"angle_rad": FIVE}, stern_planes={"angle_rad": -FIVE},
        propeller={"speed_radps": FULL_RPM / 60.0 * 2.0 * math.pi},
    )  # fmt: skip
    np.testing.assert_allclose(got[:3] - [0.0, 0.0, DEPTH], expected[:3], atol=1e-5)
    assert np.linalg.norm(expected[:3] - solved[0][:3]) > 5.0


def test_remus_reaches_its_speed() -> None:
    """2.5 m/s at 1525 rpm; with the source's own propeller it is 2.554."""
    full = {"speed_radps": FULL_RPM / 60.0 * 2.0 * math.pi}
    assert hold(ocean("remus100"), 30.0, propeller=full)[NU] == pytest.approx(2.5, rel=0.003)
    assert hold(ocean("remus100_pvs"), 30.0, propeller=full)[NU] == pytest.approx(2.554, rel=0.003)


@pytest.mark.parametrize(
    ("model", "planes", "shaft"), [("remus100", "stern_planes", 40.0), ("tethys", "elevator", 30.0)]
)
def test_positive_rudder_turns_to_starboard_and_positive_planes_dive(model: str, planes: str, shaft: float) -> None:
    ahead = {"propeller": {"speed_radps": shaft}}
    turning = hold(ocean(model), 30.0, rudder={"angle_rad": 0.15}, **ahead)
    diving = hold(ocean(model), 30.0, **{planes: {"angle_rad": 0.15}}, **ahead)
    assert turning[NU + 5] > 0.005
    assert diving[2] > DEPTH + 0.1


def test_tethys_at_300_rpm() -> None:
    """osrf/lrauv's own system test: 1.01 +/- 0.1 m/s within 45 s."""
    state = hold(ocean("tethys"), 45.0, propeller={"speed_radps": 10.0 * math.pi})
    assert state[NU] == pytest.approx(1.01, abs=0.1)


def test_tethys_rises_with_its_buoyancy_engine_and_pitches_with_its_battery() -> None:
    full = hold(ocean("tethys"), 240.0, buoyancy_engine={"volume_m3": 955e-6})
    empty = hold(ocean("tethys"), 240.0, buoyancy_engine={"volume_m3": 80e-6})
    assert full[2] < DEPTH - 5.0
    assert empty[2] > DEPTH + 5.0
    nose_down = hold(ocean("tethys"), 120.0, battery={"position_m": 0.03})
    w, x, y, z = nose_down[3:7]
    pitch = math.asin(2.0 * (w * y - z * x))
    # tan(pitch) = m x / (M z_g), at rest
    assert math.tan(pitch) == pytest.approx(-31.7307 * 0.03 / (147.8671 * 0.006794), rel=1e-3)


def test_npsauv2_speed_belongs_to_its_revolutions() -> None:
    """Healey and Lienard: u = 0.012 n without current; our damping at rest takes 4 %."""
    world = ocean("npsauv2_healey", damping={"at_rest": {"diagonal": [0.0, 150.0, 150.0, 450.0, 2700.0, 650.0]}})
    assert hold(world, 420.0, propeller={"speed_radps": 100.0})[NU] == pytest.approx(1.2, rel=1e-3)


def test_npsauv2_reaches_its_speed_with_a_propeller_of_four_quadrants() -> None:
    """1.885 m/s at 1500 rpm."""
    assert hold(ocean("npsauv2"), 240.0, propeller={"speed_radps": 157.0})[NU] == pytest.approx(1.885, rel=0.005)


def test_npsauv2_hull_is_the_published_polynomial(load_vehicle: Callable[..., BodyParams]) -> None:
    """Derivatives, M_A's Coriolis terms and the speed damping together give back Healey and Lienard's sums, going ahead."""
    body = load_vehicle("npsauv2_healey")
    L = 5.3
    r2, r3, r4, r5 = (0.5 * 1025.0 * L**k for k in (2, 3, 4, 5))
    u, v, w, p, q, r = nu = np.array([1.7, 0.3, -0.2, 0.11, -0.07, 0.13])
    published = np.array(
        [
            r2 * (5.3e-2 * v * v + 1.7e-1 * w * w - 0.00385 * u * u)
            + r3 * (2.0e-2 * v * r - 2.0e-1 * w * q - 3.0e-3 * v * p)
            + r4 * (-1.5e-2 * q * q + 4.0e-3 * r * r + 7.5e-4 * p * r + 7.0e-3 * p * p),
            r2 * (-1.0e-1 * u * v + 6.8e-2 * v * w)
            + r3 * (3.0e-3 * u * p + 3.0e-2 * u * r + 2.4e-2 * v * q + 2.3e-1 * w * p - 1.9e-2 * w * r)
            + r4 * (4.0e-3 * p * q - 6.5e-3 * q * r),
            r2 * (-3.0e-1 * w * u - 6.8e-2 * v * v)
            + r3 * (-1.4e-1 * u * q - 4.8e-2 * v * p + 4.5e-2 * v * r)
            + r4 * (1.3e-4 * p * p + 6.7e-3 * p * r - 7.4e-3 * r * r),
            r3 * (3.1e-3 * u * v - 1.9e-1 * v * w)
            + r4 * (-1.1e-2 * u * p - 8.4e-4 * u * r - 5.1e-3 * v * q - 1.3e-4 * w * p + 1.4e-2 * w * r)
            + r5 * (-6.9e-5 * p * q + 1.7e-2 * q * r),
            r3 * (1.0e-1 * u * w - 2.6e-2 * v * v)
            + r4 * (-6.8e-2 * u * q + 1.2e-3 * v * p + 1.7e-2 * v * r)
            + r5 * (5.3e-5 * p * p + 5.0e-3 * p * r + 2.9e-3 * r * r),
            r3 * (-7.4e-3 * u * v - 2.7e-2 * v * w)
            + r4 * (-8.4e-4 * u * p - 1.6e-2 * u * r - 1.0e-2 * v * q - 1.7e-2 * w * p + 7.4e-3 * w * r)
            + r5 * (-2.1e-2 * p * q + 2.7e-3 * q * r),
        ]
    )
    # No weight, no strips and no damping of ours; the Coriolis forces of M_RB are taken out by a bare twin.
    still = replace(
        body, D_L=np.zeros((6, 6)), D_Q=np.zeros((6, 6)), weight=0.0, buoyancy=0.0,
        appendages=replace(body.appendages, hulls=()),
    )  # fmt: skip
    bare = replace(still, M_A=np.zeros((6, 6)), D_S=np.zeros((6, 6)), appendages=type(body.appendages)())
    hydro = Hydrodynamics([still, bare], 0.01)
    hydro.state[:, 2], hydro.state[:, NU:] = 500.0, nu
    nu_dot = hydro.rates_of_change(0.0)[0]
    forces = (body.M_RB + body.M_A) @ nu_dot[0] - body.M_RB @ nu_dot[1]
    np.testing.assert_allclose(forces, published, rtol=1e-7)
