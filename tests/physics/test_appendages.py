"""Fins, propellers, ballast and hull terms in the kernel, each against its formula written out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from uwserver_bench.proofs.motion import record

from uwserver.frames import quat_from_rpy
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.appendage_params import (
    Appendages,
    DerivativeParams,
    FoilParams,
    HullParams,
    PropellerParams,
    ServoParams,
    WeightParams,
    quadrant_coefficients,
)
from uwserver.physics.dynamics.params import BodyParams, BuoyancyShape
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU, Q
from uwserver.scenario.vehicle.wageningen import b4_70

RHO = 1025.0
NU0 = np.array([1.4, -0.3, 0.2, 0.2, -0.1, 0.3])

FOIL = FoilParams("s", (-0.8, 0.1, 0.05), (0, 1, 0), (1, 0, 0), 0.5 * RHO * 0.02, 3.0, 0.1, 0.02, 1.2, 0.3, 0.4)  # fmt: skip
SERVO = ServoParams("s", -0.5, 0.5)
SHAFT = ServoParams("shaft", -200.0, 200.0)
CURVE = ((0.0, 0.45, 0.07), (0.4, 0.3, 0.05), (0.8, 0.1, 0.02))
PROPELLER = PropellerParams("shaft", (-0.9, 0.0, 0.0), (1.0, 0.0, 0.0), 0.14, RHO, CURVE, 0.9, 0.85, 0.8, -1.0)


def fixed(appendages: Appendages, **changes: object) -> BodyParams:
    """A body so heavy that no force moves it."""
    eye, zero = 1e12 * np.eye(6), np.zeros((6, 6))
    body = BodyParams(eye, zero, zero, zero, zero, 0.0, 0.0, (0.0,) * 3, (0.0,) * 3, appendages=appendages)
    return replace(body, **changes)  # type: ignore[arg-type]


def world(
    appendages: Appendages, nu: FloatArray = NU0, value: float = 0.0, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Hydrodynamics:
    hydro = Hydrodynamics([fixed(appendages)], 0.01)
    hydro.state[0, 2] = 20.0
    hydro.state[0, Q : Q + 4] = quat_from_rpy(*rpy)
    hydro.state[0, NU : NU + 6] = nu
    hydro.servos["value"] = value
    return hydro


def actuated(*args: object, **kwargs: object) -> FloatArray:
    """Wrench (6) of what servos move."""
    wrench: FloatArray = world(*args, **kwargs).rates_of_change(0.0)[1][0]  # type: ignore[arg-type]
    return wrench


def actuated_at(hydro: Hydrodynamics, u: float, speed: float) -> FloatArray:
    """The same at a surge (m/s) and shaft speed (rad/s), of a world that is there."""
    hydro.state[0, NU:], hydro.servos["value"] = (u, 0, 0, 0, 0, 0), speed
    wrench: FloatArray = hydro.rates_of_change(0.0)[1][0]
    return wrench


def passive(*args: object, **kwargs: object) -> FloatArray:
    """Wrench (6) of the hull: M_RB times the acceleration, without the body's own Coriolis forces."""
    bare = world(Appendages(), *args[1:], **kwargs)  # type: ignore[arg-type]
    nu_dot, tau = world(*args, **kwargs).rates_of_change(0.0)  # type: ignore[arg-type]
    wrench: FloatArray = 1e12 * (nu_dot - bare.rates_of_change(0.0)[0])[0] - tau[0]
    return wrench


@pytest.mark.parametrize(("rate", "tau"), [(0.4, 0.0), (math.inf, 0.15), (0.8, 0.2), (math.inf, 0.0), (0.0, 0.1)])
def test_servo_is_a_rate_limited_first_order_lag(rate: float, tau: float) -> None:
    """From 0 to 0.5: straight until the error is rate tau, then exponential."""
    hydro = Hydrodynamics([fixed(Appendages((ServoParams("s", -0.7, 0.7, rate, tau),)))], 0.03)
    hydro.servos["command"] = 0.5
    for k in range(1, 60):
        hydro.advance(0.0)
        t = 0.03 * k
        bend = min(0.5, rate * tau) if tau else 0.0
        straight = (0.5 - bend) / rate if rate else math.inf
        if t < straight:
            expected = rate * t
        else:
            expected = 0.5 - (bend * math.exp(-(t - straight) / tau) if tau else 0.0)
        assert hydro.servos["value"][0] == pytest.approx(expected, abs=1e-14)


def test_servo_stops_at_its_limits_and_starts_at_its_neutral() -> None:
    hydro = Hydrodynamics([fixed(Appendages((ServoParams("s", -0.1, 0.3, 5.0, 0.0, 0.2),)))], 0.1)
    assert hydro.servos["value"][0] == 0.2
    for command, expected in ((9.0, 0.3), (-9.0, -0.1)):
        hydro.servos["command"] = command
        hydro.advance(0.0)
        assert hydro.servos["value"][0] == expected


def test_servo_does_not_depend_on_substeps() -> None:
    """Fast damping cuts the tick; the exact law gives the same angle."""
    values = []
    for damping in (1e12, 5e14):
        D = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, damping])
        hydro = Hydrodynamics([fixed(Appendages((ServoParams("s", -1.0, 1.0, 3.0, 0.1),)), D_L=D)], 0.02)
        hydro.servos["command"] = 0.8
        for _ in range(20):
            hydro.advance(0.0)
        values.append(hydro.servos["value"][0])
    assert values[1] == pytest.approx(values[0], rel=1e-12)


def foil_wrench(foil: FoilParams, nu: FloatArray, angle: float) -> FloatArray:
    """Lift square to the flow in the plane of chord and normal, drag against it; by vectors, without angles of the kernel."""
    chord, normal = np.array(foil.chord, float), np.cross(foil.hinge, foil.chord)
    v = nu[:3] + np.cross(nu[3:], foil.r)
    v_plane = v @ chord * chord + v @ normal * normal
    turned = math.cos(angle) * chord + math.sin(angle) * normal
    across = np.cross(foil.hinge, turned)
    alpha = math.atan2(-(v @ across), v @ turned)
    attached = min(1.0, max(0.0, (foil.stall_end - abs(alpha)) / (foil.stall_end - foil.stall)))
    lift = attached * foil.slope * alpha + (1.0 - attached) * foil.cd90 * math.sin(alpha) * math.cos(alpha)
    drag = (
        foil.cd0
        + attached * foil.induced * (foil.slope * alpha) ** 2
        + (1.0 - attached) * foil.cd90 * math.sin(alpha) ** 2
    )
    speed = np.linalg.norm(v_plane)
    flow = v_plane / speed
    force = foil.pressure_area * speed**2 * (lift * np.cross(foil.hinge, flow) - drag * flow)
    return np.concatenate([force, np.cross(foil.r, force)])


@pytest.mark.parametrize("angle", [0.0, 0.1, -0.2, 0.4, -0.5])
@pytest.mark.parametrize("u", [1.4, 0.3, -0.8])
@pytest.mark.parametrize("hinge", [(0, 1, 0), (0, 0, -1), (0, 1, 1)])
def test_foil_at_any_angle_of_attack(angle: float, u: float, hinge: tuple[int, int, int]) -> None:
    """Attached, in the blend, stalled, and backwards; rotation of the body counts in the inflow."""
    axis = np.array(hinge) / np.linalg.norm(hinge)
    foil = replace(FOIL, hinge=tuple(axis))
    nu = np.array([u, *NU0[1:]])
    expected = foil_wrench(foil, nu, angle)
    np.testing.assert_allclose(actuated(Appendages((SERVO,), (foil,)), nu, angle), expected, rtol=1e-12, atol=1e-12)


def test_foil_ahead_lifts_by_its_slope_towards_its_normal() -> None:
    """u = 2 m/s, 0.1 rad: L = rho A / 2 u^2 slope 0.1, upwards and so nose down for a stern plane hinged on +y."""
    tau = actuated(Appendages((SERVO,), (FOIL,)), np.array([2.0, 0, 0, 0, 0, 0]), 0.1)
    lift = 0.5 * RHO * 0.02 * 4.0 * 0.3
    assert tau[2] == pytest.approx(-lift)
    assert tau[4] == pytest.approx(-0.8 * lift + 0.05 * tau[0])
    assert tau[0] == pytest.approx(-0.5 * RHO * 0.02 * 4.0 * (0.02 + 0.1 * 0.3**2))


def test_foil_across_the_flow_is_a_plate() -> None:
    tau = actuated(Appendages((SERVO,), (replace(FOIL, r=(0.0, 0.0, 0.0)),)), np.array([0, 0, 1.5, 0, 0, 0]), 0.0)
    np.testing.assert_allclose(tau, [0, 0, -0.5 * RHO * 0.02 * 2.25 * 1.22, 0, 0, 0], atol=1e-12)


def test_a_fixed_foil_is_the_hulls_and_a_whole_one_feels_the_span() -> None:
    foil = replace(FOIL, servo="")
    np.testing.assert_allclose(passive(Appendages(foils=(foil,))), foil_wrench(foil, NU0, 0.0), rtol=1e-3, atol=1e-3)
    nu = np.array([1.0, 0.6, 0.0, 0.0, 0.0, 0.0])
    narrow, whole = (actuated(Appendages((SERVO,), (replace(FOIL, whole=w),)), nu, 0.1) for w in (False, True))
    np.testing.assert_allclose(whole, 1.36 * narrow)


def test_foil_feels_the_current() -> None:
    hydro = world(Appendages((SERVO,), (FOIL,)), np.zeros(6), 0.1)
    hydro.currents[0] = -1.5, 0.4, 0.0
    expected = foil_wrench(FOIL, np.array([1.5, -0.4, 0, 0, 0, 0]), 0.1)
    np.testing.assert_allclose(hydro.rates_of_change(0.0)[1][0], expected, rtol=1e-12)


def test_efficiency_scales_foil_and_propeller() -> None:
    for appendages, value in (
        (Appendages((SERVO,), (FOIL,)), 0.2),
        (Appendages((SHAFT,), propellers=(PROPELLER,)), 90.0),
    ):
        hydro = world(appendages, value=value)
        whole = hydro.rates_of_change(0.0)[1][0]
        hydro.servos["efficiency"] = 0.25
        np.testing.assert_allclose(hydro.rates_of_change(0.0)[1][0], 0.25 * whole, rtol=1e-13)


def test_foil_and_propeller_lose_their_force_in_the_air() -> None:
    shape = BuoyancyShape(1, (0.0, 0.0, 0.0), (0.5, 0.0, 0.0), 0.5)
    appendages = Appendages((SERVO, SHAFT), (replace(FOIL, r=(0, 0.3, 0)),), (replace(PROPELLER, r=(0, 0.3, 0)),))
    wrenches = []
    for depth in (5.0, 0.0, -0.2):
        hydro = Hydrodynamics([fixed(appendages, shapes=(shape,))], 1e-6)
        hydro.state[0, 2], hydro.state[0, NU] = depth, 1.0
        hydro.servos["value"] = 0.2, 90.0
        wrenches.append(hydro.rates_of_change(0.0)[1][0])
    np.testing.assert_allclose(wrenches[1], 0.5 * wrenches[0])
    assert not wrenches[2].any()


@pytest.mark.parametrize("rpm", [1500.0, 300.0, 10.0])
@pytest.mark.parametrize("u", [0.0, 0.5, 1.5, 3.0])
def test_propeller_follows_its_open_water_curves(rpm: float, u: float) -> None:
    n, D = rpm / 60.0, 0.14
    J = 0.9 * u / (n * D)
    J_s, KT_s, KQ_s = np.array(CURVE).T
    k = 0 if J < 0.4 else 1
    KT = KT_s[k] + (KT_s[k + 1] - KT_s[k]) / 0.4 * (J - J_s[k])
    KQ = KQ_s[k] + (KQ_s[k + 1] - KQ_s[k]) / 0.4 * (J - J_s[k])
    tau = actuated(Appendages((SHAFT,), propellers=(PROPELLER,)), np.array([u, 0, 0, 0, 0, 0]), 2 * math.pi * n)
    assert tau[0] == pytest.approx(0.85 * RHO * n**2 * D**4 * KT, rel=1e-12)
    assert tau[3] == pytest.approx(-RHO * n**2 * D**5 * KQ, rel=1e-12)


def test_propeller_astern_is_its_mirror_and_at_rest_there_is_none() -> None:
    appendages = Appendages((SHAFT,), propellers=(PROPELLER,))
    ahead, astern = (actuated(appendages, np.array([s * 0.7, 0, 0, 0, 0, 0]), s * 120.0) for s in (1.0, -1.0))
    np.testing.assert_allclose(astern, -0.8 * ahead)
    assert not actuated(appendages, NU0, 0.0).any()


@pytest.mark.parametrize("speed", [150.0, -150.0])
def test_by_its_curves_thrust_falls_with_inflow_beyond_their_quadrant_too(speed: float) -> None:
    """Ahead and astern, with and against the water: more speed along the axis is always less thrust along it. An extrapolation."""
    appendages = Appendages((SHAFT,), propellers=(PROPELLER,))
    thrust = [actuated(appendages, np.array([u, 0, 0, 0, 0, 0]), speed)[0] for u in np.linspace(-3.0, 3.0, 25)]
    assert np.all(np.diff(thrust) < 0.0)
    assert np.sign(thrust[12]) == np.sign(speed)


def four_quadrants(**changes: object) -> Appendages:
    """The Wageningen B4-70 of pitch ratio 1 in place of the curves."""
    return Appendages((SHAFT,), propellers=(replace(PROPELLER, curve=(), series=b4_70(1.0), **changes),))  # type: ignore[arg-type]


def test_in_four_quadrants_no_shaft_gives_the_body_more_than_it_takes() -> None:
    """Thrust along the way and the reaction of the torque, at random speeds of shaft and body: P = Q omega - T u >= 0, also of a windmill."""
    rng = np.random.default_rng(5)
    hydro = world(four_quadrants(wake=1.0, deduction=1.0))
    for _ in range(300):
        u, speed = float(rng.uniform(-3.0, 3.0)), float(rng.uniform(-200.0, 200.0))
        tau = actuated_at(hydro, u, speed)
        assert -tau[3] * speed - tau[0] * u > 0.0


def test_a_stopped_propeller_brakes_a_body_unless_its_damping_has_that() -> None:
    """Alone with its drag c u|u|, u = u0 / (1 + c u0 t / m)."""
    m, u0 = 40.0, 1.5
    ends = []
    for included in (False, True):
        propeller = four_quadrants(damping_includes_stopped=included, sense=0.0)
        hydro = Hydrodynamics([fixed(propeller, M_RB=m * np.eye(6))], 0.01)
        hydro.state[0, 2], hydro.state[0, NU] = 50.0, u0
        record(hydro, 4.0)
        ends.append(hydro.state[0, NU])
    stopped = quadrant_coefficients(b4_70(1.0), np.array([0.5 * math.pi]))[0, 0]
    c = -0.85 * 0.9**2 * RHO * math.pi / 8.0 * 0.14**2 * stopped
    assert ends[0] == pytest.approx(u0 / (1.0 + c * u0 * 4.0 / m), rel=1e-8)
    assert ends[1] == u0


def test_a_reversed_shaft_stops_a_body_sooner_than_a_stopped_one_and_then_drives_it_astern() -> None:
    tracks = {}
    for command in (0.0, -120.0):
        hydro = Hydrodynamics([fixed(four_quadrants(sense=0.0), M_RB=40.0 * np.eye(6))], 0.01)
        hydro.state[0, 2], hydro.state[0, NU] = 50.0, 1.5
        hydro.servos["command"] = command
        tracks[command] = record(hydro, 6.0)[1][:, 0, NU]
    assert (tracks[-120.0][10:] < tracks[0.0][10:]).all()
    assert tracks[0.0][-1] > 0.0 > tracks[-120.0][-1]


def test_the_bound_of_the_damping_s_rate_holds_for_a_propeller_in_four_quadrants() -> None:
    """By differences of the thrust over the speed ahead, against `rate_L + rate_Q |nu|` of a body of 1 kg."""
    appendages = four_quadrants(deduction=1.0)
    row = Hydrodynamics([fixed(appendages, M_RB=np.eye(6))], 0.01).bodies[0]
    hydro = world(appendages)
    for speed in np.linspace(-200.0, 200.0, 21):
        for u in np.linspace(-4.0, 4.0, 33):
            low, high = (actuated_at(hydro, u + d, speed)[0] for d in (-1e-4, 1e-4))
            assert abs(high - low) / 2e-4 <= 1.001 * (row["rate_L"] + row["rate_Q"][0] * abs(u))


def test_a_crash_stop_keeps_its_accuracy_at_half_the_rate() -> None:
    """Through n = 0, and then through V_a = 0."""
    servos = (replace(SHAFT, tau=0.5),)
    appendages = replace(four_quadrants(sense=0.0), servos=servos)
    finals = []
    for rate in (60, 120, 240):
        hydro = Hydrodynamics([fixed(appendages, M_RB=40.0 * np.eye(6))], 1.0 / rate)
        hydro.state[0, 2], hydro.state[0, NU] = 50.0, 1.0
        hydro.servos["value"], hydro.servos["command"] = 60.0, -80.0
        record(hydro, 6.0)
        finals.append(hydro.state[0, 0])
    assert abs(finals[1] - finals[2]) < 1e-8


def test_propeller_sees_rotation_whole_speed_and_off_axis_mount() -> None:
    off = replace(PROPELLER, r=(-0.5, 0.4, 0.0), sense=0.0)
    turning = actuated(Appendages((SHAFT,), propellers=(off,)), np.array([1.0, 0, 0, 0, 0, 0.5]), 100.0)
    slower = actuated(Appendages((SHAFT,), propellers=(off,)), np.array([0.8, 0, 0, 0, 0, 0]), 100.0)
    np.testing.assert_allclose(turning, slower, rtol=1e-12)
    assert turning[5] == pytest.approx(-0.4 * turning[0])
    whole = replace(PROPELLER, whole=True)
    tau = actuated(Appendages((SHAFT,), propellers=(whole,)), np.array([0.6, 0.8, 0, 0, 0, 0]), 100.0)
    straight = actuated(Appendages((SHAFT,), propellers=(PROPELLER,)), np.array([1.0, 0, 0, 0, 0, 0]), 100.0)
    np.testing.assert_allclose(tau, straight, rtol=1e-12)


def test_weights_are_buoyancy_at_a_place_and_a_moment() -> None:
    """A bladder of 1 litre at r lifts 10 N; a sliding mass of 20 kg, 3 cm forward, turns the nose down."""
    bladder = WeightParams("b", -1e4, (-1e4 * 0.5, 0.0, -1e4 * 0.1))
    mass = WeightParams("m", 0.0, (20.0 * 9.81, 0.0, 0.0))
    servos = (ServoParams("b", 0.0, 1e-2, neutral=1e-3), ServoParams("m", -0.1, 0.1))
    roll, pitch = 0.4, -0.3
    hydro = world(Appendages(servos, weights=(bladder, mass)), rpy=(roll, pitch, 0.7))
    hydro.servos["value"] = 2e-3, 0.03
    down = np.array([-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)])
    lift = -10.0 * down
    moment = np.cross([0.5, 0.0, 0.1], lift) + np.cross([0.03, 0.0, 0.0], 20.0 * 9.81 * down)
    np.testing.assert_allclose(hydro.rates_of_change(0.0)[1][0], [*lift, *moment], rtol=1e-12, atol=1e-12)


def test_a_bladder_in_the_air_lifts_nothing_but_a_tank_still_weighs() -> None:
    shape = BuoyancyShape(1, (0.0, 0.0, 0.0), (0.5, 0.0, 0.0), 0.5)
    for displaces, expected in ((True, 0.0), (False, -10.0)):
        weights = (WeightParams("s", -1e4, (0.0, 0.0, 0.0), displaces),)
        hydro = Hydrodynamics([fixed(Appendages((SERVO,), weights=weights), shapes=(shape,))], 1e-6)
        hydro.state[0, 2] = -2.0
        hydro.servos["value"] = 1e-3
        assert hydro.rates_of_change(0.0)[1][0, 2] == pytest.approx(expected)


def test_a_bladder_raises_a_neutral_body_at_its_terminal_velocity() -> None:
    """1 litre in 1 s at the limit of the rate, then 10 N against linear damping."""
    eye = np.eye(6)
    servos = (ServoParams("b", 0.0, 1e-2, rate=1e-3),)
    body = BodyParams(
        30.0 * eye, 30.0 * eye, 50.0 * eye, 0.0 * eye, 0.0 * eye, 300.0, 300.0, (0.0,) * 3, (0.0,) * 3,
        appendages=Appendages(servos, weights=(WeightParams("b", -1e4, (0.0, 0.0, 0.0)),)),
    )  # fmt: skip
    hydro = Hydrodynamics([body], 0.01)
    hydro.state[0, 2] = 100.0
    hydro.servos["command"] = 1e-3
    record(hydro, 1.0)
    assert hydro.servos["value"][0] == pytest.approx(1e-3)
    record(hydro, 40.0)
    assert hydro.state[0, NU + 2] == pytest.approx(-10.0 / 50.0, rel=1e-9)


def test_derivatives_are_a_polynomial_of_the_velocity_and_the_angle() -> None:
    rng = np.random.default_rng(3)
    terms = [tuple(int(x) for x in rng.integers(0, 6, 3)) for _ in range(12)]
    coefficients = rng.normal(size=12)
    powers = [k % 3 for k in range(12)]
    derivatives = tuple(
        DerivativeParams(*term, c, "s" if power else "", power)
        for term, c, power in zip(terms, coefficients, powers, strict=True)
    )
    # Large coefficients, so that the difference of accelerations of so heavy a body keeps its digits.
    big = tuple(replace(d, coefficient=1e9 * d.coefficient) for d in derivatives)
    hull, fins = np.zeros(6), np.zeros(6)
    for (axis, j, k), c, power in zip(terms, coefficients, powers, strict=True):
        (fins if power else hull)[axis] += c * NU0[j] * NU0[k] * 0.3**power
    np.testing.assert_allclose(actuated(Appendages((SERVO,), derivatives=derivatives), value=0.3), fins, atol=1e-12)
    np.testing.assert_allclose(
        passive(Appendages((SERVO,), derivatives=big), value=0.3), 1e9 * hull, rtol=1e-9, atol=1.0
    )


def strips(joint: bool, n: int) -> Appendages:
    return Appendages(hulls=(HullParams(length=2.0, center=0.1, strips=n, sway=4e10, heave=6e10, joint=joint),))


def test_cross_flow_drag_of_pure_sway_and_of_pure_yaw() -> None:
    """k L v|v|; in yaw about the middle k r|r| L^4 / 32."""
    sway = passive(strips(False, 200), np.array([0, -0.5, 0, 0, 0, 0]))
    np.testing.assert_allclose(sway, [0, 4e10 * 2 * 0.25, 0, 0, 0, 4e10 * 2 * 0.25 * 0.1], rtol=1e-6, atol=1e3)
    turn = passive(
        Appendages(hulls=(replace(strips(False, 200).hulls[0], center=0.0),)), np.array([0, 0, 0, 0, 0, 0.8])
    )
    assert turn[5] == pytest.approx(-4e10 * 0.64 * 2.0**4 / 32.0, rel=1e-3)
    assert abs(turn[1]) < 1e3


@pytest.mark.parametrize("joint", [False, True])
def test_cross_flow_drag_is_the_sum_over_the_strips(joint: bool) -> None:
    _, v, w, _, q, r = NU0
    expected = np.zeros(6)
    for x in 0.1 - 1.0 + (np.arange(20) + 0.5) * 0.1:
        sway, heave = v + x * r, w - x * q
        if joint:
            drag = (4e10 * sway**2 + 6e10 * heave**2) / math.hypot(sway, heave)
            Y, Z = -drag * sway * 0.1, -drag * heave * 0.1
        else:
            Y, Z = -4e10 * abs(sway) * sway * 0.1, -6e10 * abs(heave) * heave * 0.1
        expected += [0, Y, Z, 0, -x * Z, x * Y]
    np.testing.assert_allclose(passive(strips(joint, 20)), expected, rtol=1e-6, atol=1e3)


def test_slow_damping_fades_with_the_speed_through_the_water() -> None:
    slow = tuple(1e10 * k for k in range(1, 7))
    nu_r = NU0 - np.array([0.5, 0, 0, 0, 0, 0])
    hydro, bare = world(Appendages(hulls=(HullParams(slow, fade=3.0),))), world(Appendages())  # type: ignore[arg-type]
    for each in (hydro, bare):
        each.currents[0] = 0.5, 0.0, 0.0
    force = 1e12 * (hydro.rates_of_change(0.0)[0] - bare.rates_of_change(0.0)[0])[0]
    np.testing.assert_allclose(force, -np.array(slow) * nu_r * math.exp(-3.0 * np.linalg.norm(nu_r[:3])), rtol=1e-6)


def test_a_run_with_fin_and_propeller_keeps_its_accuracy_at_half_the_rate() -> None:
    """Angles and shaft speed are exact at the stage times: the step stays of fourth order, seen at 0.2 s before the stall."""
    eye = np.eye(6)
    foil = replace(FOIL, stall=4.0, stall_end=5.0)
    servos = (replace(SERVO, tau=0.5), replace(SHAFT, tau=1.0))
    body = BodyParams(
        30.0 * eye, 20.0 * eye, 5.0 * eye, 0.0 * eye, 0.0 * eye, 300.0, 300.0, (0.0, 0.0, 0.02), (0.0,) * 3,
        appendages=Appendages(servos, (foil,), (PROPELLER,)),
    )  # fmt: skip
    finals = []
    for rate in (10, 20, 40):
        hydro = Hydrodynamics([body], 1.0 / rate)
        hydro.state[0, 2], hydro.state[0, NU] = 50.0, 1.0
        hydro.servos["command"] = 0.3, 100.0
        _, states = record(hydro, 6.0)
        finals.append(states[-1, 0, :3])
    coarse, fine = np.linalg.norm(finals[0] - finals[1]), np.linalg.norm(finals[1] - finals[2])
    assert coarse / fine > 12.0
    assert fine < 1e-5


def test_a_body_with_appendages_leaves_its_neighbours_alone() -> None:
    bare = fixed(Appendages(), M_RB=np.eye(6))
    alone = Hydrodynamics([bare], 0.01)
    both = Hydrodynamics([fixed(Appendages((SHAFT,), propellers=(PROPELLER,)), M_RB=np.eye(6)), bare], 0.01)
    both.servos["command"] = 100.0
    for hydro in (alone, both):
        hydro.state[-1, NU : NU + 6] = NU0
        record(hydro, 0.5)
    np.testing.assert_array_equal(both.state[1], alone.state[0])
    assert both.state[0, NU] > 0.1
