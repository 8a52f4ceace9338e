"""Shaft speed of thrusters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensor_rig import (
    THRUSTERS,
    full_speed,
    last,
    started,
    world_with,
)

from uwserver.sensors import (
    RpmConfig,
)
from uwserver.sensors.wiring import Wiring


def running(**sensors):
    """A world whose thrusters all push differently."""
    world = world_with(**sensors)
    world.command("rov/thrusters", u=[0.9, -0.6, 0.3, -0.2, 0.5, -0.8, 0.7, 0.0])
    world.step(60)
    return world


def speeds_of(world, names=THRUSTERS):
    """In plain Python, from the thrust at rest, rad/s."""
    wiring, found = world.sensors["rov/imu"].wiring, []
    for name in names:
        row = world.hydro.thrusters[THRUSTERS.index(name)]
        lag = world.hydro.lags[int(row["lag"])]
        force = (
            float(lag["C"] @ row["x"] + lag["D"] * row["demand"]) * float(row["efficiency"]) / float(row["installed"])
        )
        found.append(math.copysign(wiring.electrics[name].speed[force < 0.0] * math.sqrt(abs(force)), force))
    return found


def test_shaft_speed_is_the_root_of_the_thrust():
    world = world_with(shafts=RpmConfig(rate_hz=20, members=THRUSTERS))
    speeds = full_speed(world, 4.0, "shafts", u=-0.5)[0]
    row = world.hydro.thrusters[0]
    thrust = float(row["demand"]) / float(row["installed"])  # the lag has settled
    assert speeds[0] == pytest.approx(-58.8 * math.sqrt(-thrust), rel=1e-3)
    assert speeds == pytest.approx((speeds[0],) * 8)


@pytest.mark.parametrize("signed", [True, False])
def test_each_member_is_told_in_the_order_of_the_list(signed):
    members = ("t7", "t2", "t2", "t1")
    world = running(shafts=RpmConfig(rate_hz=240, members=members, signed=signed))
    found, expected = last(world, "shafts", 1)[0], speeds_of(world, members)
    assert len({abs(speed) for speed in expected}) == 3
    assert found == pytest.approx(expected if signed else [abs(speed) for speed in expected], rel=1e-12)


def test_alone_it_tells_of_the_thrusters_that_it_is_given(scope):
    world = running()
    shafts, instant = started(RpmConfig(rate_hz=20, members=("t3", "t6"))), scope()
    assert shafts.measure(instant) == (False, [(None, None)])
    instant.wiring = world.sensors["rov/imu"].wiring
    valid, (found,) = shafts.measure(instant)
    assert valid
    assert found == pytest.approx(speeds_of(world, ("t3", "t6")), rel=1e-12)
    assert shafts.measure(scope()) == (False, [(None, None)]), "without wiring it forgets nothing that it may read"


def test_one_that_nobody_knows_leaves_all_without_a_value(scope):
    world = running()
    hydro, wiring = world.hydro, world.sensors["rov/imu"].wiring
    known = {name: wiring.electrics[name] for name in ("t1", "t3")}
    instant = scope(wiring=Wiring(hydro, 0, {name: k for k, name in enumerate(THRUSTERS)}, known))
    assert started(RpmConfig(rate_hz=20, members=("t1", "t3"))).measure(instant)[0]
    assert started(RpmConfig(rate_hz=20, members=("t1", "t2"))).measure(instant) == (False, [(None, None)])


def test_noise_is_white_and_each_shaft_has_its_own(scope):
    world = running()
    config = RpmConfig(rate_hz=20, members=("t1", "t2", "t3"), sigma_radps=0.5)
    shafts = started(config, seed=3)
    instant = scope(wiring=world.sensors["rov/imu"].wiring)
    errors = np.array([shafts.measure(instant)[1][0] for _ in range(600)]) - speeds_of(world, config.members)
    assert errors.std(axis=0) == pytest.approx([0.5] * 3, rel=0.1)
    assert errors.mean(axis=0) == pytest.approx([0.0] * 3, abs=0.07)
    assert np.abs(np.corrcoef(errors.T)[np.triu_indices(3, 1)]).max() < 0.13
    ideal = started(RpmConfig(rate_hz=20, members=config.members, sigma_radps=0.5, ideal=True))
    assert ideal.measure(instant)[1][0] == pytest.approx(speeds_of(world, config.members), rel=1e-12)
