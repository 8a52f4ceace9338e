"""Runs side by side, and the figures that are read from them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from manoeuvre_rig import ROV, helm, vehicle

from uwserver.frames import quat_from_rpy
from uwserver.validation.manoeuvres.helm import DEPTH, Sticks
from uwserver.validation.manoeuvres.runs import (
    DT,
    Column,
    Row,
    Track,
    Trial,
    Waters,
    ahead,
    first_time,
    hold,
    steady_mean,
    still,
    then,
    turn_told,
)


def track(rpy: tuple[float, float, float], nu: tuple[float, ...], steps: int = 101) -> Track:
    states = np.zeros((steps, 13))
    states[:, 3:7], states[:, 7:] = quat_from_rpy(*rpy), nu
    return Track(0.1 * np.arange(steps), states)


def test_angles_and_rates_of_a_track() -> None:
    one = track((0.1, -0.2, 0.3), (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert (one.roll[0], one.pitch[0], one.heading[0]) == pytest.approx((0.1, -0.2, 0.3))
    assert math.cos(one.tilt[0]) == pytest.approx(math.cos(0.1) * math.cos(0.2))
    assert one.down[0] == pytest.approx(math.sin(0.2))
    assert (one.u[0], one.speed[0]) == pytest.approx((1.0, 1.0))


def test_a_heading_has_no_jump_and_the_way_is_seen_from_the_start() -> None:
    turning = track((0.0, 0.0, 0.0), (0.0,) * 6)
    angle = 3.0 + 0.02 * np.arange(101)
    turning.states[:, 3:7] = [quat_from_rpy(0.0, 0.0, a) for a in angle]
    np.testing.assert_allclose(turning.heading, angle)
    turning.states[:, :3] = np.outer(np.arange(101.0), [math.cos(3.0), math.sin(3.0), 0.0])
    np.testing.assert_allclose(turning.p[-1], [100.0, 0.0, 0.0], atol=1e-9)


def test_parts_of_a_track() -> None:
    one = track((0.0, 0.0, 0.0), (0.0,) * 6)
    assert one.since(4.0).t[[0, -1]].tolist() == pytest.approx([0.0, 6.0])
    assert one.until(4.0).t[[0, -1]].tolist() == pytest.approx([0.0, 4.0])
    assert len(one.steady.t) == 11


def test_each_run_has_its_own_plan_and_start(tmp_path: Path) -> None:
    waters = Waters(helm(tmp_path, ROV))
    assert not waters.floats
    ahead, idle, tilted = waters.sail(
        [hold(Sticks(surge=1.0)), still, still], 2.0, [(0.0,) * 3, (0.0,) * 3, (0.3, 0.0, 0.0)]
    )
    assert ahead.p[-1, 0] > 0.2
    assert abs(idle.p[-1, 0]) < 1e-9
    assert tilted.roll[0] == pytest.approx(0.3)
    assert ahead.states[0, 2] == DEPTH


def test_a_plan_follows_another_at_its_time(tmp_path: Path) -> None:
    asked: list[float] = []

    def second(t: float, _state: object) -> Sticks:
        asked.append(t)
        return Sticks()

    Waters(helm(tmp_path, ROV)).sail([then(Sticks(surge=1.0), 0.1, second)], 0.2)
    assert asked == pytest.approx([0.0, DT, 2 * DT, 3 * DT, 4 * DT], abs=1e-12)


def test_what_floats_starts_where_it_floats(tmp_path: Path) -> None:
    """A box of 50 kg that would displace 102.5: half of its 20 cm is under water."""
    raft = vehicle()
    raft["rigid_body"] = {**raft["rigid_body"], "mass_kg": 51.25}  # type: ignore[dict-item]
    waters = Waters(helm(tmp_path, raft))
    assert waters.floats
    assert waters.rest[2] == pytest.approx(0.0, abs=1e-3)
    assert not waters.rest[7:].any()


TRIAL = Trial(
    "turn",
    "Turn",
    "",
    (Column("a", "a", "m"), Column("b", "b", "s")),
    (Row("one", (1.0, None)), Row("two", (3.0, 4.0))),
)


@pytest.mark.parametrize(
    ("condition", "key", "value"), [("one", "a", 1.0), ("two", "b", 4.0), ("one", "b", None), ("three", "a", None), ("one", "c", None)]
)  # fmt: skip
def test_a_figure_is_found_by_condition_and_key(condition: str, key: str, value: float | None) -> None:
    assert TRIAL.value(condition, key) == value


def test_what_still_changes_has_no_steady_value() -> None:
    assert steady_mean(np.full(10, 2.0)) == 2.0
    assert steady_mean(np.linspace(1.0, 2.0, 10)) is None


def test_the_first_time_of_something() -> None:
    t = np.arange(5.0)
    assert first_time(t, t > 2.5) == 3.0
    assert first_time(t, t > 9.0) is None


def test_runs_are_called_by_what_is_asked() -> None:
    assert (ahead(0.3), ahead(-1.0)) == ("ahead 30 %", "astern 100 %")
    assert turn_told(0.55, math.radians(12.5)) == "ahead 55 %, rudder 12.5 degrees"
