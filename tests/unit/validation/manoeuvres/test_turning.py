"""Turning circles and zig-zags, by rudder and by two thrusters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from manoeuvre_rig import FINS, GLIDER, RAFT, ROV, TORPEDO, helm, vehicle

from uwserver.frames import quat_from_rpy
from uwserver.validation.manoeuvres import turning
from uwserver.validation.manoeuvres.figures import APPROACH_S, TURNING_S
from uwserver.validation.manoeuvres.runs import Track, Waters


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
    before, advance, tactical, diameter, rate, speed, roll, sink = turning._circle(circling(1.5, 10.0))
    assert (before, speed) == (1.5, pytest.approx(1.5, rel=1e-3))
    assert (advance, tactical, diameter) == pytest.approx((10.0, 20.0, 20.0), rel=1e-2)
    assert rate == pytest.approx(0.15, rel=1e-3)
    assert (roll, sink) == pytest.approx((0.0, 0.0))


def test_a_rudder_turns_to_starboard_the_closer_the_larger(tmp_path: Path) -> None:
    found = turning.turning_circle(Waters(helm(tmp_path, TORPEDO)), [(1.0, math.radians(5.0))])
    assert [row.condition for row in found.rows] == ["ahead 100 %, rudder 15 degrees", "ahead 100 %, rudder 5 degrees"]
    wide, close = (found.value(f"ahead 100 %, rudder {angle} degrees", "diameter") for angle in (5, 15))
    assert wide is not None
    assert close is not None
    assert 0.0 < close < wide
    assert found.value("ahead 100 %, rudder 5 degrees", "rate") > 0.0  # type: ignore[operator]


def test_thrusters_turn_on_the_spot(tmp_path: Path) -> None:
    """Four thrusters of 50 N at an arm of 0.5 / sqrt 2 m, against 5 r + 10 r^2."""
    found = turning.turning_circle(Waters(helm(tmp_path, ROV)))
    moment = 4.0 * 50.0 * 0.5 / math.sqrt(2.0)
    expected = (-5.0 + math.sqrt(25.0 + 40.0 * moment)) / 20.0
    assert found.value("on the spot, yaw 100 %", "rate") == pytest.approx(expected, rel=1e-2)
    assert found.value("on the spot, yaw 100 %", "diameter") is None


def test_a_glider_turns_as_it_glides(tmp_path: Path) -> None:
    rudder = {"rudder": {**FINS["rudder"], "area_m2": 0.1}}
    found = turning.turning_circle(Waters(helm(tmp_path, GLIDER | {"fins": rudder})))
    assert [row.condition for row in found.rows] == ["gliding down, rudder 15 degrees"]
    assert found.rows[0].values[4] > 0.0  # type: ignore[operator]


def test_overshoots_are_read_from_the_heading() -> None:
    """A heading that swings by 14 degrees about an order of 10: 4 degrees beyond it to either side, every 20 s."""
    t = np.arange(0.0, APPROACH_S + TURNING_S + 0.01, 0.02)
    since = np.maximum(t - APPROACH_S, 0.0)
    states = np.zeros((len(t), 13))
    states[:, 3:7] = [quat_from_rpy(0.0, 0.0, math.radians(14.0) * math.sin(2.0 * math.pi * s / 20.0)) for s in since]
    _, execute, first, second, period = turning._overshoots(Track(t, states), math.radians(10.0))
    assert execute == pytest.approx(20.0 * math.asin(10.0 / 14.0) / (2.0 * math.pi), abs=0.03)
    assert (first, second) == (pytest.approx(math.radians(4.0), rel=1e-3),) * 2
    assert period == pytest.approx(20.0, abs=0.05)


@pytest.mark.parametrize(
    ("raw", "told"),
    [(TORPEDO, "ahead 100 %, rudder and heading 10 degrees"), (RAFT, "ahead 50 %, yaw 50 %, heading 20 degrees")],
)
def test_a_zig_zag_goes_to_and_fro(tmp_path: Path, raw: dict[str, object], told: str) -> None:
    found = turning.zig_zag(Waters(helm(tmp_path, raw)))
    assert found.rows[0].condition == told
    assert all(value is not None and value > 0.0 for value in found.rows[0].values)


def test_a_zig_zag_that_never_gets_there_has_no_figures() -> None:
    assert turning._overshoots(circling(1.0, 1e6), 0.2)[1:] == (None, None, None, None)


def test_vehicles_that_do_not_steer_say_so(tmp_path: Path) -> None:
    assert "neither rudder" in turning.turning_circle(Waters(helm(tmp_path, vehicle()))).reason
    assert "no rudder" in turning.zig_zag(Waters(helm(tmp_path, ROV))).reason
    assert "nothing pushes" in turning.zig_zag(Waters(helm(tmp_path, vehicle()))).reason
