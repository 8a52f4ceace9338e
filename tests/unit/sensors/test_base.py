"""What all sensors with a memory have in common: a restore, and another rate.

What a sensor may know of others: cameras look at nothing before somebody asks.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensor_rig import BATTERY, world_with

from uwserver.environment.light import WATER_TYPES, Daylight
from uwserver.sensors import CompoundConfig, GpsConfig, ImuConfig, LeakConfig
from uwserver.sensors.base import Sight
from uwserver.sensors.motion.triad import TriadErrors

NOISY = TriadErrors(noise_density=1e-3, instability=1e-3, random_walk=1e-4)


def test_stateful_sensors_go_on_bit_for_bit_after_a_restore():
    world = world_with(
        depth=0.0,
        tactical=ImuConfig(rate_hz=240, gyroscope=NOISY, accelerometer=NOISY),
        gps=GpsConfig(rate_hz=5, horizontal_sigma_m=2.0, hot_fix_s=1.0, cold_fix_s=2.0),
        battery=BATTERY,
        leak=LeakConfig(rate_hz=2, area_m2=1e-6, threshold_m3=1e-4),
        auto=CompoundConfig(rate_hz=60, members=("tactical", "gps", "battery")),
    )
    world.command("rov/thrusters", u=[0.4] * 8)
    world.step(333)
    world.call("rov/battery/set", hotel_load_W=50.0)
    taken = world.call("world/snapshot")
    going = world.step(700)
    world.call("rov/battery/set", hotel_load_W=70.0)
    world.step(50)
    assert world.call("world/restore")
    assert world.call("world/state_hash")["hash"] == taken["hash"]
    assert world.step(700) == going


def test_rate_of_a_stateful_sensor_can_change():
    """A tenth of the rate: ten times the variance goes with a tenth of the density's bandwidth, and memory goes on in seconds."""
    world = world_with(imu2=ImuConfig(rate_hz=240, gyroscope=TriadErrors(noise_density=1e-3)))
    fast = [s.value[1] for s in world.step(4800) if s.port == "rov/imu2"]
    world.call("rov/imu2/set", rate_hz=24.0)
    slow = [s.value[1] for s in world.step(24_000) if s.port == "rov/imu2"]
    ideal = np.array([0.0, 0.0, 0.0])
    assert np.std(np.diff(np.array(fast) - ideal, axis=0)) / math.sqrt(2) == pytest.approx(
        1e-3 * math.sqrt(240), rel=0.05
    )
    assert np.std(np.diff(np.array(slow) - ideal, axis=0)) / math.sqrt(2) == pytest.approx(
        1e-3 * math.sqrt(24), rel=0.06
    )


def test_it_is_what_it_was_given_and_looks_only_when_asked() -> None:
    looked: list[int] = []
    sight = Sight(WATER_TYPES["II"], Daylight(), lambda: looked.append(1), tuple, lambda: np.zeros((1, 13)))
    assert not looked
    sight.scene()
    assert looked == [1]
    assert sight.lamps() == ()
