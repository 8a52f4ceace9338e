"""Oracle files of any content: sample times off the ticks, exact solutions, both wrench frames, and refusals that name what is wrong."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwserver.validation.oracle import FORMAT, validate

ZERO = np.zeros((6, 6)).tolist()


def oracle(**changes: Any) -> dict[str, Any]:
    """A body of 10 kg and 5 kg of added mass in surge against linear damping of 3 N s/m: u = (F/d)(1 - exp(-d t/m))."""
    inertia, drag, force = 15.0, 3.0, 6.0
    times = [0.0, 0.1, 0.7301, math.pi, 9.9]
    states = []
    for t in times:
        fall = math.exp(-drag * t / inertia)
        u = force / drag * (1.0 - fall)
        x = force / drag * (t - inertia / drag * (1.0 - fall))
        states.append([x, 0, 5, 1, 0, 0, 0, u, 0, 0, 0, 0, 0])
    data = {
        "format": FORMAT,
        "weight_N": 98.1,
        "buoyancy_N": 98.1,
        "r_g_B": [0, 0, 0],
        "r_b_B": [0, 0, 0],
        "M_RB": np.diag([10.0] * 6).tolist(),
        "M_A": np.diag([5.0] * 6).tolist(),
        "D_linear": np.diag([drag] * 6).tolist(),
        "D_quadratic": ZERO,
        "D_speed": ZERO,
        "current_N_mps": [0, 0, 0],
        "wrench": {
            "frame": "B",
            "amplitude": [0] * 6,
            "omega_radps": [0] * 6,
            "phase_rad": [0] * 6,
            "bias": [force, 0, 0, 0, 0, 0],
        },
        "state0": [0, 0, 5, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        "t_s": times,
        "states": states,
    }
    return {**data, **changes}


@pytest.fixture
def write(tmp_path: Path) -> Callable[[Any], Path]:
    def to_file(data: Any) -> Path:
        path = tmp_path / "case.json"
        path.write_text(data if isinstance(data, str) else json.dumps(data))
        return path

    return to_file


def test_samples_off_the_ticks_are_hit_exactly(write: Callable[[Any], Path]) -> None:
    result = validate(write(oracle()), 240)
    assert result.position.error < 1e-10
    assert result.linear_velocity.error < 1e-10
    assert result.attitude.error == 0.0
    assert (result.samples, result.rate_hz) == (5, 240)
    # 24 steps to 0.1 s, then whole numbers of steps no longer than a tick.
    assert result.steps == 24 + math.ceil(0.6301 * 240) + math.ceil((math.pi - 0.7301) * 240) + math.ceil(
        (9.9 - math.pi) * 240
    )


def test_errors_are_those_of_the_file_and_say_when(write: Callable[[Any], Path]) -> None:
    data = oracle()
    data["states"][2][1] = 0.03
    data["states"][3][9] = -0.2
    data["states"][1][12] = 0.5
    half = math.radians(1.0) / 2.0
    data["states"][4][3:7] = [-math.cos(half), 0.0, -math.sin(half), 0.0]  # the other sign of the same quaternion
    result = validate(write(data))
    assert result.position.error == pytest.approx(0.03)
    assert result.position.t_s == 0.7301
    assert result.linear_velocity.error == pytest.approx(0.2)
    assert result.linear_velocity.t_s == math.pi
    assert result.angular_velocity == pytest.approx((0.5, 0.1))
    assert result.attitude.error == pytest.approx(1.0)
    assert result.attitude.t_s == 9.9


def test_wrench_in_N_does_not_turn_with_the_body(write: Callable[[Any], Path]) -> None:
    data = oracle()
    data["wrench"]["frame"] = "N"
    yaw = [math.cos(0.6), 0, 0, math.sin(0.6)]
    data["state0"][3:7] = yaw
    for row in data["states"]:
        row[3:7] = yaw
        u = row[7]
        row[7:9] = u * math.cos(1.2), -u * math.sin(1.2)
    result = validate(write(data))
    assert result.position.error < 1e-9
    assert result.linear_velocity.error < 1e-9


def test_a_first_sample_after_the_start_is_integrated_to(write: Callable[[Any], Path]) -> None:
    data = oracle()
    data["t_s"], data["states"] = data["t_s"][2:], data["states"][2:]
    assert validate(write(data)).position.error < 1e-10


def test_a_start_that_is_not_at_zero_keeps_the_wrench_on_time(write: Callable[[Any], Path]) -> None:
    """No damping, F = 15 sin(t) N on 15 kg: u = 1 - cos(t) when started at rest at t = 0; here from t = 1 s on."""
    data = oracle(D_linear=ZERO)
    data["wrench"] |= {"bias": [0] * 6, "amplitude": [15, 0, 0, 0, 0, 0], "omega_radps": [1] * 6}
    data["t_s"] = [1.0, 2.0, 3.5]
    data["states"] = [[t - math.sin(t), 0, 5, 1, 0, 0, 0, 1 - math.cos(t), 0, 0, 0, 0, 0] for t in data["t_s"]]
    data["state0"] = data["states"][0]
    assert validate(write(data)).position.error < 1e-9


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        ("not json", "not a JSON object"),
        ("[1, 2]", "not a JSON object"),
        ({"format": "other-7"}, 'format "other-7" found, "uwserver-oracle-1" expected'),
        ({"format": None}, 'format none found, "uwserver-oracle-1" expected'),
        ({"M_A": None}, "`M_A`"),
        ({"D_speed": "none"}, "`$.D_speed`"),
        ({"weight_N": "heavy"}, "`$.weight_N`"),
        ({"state0": [0.0] * 12}, "`$.state0`"),
        ({"state0": [0.0] * 13}, "quaternions"),
        ({"t_s": [0.0, 2.0, 1.0, 3.0, 4.0]}, "t_s: rising times"),
        ({"t_s": [0.0, 1.0]}, "one row for each of the 2 times"),
        ({"M_A": [[5.0, 1.0, 0, 0, 0, 0], *np.diag([5.0] * 6).tolist()[1:]]}, "M_A: symmetric"),
        ({"M_RB": ZERO, "M_A": ZERO}, "positive definite"),
        ({"wrench": {"frame": "X"}}, "`$.wrench.frame`"),
    ],
)
def test_refusals_name_the_key_and_what_was_expected(write: Callable[[Any], Path], change: Any, phrase: str) -> None:
    data: Any = change if isinstance(change, str) else copy.deepcopy(oracle())
    if isinstance(change, dict):
        for key, value in change.items():
            if value is None:
                del data[key]
            else:
                data[key] = value if key != "wrench" else {**data["wrench"], **value}
    path = write(data)
    with pytest.raises(ValueError) as refused:
        validate(path)
    assert phrase in str(refused.value)
    assert str(path) in str(refused.value)


def test_a_run_that_diverges_is_no_result(write: Callable[[Any], Path]) -> None:
    with pytest.raises(ValueError, match="diverged before t = "):
        validate(write(oracle(D_linear=np.diag([-900.0] * 6).tolist(), state0=[0, 0, 5, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0])))


def test_the_rate_must_be_positive(write: Callable[[Any], Path]) -> None:
    with pytest.raises(ValueError, match="rate must be positive"):
        validate(write(oracle()), 0)
