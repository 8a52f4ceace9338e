"""Order and directions of ArduSub's motors: each channel alone must push and turn as the factors of its frame say."""

from __future__ import annotations

from pathlib import Path

import pytest
from uwserver_adapters.sil.in_the_loop import Outputs, Scale

import uwserver
from uwserver.world import World

# AP_Motors6DOF.cpp: factors of roll, pitch, yaw, throttle, forward and lateral; throttle is up, the others as in B.
VECTORED = [
    (0, 0, 1, 0, -1, 1),
    (0, 0, -1, 0, -1, -1),
    (0, 0, -1, 0, 1, 1),
    (0, 0, 1, 0, 1, -1),
    (1, 0, 0, -1, 0, 0),
    (-1, 0, 0, -1, 0, 0),
]
VECTORED_6DOF = [
    *VECTORED[:4],
    (1, -1, 0, -1, 0, 0),
    (-1, -1, 0, -1, 0, 0),
    (1, 1, 0, -1, 0, 0),
    (-1, 1, 0, -1, 0, 0),
]


SCENARIO = """
schema = 1
[world]
rate_hz = 480
[vehicles.rov]
model = "{model}"
position_ned_m = [0, 0, 20]
[vehicles.rov.truth]
rate_hz = 480
"""


def world_of(model: str, folder: Path) -> World:
    file = folder / f"{model}.toml"
    file.write_text(SCENARIO.format(model=model))
    return uwserver.load(file)


@pytest.mark.parametrize(("model", "factors"), [("bluerov2", VECTORED), ("bluerov2_heavy", VECTORED_6DOF)])
def test_each_motor_pushes_as_its_factors_say(model: str, factors: list[tuple[int, ...]], tmp_path: Path) -> None:
    scale = Scale()
    world = world_of(model, tmp_path)
    outputs = Outputs({}, world.ports, "rov")
    for motor, (roll, pitch, yaw, throttle, forward, lateral) in enumerate(factors):
        for pwm, sign in ((1700, 1.0), (1300, -1.0)):
            world.call("world/reset")
            frame = [1500] * 16
            frame[motor] = pwm
            for path, value in outputs.commands([scale[width] for width in frame]):
                world.command(path, **value)
            world.step(100)
            wrench = world.read("rov/truth/wrench")
            assert wrench is not None
            (fx, fy, fz), (mx, my, mz) = wrench.value  # type: ignore[misc]  # three floats each
            for what, factor, found in (
                ("roll", roll, mx), ("pitch", pitch, my), ("yaw", yaw, mz),
                ("throttle", throttle, -fz), ("forward", forward, fx), ("lateral", lateral, fy),
            ):  # fmt: skip
                if factor:
                    assert found * factor * sign > 0.05, f"{model}, motor {motor + 1} at {pwm} us: {what} {found}"


@pytest.mark.parametrize(("model", "factors"), [("bluerov2", VECTORED), ("bluerov2_heavy", VECTORED_6DOF)])
def test_all_motors_at_neutral_or_not_driven_do_not_push(
    model: str, factors: list[tuple[int, ...]], tmp_path: Path
) -> None:
    world = world_of(model, tmp_path)
    for pwm in (1500, 0):
        scale = Scale()
        for path, value in Outputs({}, world.ports, "rov").commands([scale[pwm]] * 16):
            world.command(path, **value)
        world.step(100)
        wrench = world.read("rov/truth/wrench")
        assert wrench is not None
        assert [component for part in wrench.value for component in part] == pytest.approx([0.0] * 6, abs=1e-9)  # type: ignore[union-attr]
    assert len(factors) == world.ports["rov/thrusters"].fields[0].size
