"""Manoeuvres of vehicles with known coefficients."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from manoeuvre_rig import FINS, GLIDER, RAFT, ROV, TORPEDO, helm, vehicle

from uwserver.frames import quat_from_rpy
from uwserver.validation.manoeuvres import trials
from uwserver.validation.manoeuvres.runs import APPROACH_S, TURNING_S, Track, Trial, Waters

THRUST = 4.0 * 50.0 * math.sqrt(0.5)
"""N of four vectored thrusters of 50 N."""


@pytest.fixture
def rov(tmp_path: Path) -> Waters:
    return Waters(helm(tmp_path, ROV))


def terminal(force: float, quadratic: float) -> float:
    """Speed at which a linear drag of 1 N s/m and a quadratic one take up a force."""
    return (-1.0 + math.sqrt(1.0 + 4.0 * quadratic * force)) / (2.0 * quadratic)


@pytest.mark.parametrize("throttle", [0.3, 1.0])
def test_a_straight_run_ends_at_its_terminal_velocity(rov: Waters, throttle: float) -> None:
    found = trials.straight(rov)
    told = f"ahead {100 * throttle:g} %"
    # The thrust is 5 cm below the origin, where the centre of gravity is too, so the vehicle leans a little, and drags across.
    assert found.value(told, "steady") == pytest.approx(terminal(throttle * THRUST, 100.0), rel=0.1)
    tilt = found.value(told, "tilt")
    assert tilt is not None
    assert 0.0 < tilt < 0.6
    assert found.value("astern 100 %", "way") < 0.0  # type: ignore[operator]
    assert [row.condition for row in found.rows] == ["ahead 30 %", "ahead 60 %", "ahead 100 %", "astern 100 %"]


def test_a_torpedo_is_not_sent_astern(tmp_path: Path) -> None:
    assert [row.condition for row in trials.straight(Waters(helm(tmp_path, TORPEDO)), (1.0,)).rows] == ["ahead 100 %"]


def test_vertical_thrust_sinks_and_lifts(rov: Waters) -> None:
    found = trials.dive(rov)
    speed = terminal(100.0, 200.0)
    assert found.value("down 100 %", "sink") == pytest.approx(speed, rel=1e-3)
    assert found.value("up 100 %", "sink") == pytest.approx(-speed, rel=1e-3)


def test_planes_dive_and_rise(tmp_path: Path) -> None:
    found = trials.dive(Waters(helm(tmp_path, TORPEDO)))
    assert [row.condition for row in found.rows] == ["planes 5 degrees to dive", "planes 5 degrees to rise"]
    assert found.value("planes 5 degrees to dive", "depth") > 0.5  # type: ignore[operator]
    assert found.value("planes 5 degrees to rise", "pitch") > 0.0  # type: ignore[operator]


def test_ballast_sinks_and_lifts_and_a_glider_glides(tmp_path: Path) -> None:
    """Half a litre: 5 N against 200 kg/m of quadratic drag; 10 kg 10 cm forward against a righting arm of 5 cm."""
    waters = Waters(helm(tmp_path, GLIDER))
    found, glide = trials.dive(waters), trials.glide(waters)
    assert found.value("ballast as heavy as it gets", "sink") == pytest.approx(terminal(5.03, 200.0), rel=1e-2)
    pitch, angle = glide.value("down, mass forward", "pitch"), glide.value("down, mass forward", "angle")
    assert pitch == pytest.approx(-math.atan(10.0 * 0.1 / (102.5 * 0.05)), abs=0.02)
    assert angle is not None
    assert glide.value("down", "angle") == pytest.approx(math.pi / 2.0, abs=0.01), "level, it just sinks"
    assert 0.0 < -pitch < angle < math.pi / 2.0  # type: ignore[operator]
    assert glide.value("up, mass aft", "angle") == pytest.approx(-angle, abs=0.02)


def test_sideways(rov: Waters) -> None:
    assert trials.sway(rov).value("to starboard 100 %", "speed") == pytest.approx(terminal(THRUST, 200.0), rel=0.15)


def test_free_decay_has_the_period_and_damping_of_its_formula(rov: Waters) -> None:
    """I + added 15.25625 about the origin, righting moment 102.5 g 5 cm; damping by 5 N m s and its quadratic part, small."""
    found = trials.free_decay(rov)
    inertia, stiffness = 10.0 + 102.5 * 0.05**2 + 5.0, 102.5 * 9.81 * 0.05
    omega = math.sqrt(stiffness / inertia)
    # The centre of gravity is off the origin, so that a swing moves it too; the formula holds within a few percent.
    assert found.value("roll", "period") == pytest.approx(2.0 * math.pi / omega, rel=0.05)
    assert found.value("pitch", "ratio") == pytest.approx(5.0 / (2.0 * math.sqrt(stiffness * inertia)), rel=0.5)
    assert found.value("roll", "settle") > 0.0  # type: ignore[operator]


def test_what_creeps_back_has_no_period(tmp_path: Path) -> None:
    stiff = vehicle(
        damping={
            "linear": {
                "source": "made up for the test",
                "status": "guess",
                "diagonal": [1.0, 1.0, 1.0, 200.0, 200.0, 5.0],
            }
        }
    )
    found = trials.free_decay(Waters(helm(tmp_path, stiff)))
    assert found.value("roll", "period") is None
    assert found.value("roll", "settle") == pytest.approx(200.0 / (102.5 * 9.81 * 0.05), rel=0.1)


def test_a_stop_takes_time_and_way(rov: Waters) -> None:
    """From v0 by quadratic drag alone, to a tenth: m / (d v0) (10 - 1), over m / d ln 10; astern is quicker."""
    found = trials.stop(rov)
    coast, astern = (
        found.value(told, "way") for told in ("thrust off, to a tenth of the speed", "full astern, to a standstill")
    )
    assert coast == pytest.approx(152.5 / 100.0 * math.log(10.0), rel=0.15)
    assert astern is not None
    assert 0.0 < astern < coast  # type: ignore[operator]


def test_left_alone_a_light_vehicle_rises(tmp_path: Path) -> None:
    light = vehicle()
    light["rigid_body"] = {**light["rigid_body"], "mass_kg": 100.0}  # type: ignore[dict-item]
    found = trials.left_alone(Waters(helm(tmp_path, light)))
    assert found.value("hands off", "sink") == pytest.approx(-terminal(2.5 * 9.81, 200.0), rel=1e-2)


@pytest.mark.parametrize(
    ("trial", "reason"),
    [
        (trials.straight, "nothing pushes it ahead"),
        (trials.stop, "nothing pushes it ahead"),
        (trials.sway, "nothing pushes it sideways"),
        (trials.dive, "neither vertical thrust nor planes nor ballast"),
        (trials.glide, "no glider"),
    ],
)
def test_what_makes_no_sense_says_so(tmp_path: Path, trial: Callable[[Waters], Trial], reason: str) -> None:
    found = trial(Waters(helm(tmp_path, vehicle())))
    assert reason in found.reason
    assert found.rows == ()


def test_a_surface_vessel_does_not_dive(tmp_path: Path) -> None:
    raft = vehicle()
    raft["rigid_body"] = {**raft["rigid_body"], "mass_kg": 51.25}  # type: ignore[dict-item]
    assert "surface" in trials.dive(Waters(helm(tmp_path, raft))).reason


def circling(speed: float, radius: float) -> Track:
    """Straight ahead, then a circle to starboard."""
    t = np.arange(0.0, APPROACH_S + TURNING_S + 0.01, 0.02)
    s = np.maximum(t - APPROACH_S, 0.0) * speed
    psi = s / radius
    states = np.zeros((len(t), 13))
    states[:, 0] = speed * np.minimum(t, APPROACH_S) + radius * np.sin(psi)
    states[:, 1] = radius * (1.0 - np.cos(psi))
    states[:, 3:7] = [quat_from_rpy(0.0, 0.0, a) for a in psi]
    states[:, 7] = speed
    return Track(t, states)


def test_a_circle_has_its_diameter() -> None:
    before, advance, tactical, diameter, rate, speed, roll, sink = trials._circle(circling(1.5, 10.0))
    assert (before, speed) == (1.5, pytest.approx(1.5, rel=1e-3))
    assert (advance, tactical, diameter) == pytest.approx((10.0, 20.0, 20.0), rel=1e-2)
    assert rate == pytest.approx(0.15, rel=1e-3)
    assert (roll, sink) == pytest.approx((0.0, 0.0))


def test_a_rudder_turns_to_starboard_the_closer_the_larger(tmp_path: Path) -> None:
    found = trials.turning_circle(Waters(helm(tmp_path, TORPEDO)), [(1.0, math.radians(5.0))])
    assert [row.condition for row in found.rows] == ["ahead 100 %, rudder 15 degrees", "ahead 100 %, rudder 5 degrees"]
    wide, close = (found.value(f"ahead 100 %, rudder {angle} degrees", "diameter") for angle in (5, 15))
    assert wide is not None
    assert close is not None
    assert 0.0 < close < wide
    assert found.value("ahead 100 %, rudder 5 degrees", "rate") > 0.0  # type: ignore[operator]


def test_thrusters_turn_on_the_spot(tmp_path: Path) -> None:
    """Four thrusters of 50 N at an arm of 0.5 / sqrt 2 m, against 5 r + 10 r^2."""
    found = trials.turning_circle(Waters(helm(tmp_path, ROV)))
    moment = 4.0 * 50.0 * 0.5 / math.sqrt(2.0)
    expected = (-5.0 + math.sqrt(25.0 + 40.0 * moment)) / 20.0
    assert found.value("on the spot, yaw 100 %", "rate") == pytest.approx(expected, rel=1e-2)
    assert found.value("on the spot, yaw 100 %", "diameter") is None


def test_a_glider_turns_as_it_glides(tmp_path: Path) -> None:
    rudder = {"rudder": {**FINS["rudder"], "area_m2": 0.1}}
    found = trials.turning_circle(Waters(helm(tmp_path, GLIDER | {"fins": rudder})))
    assert [row.condition for row in found.rows] == ["gliding down, rudder 15 degrees"]
    assert found.rows[0].values[4] > 0.0  # type: ignore[operator]


def test_overshoots_are_read_from_the_heading() -> None:
    """A heading that swings by 14 degrees about an order of 10: 4 degrees beyond it to either side, every 20 s."""
    t = np.arange(0.0, APPROACH_S + TURNING_S + 0.01, 0.02)
    since = np.maximum(t - APPROACH_S, 0.0)
    states = np.zeros((len(t), 13))
    states[:, 3:7] = [quat_from_rpy(0.0, 0.0, math.radians(14.0) * math.sin(2.0 * math.pi * s / 20.0)) for s in since]
    _, execute, first, second, period = trials._overshoots(Track(t, states), math.radians(10.0))
    assert execute == pytest.approx(20.0 * math.asin(10.0 / 14.0) / (2.0 * math.pi), abs=0.03)
    assert (first, second) == (pytest.approx(math.radians(4.0), rel=1e-3),) * 2
    assert period == pytest.approx(20.0, abs=0.05)


@pytest.mark.parametrize(
    ("raw", "told"),
    [(TORPEDO, "ahead 100 %, rudder and heading 10 degrees"), (RAFT, "ahead 50 %, yaw 50 %, heading 20 degrees")],
)
def test_a_zig_zag_goes_to_and_fro(tmp_path: Path, raw: dict[str, object], told: str) -> None:
    found = trials.zig_zag(Waters(helm(tmp_path, raw)))
    assert found.rows[0].condition == told
    assert all(value is not None and value > 0.0 for value in found.rows[0].values)


def test_a_zig_zag_that_never_gets_there_has_no_figures() -> None:
    assert trials._overshoots(circling(1.0, 1e6), 0.2)[1:] == (None, None, None, None)


def test_vehicles_that_do_not_steer_say_so(tmp_path: Path) -> None:
    assert "neither rudder" in trials.turning_circle(Waters(helm(tmp_path, vehicle()))).reason
    assert "no rudder" in trials.zig_zag(Waters(helm(tmp_path, ROV))).reason
    assert "nothing pushes" in trials.zig_zag(Waters(helm(tmp_path, vehicle()))).reason
