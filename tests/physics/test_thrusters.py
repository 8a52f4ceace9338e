"""Thrusters in the kernel: T200 table, dead band, lag, inflow, immersion, handedness, saturation by force."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from uwserver_bench.proofs.motion import record

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.immersion import disc_fraction
from uwserver.physics.dynamics.lag import Lag
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, ForceTable, ThrusterParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q
from uwserver.scenario.vehicle.body import force_table, lag, thruster_params
from uwserver.scenario.vehicle.tables import Thruster, ThrusterDevice

MAKER = {
    12.0: (36.4, 28.6, 36),
    14.0: (44.4, 34.5, 32),
    16.0: (51.4, 39.9, 28),
    18.0: (59.0, 45.0, 28),
    20.0: (65.9, 49.4, 24),
}
"""Supply voltage: maximum forward and reverse thrust (N), half the dead band (us), of the maker's workbook."""

LINEAR = ForceTable((16.0,), (((-1.0, -40.0), (1.0, 40.0)),))


def fixed(*thrusters: ThrusterParams, **changes: object) -> BodyParams:
    """A body so heavy that no thrust moves it."""
    eye, zero = 1e12 * np.eye(6), np.zeros((6, 6))
    return replace(
        BodyParams(eye, zero, zero, zero, zero, 0.0, 0.0, (0.0,) * 3, (0.0,) * 3, thrusters=thrusters),
        **changes,  # type: ignore[arg-type]
    )


def thruster(**changes: object) -> ThrusterParams:
    return replace(ThrusterParams("t", (0.0,) * 3, (1.0, 0.0, 0.0), LINEAR, 16.0, Lag()), **changes)  # type: ignore[arg-type]


def wrench(
    body: BodyParams, command: float | list[float], by_force: bool = False, nu: FloatArray | None = None
) -> FloatArray:
    """Wrench (6) of the body's thrusters at a command, after one tick."""
    hydro = Hydrodynamics([body], 1.0 / 240.0)
    hydro.state[0, 2] = 20.0
    hydro.thrusters["command"], hydro.thrusters["by_force"], hydro.thrusters["fresh"] = command, int(by_force), 1
    hydro.advance(0.0)
    hydro.state[0, NU : NU + 6] = 0.0 if nu is None else nu
    result: FloatArray = hydro.rates_of_change(0.0)[1][0]
    return result


@pytest.mark.parametrize("voltage", MAKER)
def test_t200_maxima_and_dead_band(t200: ThrusterDevice, voltage: float) -> None:
    forward, reverse, dead_us = MAKER[voltage]
    body = fixed(thruster(table=force_table(t200), voltage=voltage))
    assert wrench(body, 1.0)[0] == pytest.approx(forward, rel=1e-12)
    assert wrench(body, -1.0)[0] == pytest.approx(-reverse, rel=1e-12)
    edge = dead_us / 400.0
    for inside in (-edge, -0.5 * edge, 0.0, 0.5 * edge, edge):
        assert wrench(body, inside)[0] == 0.0
    one_us = 1.0 / 400.0
    assert wrench(body, edge + one_us)[0] > 0.0
    assert wrench(body, -edge - one_us)[0] < 0.0


def test_t200_between_the_voltages_and_beyond(t200: ThrusterDevice) -> None:
    table = force_table(t200)
    assert wrench(fixed(thruster(table=table, voltage=15.0)), 1.0)[0] == pytest.approx(0.5 * (44.4 + 51.4))
    assert wrench(fixed(thruster(table=table, voltage=9.0)), 1.0)[0] == pytest.approx(0.5 * (15.8 + 36.4))
    assert wrench(fixed(thruster(table=table, voltage=4.0)), 1.0)[0] == pytest.approx(15.8)
    assert wrench(fixed(thruster(table=table, voltage=24.0)), 1.0)[0] == pytest.approx(65.9)


def test_t200_follows_the_polynomial_and_rises(t200: ThrusterDevice) -> None:
    table = force_table(t200)
    hydro = Hydrodynamics([fixed(*[thruster(table=table)] * 101)], 0.01)
    hydro.thrusters["command"], hydro.thrusters["fresh"] = np.linspace(-1.0, 1.0, 101), 1
    hydro.advance(0.0)
    demand = hydro.thrusters["demand"]
    v = (np.linspace(-1.0, 1.0, 101) - 0.07) / 0.93
    polynomial = 51.4 * (8.9 * v + 176.0 * v**3 - 404.1 * v**5 + 389.9 * v**7 - 140.3 * v**9) / 30.4
    ahead = v > 0.0
    # 23 chords a side: their sagitta is the difference, largest where the polynomial bends near full command.
    assert np.abs(demand[ahead] - polynomial[ahead]).max() < 0.25
    # The polynomial overshoots its value at full command by 0.5 % near v = 0.97.
    assert np.all(np.diff(demand) >= -0.2)


@pytest.mark.parametrize("dt", [1.0 / 240.0, 0.02])
def test_third_order_lag_against_scipy(t200: ThrusterDevice, dt: float) -> None:
    body = fixed(thruster(lag=lag(t200.lag)))
    hydro = Hydrodynamics([body], dt)
    steps = round(0.6 / dt)
    commands = np.where(np.arange(steps) < steps // 2, 0.5, -0.25)
    got = []
    for k in range(steps):
        hydro.thrusters["command"], hydro.thrusters["fresh"] = commands[k], 1
        hydro.advance(k * dt)
        got.append(hydro.rates_of_change(0.0)[1][0, 0])
    fine = 64
    times = np.arange(steps * fine + 1) * dt / fine
    step = signal.step(([6136.0, 108700.0], [1.0, 89.0, 9258.0, 108700.0]), T=times)[1]
    switch = (steps // 2) * fine
    response = 20.0 * step
    response[switch:] -= 30.0 * step[: len(step) - switch]
    np.testing.assert_allclose(got, response[fine::fine], atol=1e-6)


@pytest.mark.parametrize("level", [0, 3])
def test_lag_does_not_depend_on_substeps(level: int) -> None:
    """A body with fast damping is sub-stepped; the exact transitions give the same thrust."""
    damping = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 1e12 * (10.0 if level == 0 else 500.0)])
    hydro = Hydrodynamics([fixed(thruster(lag=Lag.first_order(0.1)), D_L=damping)], 0.02)
    hydro.thrusters["command"], hydro.thrusters["fresh"] = 1.0, 1
    for k in range(5):
        hydro.advance(k * 0.02)
    assert hydro.rates_of_change(0.0)[1][0, 0] == pytest.approx(40.0 * (1.0 - math.exp(-1.0)), rel=1e-12)


def test_command_by_force_holds_to_what_the_supply_allows(t200: ThrusterDevice) -> None:
    body = fixed(thruster(table=force_table(t200), installed=0.5))
    assert wrench(body, 12.5, by_force=True)[0] == 12.5
    assert wrench(body, 400.0, by_force=True)[0] == pytest.approx(0.5 * 51.4)
    assert wrench(body, -400.0, by_force=True)[0] == pytest.approx(-0.5 * 39.9)


def test_efficiency_and_installed_factor_scale_the_thrust() -> None:
    hydro = Hydrodynamics([fixed(thruster(installed=0.6))], 0.01)
    hydro.thrusters["efficiency"] = 0.5
    hydro.thrusters["command"], hydro.thrusters["fresh"] = 1.0, 1
    hydro.advance(0.0)
    assert hydro.rates_of_change(0.0)[1][0, 0] == pytest.approx(40.0 * 0.6 * 0.5)


def test_wrench_about_the_origin() -> None:
    axis, r = np.array([1.0, 2.0, -2.0]) / 3.0, np.array([0.2, -0.1, 0.3])
    tau = wrench(fixed(thruster(r=tuple(r), axis=tuple(5.0 * axis))), 0.5)
    np.testing.assert_allclose(tau, np.concatenate([20.0 * axis, np.cross(r, 20.0 * axis)]), atol=1e-12)


@pytest.mark.parametrize(("handedness", "sign"), [("right", -1.0), ("left", 1.0), ("none", 0.0)])
@pytest.mark.parametrize("command", [1.0, -1.0])
def test_reaction_torque_opposes_the_propeller(
    t200: ThrusterDevice, handedness: str, sign: float, command: float
) -> None:
    entry = Thruster(
        device="t200", position_frd_m=(0.0, 0.0, 0.0), axis_frd=(1.0, 0.0, 0.0), handedness=handedness, source="x", status="guess"  # type: ignore[arg-type]
    )  # fmt: skip
    tau = wrench(fixed(replace(thruster_params("t", entry, t200, 1025.0), lag=Lag())), command)
    assert tau[3] == pytest.approx(sign * t200.propeller.torque_per_force_m * tau[0])
    assert abs(tau[0]) > 30.0


def test_inflow_takes_thrust_with_the_speed_of_the_mount() -> None:
    """A mount 0.5 m to the right of a yawing vehicle moves backwards against its axis."""
    params = thruster(r=(0.0, 0.5, 0.0), inflow=0.8)
    nu = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.4])
    ahead = wrench(fixed(params), 1.0, nu=nu)
    assert ahead[0] == pytest.approx(40.0 - 0.8 * math.sqrt(40.0) * (0.6 - 0.5 * 0.4), rel=1e-9)
    astern = wrench(fixed(params), -1.0, nu=nu)
    assert astern[0] == pytest.approx(-40.0 - 0.8 * math.sqrt(40.0) * (0.6 - 0.5 * 0.4), rel=1e-9)


def test_inflow_counts_the_current_as_well() -> None:
    hydro = Hydrodynamics([fixed(thruster(inflow=0.8))], 0.01)
    hydro.currents[0] = -0.5, 0.0, 0.0
    hydro.thrusters["command"], hydro.thrusters["fresh"] = 1.0, 1
    hydro.advance(0.0)
    assert hydro.rates_of_change(0.0)[1][0, 0] == pytest.approx(40.0 - 0.8 * math.sqrt(40.0) * 0.5)


def test_thrust_scales_with_the_submerged_part_of_the_disc() -> None:
    shape = BuoyancyShape(1, (0.0, 0.0, 0.0), (0.5, 0.0, 0.0), 0.5)
    hydro = Hydrodynamics([fixed(thruster(r=(0.0, 0.3, 0.0), disc_radius=0.05), shapes=(shape,))], 1e-6)
    for depth, roll in ((-0.2, 0.0), (-0.02, 0.0), (0.0, 0.0), (0.03, 0.0), (0.2, 0.0), (0.0, 0.1), (0.0, -0.1)):
        hydro.state[0, 2] = depth
        hydro.state[0, Q : Q + 4] = quat_from_rpy(roll, 0.0, 0.0)
        hydro.thrusters["command"], hydro.thrusters["fresh"] = 1.0, 1
        hydro.advance(0.0)
        expected = 40.0 * disc_fraction(depth + 0.3 * math.sin(roll), 0.05)
        assert hydro.rates_of_change(0.0)[1][0, 0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("u", [1.5, -1.5])
def test_a_t200_stopped_or_against_the_inflow_stays_within_bounds(t200: ThrusterDevice, u: float) -> None:
    """At 1.5 m/s: the stopped one drags by 4 N where the hull's damping has not got it, and no command gives more than twice its thrust at rest."""
    entry = Thruster(
        device="t200", position_frd_m=(0.0, 0.0, 0.0), axis_frd=(1.0, 0.0, 0.0), damping_includes_stopped=False, source="x", status="guess"
    )  # fmt: skip
    bare = replace(thruster_params("t", entry, t200, 1025.0), lag=Lag())
    nu = np.array([u, 0.0, 0.0, 0.0, 0.0, 0.0])
    drag = -math.copysign(0.5 * 1025.0 * math.pi / 4.0 * 0.076**2 * t200.propeller.stopped_drag * u**2, u)
    assert 2.0 < abs(drag) < 6.0
    assert wrench(fixed(bare), 0.0, nu=nu)[0] == pytest.approx(drag)
    assert wrench(fixed(replace(bare, drag=0.0)), 0.0, nu=nu)[0] == 0.0
    commands = np.linspace(-1.0, 1.0, 41)
    rest = np.array([wrench(fixed(bare), command)[0] for command in commands])
    moving = np.array([wrench(fixed(bare), command, nu=nu)[0] for command in commands])
    assert (np.abs(moving - drag) <= 2.0 * np.abs(rest) + 1e-12).all()
    assert ((moving - drag) * rest >= 0.0).all()
    assert (np.diff(moving) >= -0.3).all()  # as the polynomial of the table at rest


def test_no_inflow_however_fast_makes_thrust_without_end(t200: ThrusterDevice) -> None:
    for u in (-1e3, 1e3):
        nu = np.array([u, 0.0, 0.0, 0.0, 0.0, 0.0])
        for command in (0.1, 1.0, -1.0):
            bare = thruster(table=force_table(t200), inflow=t200.propeller.inflow_sqrtN_spm)
            assert abs(wrench(fixed(bare), command, nu=nu)[0]) <= 2.0 * abs(wrench(fixed(bare), command)[0])


@pytest.mark.parametrize(("u", "sign"), [(0.715, 1.0), (0.725, -1.0)])
def test_bluerov2_heavy_held_level_at_full_power_ends_at_the_measured_speed(
    load_vehicle: Callable[..., BodyParams], u: float, sign: float
) -> None:
    """About 0.72 m/s (von Benzon et al.): below it still gains speed, above it loses some."""
    body = load_vehicle("bluerov2_heavy", density_kgpm3=1000.0, gravity_mps2=9.82)
    hydro = Hydrodynamics([body], 1.0 / 240.0)
    hydro.thrusters["command"], hydro.thrusters["fresh"] = [-1.0, -1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0], 1
    level = np.array([0.0, 0.0, 50.0, 1.0, 0.0, 0.0, 0.0, u, 0.0, 0.0, 0.0, 0.0, 0.0])
    for k in range(480):  # until the lag has run out
        hydro.state[0] = level
        hydro.advance(k / 240.0)
    hydro.state[0] = level
    assert sign * hydro.rates_of_change(0.0)[0][0, 0] > 0.0


@pytest.mark.parametrize(
    ("command", "sign"),
    [
        ([-1, -1, 1, 1, 0, 0, 0, 0], (1, 0, 0, 0, 1, 0)),
        ([1, -1, 1, -1, 0, 0, 0, 0], (0, 1, 0, -1, 0, 0)),
        ([1, -1, -1, 1, 0, 0, 0, 0], (0, 0, 0, 0, 0, 1)),
        ([0, 0, 0, 0, 1, 1, 1, 1], (0, 0, 1, 0, 0, 0)),
        ([0, 0, 0, 0, 1, -1, 1, -1], (0, 0, 0, 1, 0, 0)),
        ([0, 0, 0, 0, -1, -1, 1, 1], (0, 0, 0, 0, 1, 0)),
    ],
)
def test_bluerov2_heavy_directions_are_those_of_ardusub(
    load_vehicle: Callable[..., BodyParams], command: list[int], sign: tuple[int, ...]
) -> None:
    """By force, 10 N each: the motor factors of `vectored_6dof` turn into motions along single axes."""
    body: BodyParams = load_vehicle("bluerov2_heavy")
    still = replace(body, thrusters=tuple(replace(t, lag=Lag(), torque_per_force=0.0) for t in body.thrusters))
    tau = wrench(still, [10.0 * c for c in command], by_force=True)
    assert np.sign(np.round(tau, 6)).tolist() == list(map(float, sign))


def test_a_run_with_thrusters_keeps_its_accuracy_at_half_the_rate(load_vehicle: Callable[..., BodyParams]) -> None:
    """The lag's exact stage values keep the whole step of fourth order."""
    finals = []
    for rate in (60, 120, 240):
        hydro = Hydrodynamics([load_vehicle("bluerov2_heavy")], 1.0 / rate)
        hydro.state[0, 2] = 20.0
        hydro.thrusters["command"], hydro.thrusters["fresh"] = [0.5, 0.5, 0.7, 0.7, 0.4, 0.4, 0.4, 0.4], 1
        _, states = record(hydro, 4.0)
        finals.append(states[-1, 0, :3])
    coarse, fine = np.linalg.norm(finals[0] - finals[1]), np.linalg.norm(finals[1] - finals[2])
    assert fine < 1e-6
    assert coarse / fine > 8.0
