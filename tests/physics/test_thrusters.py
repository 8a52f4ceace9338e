"""Thrusters in the kernel: T200 table, dead band, lag, inflow, immersion, handedness, saturation by force."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from scipy import signal
from uwserver_bench.proofs.motion import record

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.appendage_params import quadrant_coefficients
from uwserver.physics.dynamics.immersion import disc_fraction
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape, ForceTable, Lag, ThrusterParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q
from uwserver.scenario.build.members import electric_of
from uwserver.scenario.vehicle.body import force_table, lag, thruster_params
from uwserver.scenario.vehicle.tables import Electric as ElectricTable
from uwserver.scenario.vehicle.tables import Thruster, ThrusterDevice
from uwserver.scenario.vehicle.wageningen import b4_70

WORKBOOK = np.genfromtxt(
    Path(__file__).parent / "data" / "t200_september_2019.csv", delimiter=",", names=True, skip_header=1
)
"""The maker's measurements: `pwm_us`, and at each voltage V `thrust_kgf_V`, `speed_rpm_V`, `power_W_V`."""
VOLTAGES = (10, 12, 14, 16, 18, 20)
DEAD_BAND_US = {10: (1460, 1540), 12: (1464, 1536), 14: (1468, 1532), 16: (1472, 1528), 18: (1472, 1528), 20: (1476, 1528)}  # fmt: skip
KGF = 9.80665

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


def static_thrust(table: ForceTable, pwm_us: FloatArray, voltage: float) -> FloatArray:
    """Static thrust (N) of the kernel at pulses, each given to a thruster of its own."""
    hydro = Hydrodynamics([fixed(*[thruster(table=table, voltage=voltage)] * len(pwm_us))], 0.01)
    hydro.thrusters["command"], hydro.thrusters["fresh"] = (pwm_us - 1500.0) / 400.0, 1
    hydro.advance(0.0)
    demand: FloatArray = hydro.thrusters["demand"].copy()
    return demand


@pytest.mark.parametrize("voltage", VOLTAGES)
def test_t200_pushes_as_the_maker_measured(t200: ThrusterDevice, voltage: int) -> None:
    """At all 201 pulses of the workbook; the bars are four times as wide as the scatter of its rows about a smooth curve."""
    measured = KGF * WORKBOOK[f"thrust_kgf_{voltage}"]
    error = np.abs(static_thrust(force_table(t200), WORKBOOK["pwm_us"], voltage) - measured)
    assert error.max() < 1.0
    assert error.mean() < 0.12
    assert error[[0, -1]].max() < 0.01  # full command


@pytest.mark.parametrize("voltage", VOLTAGES)
def test_t200_stands_still_in_the_dead_band_and_nowhere_else(t200: ThrusterDevice, voltage: int) -> None:
    low, high = DEAD_BAND_US[voltage]
    pwm = np.array([low - 1.0, low, 1500.0, high, high + 1.0])
    assert np.sign(static_thrust(force_table(t200), pwm, voltage)).tolist() == [-1.0, 0.0, 0.0, 0.0, 1.0]


def test_t200_between_the_voltages_and_beyond(t200: ThrusterDevice) -> None:
    table = force_table(t200)

    def full(voltage: float) -> float:
        return float(wrench(fixed(thruster(table=table, voltage=voltage)), 1.0)[0])

    assert full(15.0) == pytest.approx(0.5 * (full(14.0) + full(16.0)))
    assert full(6.0) == pytest.approx(0.6**1.3 * full(10.0), abs=0.01)
    assert full(4.0) == full(6.0)
    assert full(24.0) == full(20.0)


@pytest.mark.parametrize("voltage", VOLTAGES[1:-1])
def test_thrust_is_nearly_linear_in_the_voltage(t200: ThrusterDevice, voltage: int) -> None:
    """The workbook's sheet of a voltage, from the tables of its neighbours alone: over 4 V, twice the step of the tables."""
    without = structs.replace(
        t200, tables={name: table for name, table in t200.tables.items() if table.voltage_V != voltage}
    )
    measured = KGF * WORKBOOK[f"thrust_kgf_{voltage}"]
    error = np.abs(static_thrust(force_table(without), WORKBOOK["pwm_us"], voltage) - measured)
    assert error.max() < 1.8
    assert error.mean() < 0.5


def test_t200_spins_up_within_the_published_time(t200: ThrusterDevice) -> None:
    """63 % of a step after 0.1 to 0.2 s, and no overshoot."""
    hydro = Hydrodynamics([fixed(thruster(lag=lag(t200.lag)))], 0.01)
    hydro.thrusters["command"], hydro.thrusters["fresh"] = 0.5, 1
    force = []
    for k in range(100):
        hydro.advance(0.01 * k)
        force.append(hydro.rates_of_change(0.0)[1][0, 0] / 20.0)
    assert force[9] < 1.0 - math.exp(-1.0) < force[19]
    assert max(force) <= 1.0
    assert force[-1] > 0.999


@pytest.mark.parametrize("voltage", [12, 14, 16])
def test_power_and_shaft_speed_follow_the_maker_s_measurements(t200: ThrusterDevice, voltage: int) -> None:
    """Two numbers a direction for all of it: within 12 % of full power, and 5 % of the speed."""
    assert isinstance(t200.electric, ElectricTable)
    electric = electric_of(t200.electric)
    thrust = KGF * WORKBOOK[f"thrust_kgf_{voltage}"]
    power, speed = WORKBOOK[f"power_W_{voltage}"], WORKBOOK[f"speed_rpm_{voltage}"] * math.pi / 30.0
    for sign in (1.0, -1.0):
        pushes = sign * thrust > 2.0
        drawn = np.array([electric.draw(T) for T in thrust[pushes].tolist()])
        assert np.abs(drawn - power[pushes]).max() < 0.12 * power[pushes].max()
        turned = np.array([electric.turn(T) for T in thrust[pushes].tolist()])
        assert np.abs(turned / (sign * speed[pushes]) - 1.0).max() < 0.05


def test_the_identified_curve_is_the_paper_s_polynomial(t200_von_benzon: ThrusterDevice) -> None:
    u = np.linspace(-1.0, 1.0, 101)
    demand = static_thrust(force_table(t200_von_benzon), 1500.0 + 400.0 * u, 16.0)
    polynomial = 8.9 * u + 176.0 * u**3 - 404.1 * u**5 + 389.9 * u**7 - 140.3 * u**9
    # 23 chords a side: their sagitta is the difference, largest where the polynomial bends near full command.
    assert np.abs(demand - polynomial).max() < 0.25
    # The polynomial overshoots its value at full command by 0.5 % near u = 0.97.
    assert np.all(np.diff(demand) >= -0.2)


@pytest.mark.parametrize("dt", [1.0 / 240.0, 0.02])
def test_third_order_lag_against_scipy(t200_von_benzon: ThrusterDevice, dt: float) -> None:
    body = fixed(thruster(lag=lag(t200_von_benzon.lag)))
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
    assert wrench(body, 400.0, by_force=True)[0] == pytest.approx(0.5 * 51.44)
    assert wrench(body, -400.0, by_force=True)[0] == pytest.approx(-0.5 * 39.91)


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
    assert (np.abs(moving - drag) <= 2.0 * np.abs(rest) + 1e-9).all()
    assert ((moving - drag) * rest >= -1e-9).all()
    assert (np.diff(moving) >= -0.3).all()  # as the polynomial of the table at rest


def test_no_inflow_however_fast_makes_thrust_without_end(t200: ThrusterDevice) -> None:
    for u in (-1e3, 1e3):
        nu = np.array([u, 0.0, 0.0, 0.0, 0.0, 0.0])
        for command in (0.1, 1.0, -1.0):
            bare = thruster(table=force_table(t200), inflow=t200.propeller.inflow_sqrtN_spm)
            assert abs(wrench(fixed(bare), command, nu=nu)[0]) <= 2.0 * abs(wrench(fixed(bare), command)[0])


def test_inflow_and_stopped_drag_together_are_one_propeller() -> None:
    """Both of a propeller whose four quadrants are known, the B4-70 at the T200's size, at 1 m/s and from J = 0.1 to all but stopped.

    The slope of K_T(J) up to J = 0.5 has the drag of the stopped propeller in it, at J = 0.5 by pi / 16 C D sqrt(rho / K_T0): with the whole slope
    beside that drag the thruster loses 2.5 N too much at J = 0.3, without that share it is within 0.6 N, or 3 % where it is strong.
    """
    rho, D, va = 1025.0, 0.076, 1.0
    series = b4_70(0.87)

    def thrust(n: float) -> float:
        beta = math.atan2(va, 0.7 * math.pi * n * D)
        pressure = 0.5 * rho * (va**2 + (0.7 * math.pi * n * D) ** 2) * math.pi / 4.0 * D**2
        return float(pressure * quadrant_coefficients(series, np.array([beta]))[0][0])

    drag = -thrust(0.0)
    K_T0 = math.pi / 8.0 * (0.7 * math.pi) ** 2 * sum(row[0] for row in series)
    n_half = va / (0.5 * D)
    whole = (K_T0 - thrust(n_half) / (rho * n_half**2 * D**4)) / 0.5 * D * math.sqrt(rho / K_T0)
    share = math.pi / 16.0 * drag / (math.pi / 8.0 * rho * D**2 * va**2) * D * math.sqrt(rho / K_T0)
    nu = np.array([va, 0.0, 0.0, 0.0, 0.0, 0.0])
    table = ForceTable((16.0,), (((-1.0, -300.0), (1.0, 300.0)),))
    advance = (0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.5, 2.5, 5.0)
    at_rest = [K_T0 * rho * (va / (J * D)) ** 2 * D**4 for J in advance]
    off = {}
    for inflow in (whole, whole - share):
        bodies = [fixed(thruster(table=table, inflow=inflow, drag=drag)) for _ in advance]
        made = [wrench(body, force, by_force=True, nu=nu)[0] for body, force in zip(bodies, at_rest, strict=True)]
        off[inflow] = [got - thrust(va / (J * D)) for got, J in zip(made, advance, strict=True)]
    assert off[whole][1] < -2.0
    assert np.abs(off[whole - share][1:]).max() < 0.6
    assert abs(off[whole - share][0]) < 0.03 * at_rest[0]


def test_the_t200_loses_that_share_once(t200: ThrusterDevice) -> None:
    """Slope 0.51 of the propeller Ka 4-70 in the nozzle 19A, K_T0 = 0.426 of the maker's workbook."""
    scale = t200.propeller.diameter_m * math.sqrt(1025.0 / 0.426)
    expected = (0.51 - math.pi / 16.0 * t200.propeller.stopped_drag) * scale
    assert t200.propeller.inflow_sqrtN_spm == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("u", "sign"), [(0.715, 1.0), (0.725, -1.0)])
def test_bluerov2_heavy_held_level_at_full_power_ends_at_the_measured_speed(
    load_vehicle: Callable[..., BodyParams], u: float, sign: float
) -> None:
    """About 0.72 m/s, with the thruster of the same paper (von Benzon et al.): below it still gains speed, above it loses some."""
    body: BodyParams = load_vehicle("bluerov2_heavy_von_benzon", density_kgpm3=1000.0, gravity_mps2=9.82)
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
