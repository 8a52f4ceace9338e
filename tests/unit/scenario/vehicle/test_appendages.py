"""From the tables of fins, propellers, ballast and hull to kernel parameters, in the scenario's water."""

# ruff: noqa: E501 - one case a line
from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from uwserver.physics.dynamics.appendage_params import Appendages
from uwserver.scenario.vehicle.appendage_tables import Foil
from uwserver.scenario.vehicle.appendages import TERM, appendages, lift_slope
from uwserver.scenario.vehicle.tables import VehicleFile
from uwserver.scenario.vehicle.wageningen import b4_70
from uwserver.scenario.world.tables import Environment
from uwserver.units import rad

SOURCE = {"source": "x", "status": "guess"}
FOIL = {**SOURCE, "position_frd_m": [-1, 0, 0], "hinge_frd": [0, 0, 1], "area_m2": 0.02, "aspect_ratio": 2.0}
FIN = {**FOIL, "limit_deg": 20, "rate_degps": 90, "time_constant_s": 0.1}
PROPELLER = {**SOURCE, "position_frd_m": [-1, 0, 0], "diameter_m": 0.2, "curve": [[0, 0.4, 0.05], [1, 0, 0]], "max_speed_radps": 100}  # fmt: skip
BALLAST = {**SOURCE, "position_frd_m": [0.5, 0, 0.1], "form": "bladder", "max_volume_m3": 0.001, "neutral_volume_m3": 0.0005, "rate_m3ps": 1e-5}  # fmt: skip
MASS = {**SOURCE, "mass_kg": 3, "axis_frd": [2, 0, 0], "min_position_m": -0.1, "max_position_m": 0.2, "rate_mps": 0.01}
WATER = Environment(density_kgpm3=1000.0, gravity_mps2=10.0)


@pytest.fixture
def made(raw_vehicle):
    def make(environment: Environment = WATER, **tables: Any) -> Appendages:
        return appendages(msgspec.convert({**raw_vehicle, **tables}, VehicleFile), environment)

    return make


def test_a_vehicle_without_them_has_none(made) -> None:
    assert made() == Appendages()


# -- servos -----------------------------------------------------------------------------------------------------------------------------


def test_servos_stand_in_the_order_of_the_tables(made) -> None:
    found = made(
        moving_masses={"m": MASS}, ballasts={"b": BALLAST}, propellers={"p": PROPELLER}, fins={"f": FIN, "g": FIN}
    )
    names = ["fins.f", "fins.g", "propellers.p", "ballasts.b", "moving_masses.m"]
    assert [servo.name for servo in found.servos] == names


def test_a_fin_turns_in_radians(made) -> None:
    (servo,) = made(fins={"f": FIN}).servos
    assert (servo.low, servo.high) == (pytest.approx(-rad(20)), pytest.approx(rad(20)))
    assert servo.rate == pytest.approx(rad(90))
    assert servo.tau == 0.1


def test_without_a_rate_a_servo_has_no_limit(made) -> None:
    slow = {key: value for key, value in FIN.items() if key != "rate_degps"}
    first, second = made(fins={"f": slow}, propellers={"p": PROPELLER}).servos
    assert first.rate == second.rate == math.inf


def test_a_shaft_turns_both_ways_and_a_pump_between_its_volumes(made) -> None:
    shaft, pump, slide = made(propellers={"p": PROPELLER}, ballasts={"b": BALLAST}, moving_masses={"m": MASS}).servos
    assert (shaft.low, shaft.high) == (-100.0, 100.0)
    assert (pump.low, pump.high, pump.rate, pump.neutral) == (0.0, 0.001, 1e-5, 0.0005)
    assert (slide.low, slide.high, slide.rate) == (-0.1, 0.2, 0.01)


# -- foils ------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "slope"),
    [
        ({"lift_slope_prad": 4.0}, 4.0),
        ({"lift_slope_prad": 4.0, "aspect_ratio": 2.0}, 4.0),
        ({"aspect_ratio": 2.0}, math.pi * 2.0 / (1.0 + math.sqrt(2.0))),
        ({"aspect_ratio": 1e9}, 2.0 * math.pi),
        ({"aspect_ratio": 1e-9}, 0.5 * math.pi * 1e-9),
    ],
)
def test_the_lift_slope_is_given_or_of_the_aspect_ratio(keys: dict[str, float], slope: float) -> None:
    """Thin aerofoil theory for a long wing, Jones's pi A / 2 for a slender one."""
    bare = {**SOURCE, "position_frd_m": [0, 0, 0], "hinge_frd": [0, 1, 0]}
    assert lift_slope(msgspec.convert({**bare, **keys}, Foil)) == pytest.approx(slope)


def test_fixed_foils_come_first_and_have_no_servo(made) -> None:
    fixed, fin = made(fins={"f": FIN}, foils={"wing": FOIL}).foils
    assert (fixed.servo, fin.servo) == ("", "fins.f")
    assert fixed.pressure_area == pytest.approx(0.5 * 1000 * 0.02)
    assert fixed.radius == pytest.approx(0.5 * math.sqrt(2.0 * 0.02))
    assert fixed.induced == pytest.approx(1.0 / (math.pi * 0.7 * 2.0))
    assert (fixed.stall, fixed.stall_end) == (pytest.approx(rad(15)), pytest.approx(rad(25)))


def test_a_fin_of_derivatives_alone_is_no_foil(made) -> None:
    found = made(fins={"f": {**FIN, "area_m2": 0.0, "derivatives": {"Yuud": 9.5}}})
    assert found.foils == ()
    assert len(found.servos) == len(found.derivatives) == 1


def test_span_and_inflow_of_a_foil(made) -> None:
    bare = {key: value for key, value in FOIL.items() if key != "aspect_ratio"}
    foil = {**bare, "span_m": 0.6, "inflow": "speed", "lift_slope_prad": 3}
    (found,) = made(foils={"wing": foil}).foils
    assert (found.radius, found.whole, found.induced, found.slope) == (0.3, True, 0.0, 3.0)
    assert not made(foils={"wing": FOIL}).foils[0].whole


# -- propellers and weights -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("handedness", "sense"), [("right", -1.0), ("left", 1.0), ("none", 0.0)])
def test_a_propeller(handedness: str, sense: float, made) -> None:
    table = {**PROPELLER, "handedness": handedness, "wake_fraction": 0.2, "thrust_deduction": 0.1, "inflow": "speed"}
    (found,) = made(propellers={"p": table}).propellers
    assert (found.servo, found.density, found.diameter) == ("propellers.p", 1000.0, 0.2)
    assert (found.wake, found.deduction) == (pytest.approx(0.8), pytest.approx(0.9))
    assert (found.sense, found.whole) == (sense, True)
    assert found.curve == ((0.0, 0.4, 0.05), (1.0, 0.0, 0.0))


def test_a_propeller_with_a_curve_has_no_series_and_one_without_is_a_b4_70(made) -> None:
    bare = {key: value for key, value in PROPELLER.items() if key != "curve"}
    (curve,) = made(propellers={"p": PROPELLER}).propellers
    assert (curve.curve, curve.series) == (((0.0, 0.4, 0.05), (1.0, 0.0, 0.0)), ())
    for keys, series in (
        ({}, b4_70(1.0)),
        ({"pitch_ratio": 0.7}, b4_70(0.7)),
        ({"quadrants": [[0, 0, 0, 0], [0, -0.7, 0, -0.1]]}, ((0.0, 0.0, 0.0, 0.0), (0.0, -0.7, 0.0, -0.1))),
    ):
        (found,) = made(propellers={"p": {**bare, **keys, "damping_includes_stopped": True}}).propellers
        assert (found.curve, found.series, found.damping_includes_stopped) == ((), series, True)


@pytest.mark.parametrize(("form", "sign", "displaces"), [("bladder", -1.0, True), ("tank", 1.0, False)])
def test_a_bladder_lifts_and_a_tank_sinks(form: str, sign: float, displaces: bool, made) -> None:
    (found,) = made(ballasts={"b": {**BALLAST, "form": form}}).weights
    assert found.force == pytest.approx(sign * 1000.0 * 10.0)
    assert found.moment == pytest.approx((0.5 * found.force, 0.0, 0.1 * found.force))
    assert found.displaces is displaces


def test_a_moving_mass_moves_its_weight_along_the_axis(made) -> None:
    (found,) = made(moving_masses={"m": MASS}).weights
    assert found.force == 0.0
    assert found.moment == pytest.approx((30.0, 0.0, 0.0)), "m g, whatever the length of the axis"


# -- derivatives and hull ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "fits"), [("Yuud", True), ("Nuv", True), ("Kpp", True), ("Yuudd", True), ("Yuuddd", False), ("Yu", False), ("Auv", False), ("Yud", False), ("yuv", False)])  # fmt: skip
def test_names_of_derivatives(name: str, fits: bool) -> None:
    assert bool(TERM.fullmatch(name)) is fits


def test_derivatives_scale_with_the_density_and_zeros_are_left_out(made) -> None:
    terms = {**SOURCE, "terms": {"Yur": 5.0, "Nuv": 0.0}, "reference_density_kgpm3": 500.0}
    fin = {**FIN, "derivatives": {"Yuud": 9.5, "Xuudd": -1.0, "Muw": 2.0}, "reference_density_kgpm3": 1000.0}
    found = made(hull={"derivatives": terms}, fins={"f": fin}).derivatives
    assert [(d.axis, d.j, d.k, d.coefficient, d.servo, d.power) for d in found] == [
        (1, 0, 5, pytest.approx(10.0), "", 0),
        (1, 0, 0, pytest.approx(9.5), "fins.f", 1),
        (0, 0, 0, pytest.approx(-1.0), "fins.f", 2),
        (4, 0, 2, pytest.approx(2.0), "", 0),
    ]


def test_cross_flow_and_slow_damping_of_the_hull(made) -> None:
    cross = {
        **SOURCE,
        "length_m": 1.5,
        "height_m": 0.2,
        "width_m": 0.3,
        "sway_drag": 1.0,
        "heave_drag": 0.5,
        "joint": True,
    }
    slow = {**SOURCE, "diagonal": [1, 2, 3, 4, 5, 6], "fading_mps": 0.5}
    damping, drag = made(hull={"cross_flow": cross, "slow_damping": slow}).hulls
    assert damping.slow == pytest.approx([k * 1000.0 / 1025.0 for k in range(1, 7)])
    assert damping.fade == 2.0
    assert (drag.length, drag.strips, drag.joint) == (1.5, 20, True)
    assert (drag.sway, drag.heave) == (pytest.approx(0.5 * 1000 * 0.2), pytest.approx(0.5 * 1000 * 0.5 * 0.3))
