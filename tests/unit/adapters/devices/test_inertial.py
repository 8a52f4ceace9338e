"""Readings of several sensors as one device has them; GPS time."""

from __future__ import annotations

import math

import pytest
from devices_rig import ATTITUDE, COMPASS, EPOCH_NS, GPS, IMU, make_context, sample
from uwserver_adapters.devices.inertial import Fix, InertialDevice, Readings
from uwserver_adapters.devices.vectornav import VectorNavTable

from uwserver.adapter import CannotServe

TABLE = VectorNavTable(
    imu="rov/imu", attitude="rov/attitude", magnetometer="rov/compass", gps="rov/gps", model="VN-200", tcp_port=0
)
LEVEL = (1.0, 0.0, 0.0, 0.0)


def test_the_imu_sets_the_pace_once_there_is_an_attitude():
    sensors = InertialDevice(TABLE, make_context())
    imu = sample(IMU, ((0.0, 0.0, -9.8), (0.1, 0.2, 0.3), 12.5), 0.5)
    assert sensors.measure(imu) is None
    assert sensors.measure(sample(ATTITUDE, (LEVEL, 0.0), 0.5)) is None
    sensors.measure(sample(COMPASS, ((2e-5, 0.0, 4e-5),), 0.5))
    sensors.measure(sample(GPS, (1.0, 0.2, 3.0, (1.0, 2.0, 3.0), 9, 3), 0.4))
    readings = sensors.measure(imu)
    assert readings == Readings(
        500_000_000, EPOCH_NS, (0.0, 0.0, -9.8), (0.1, 0.2, 0.3), (2e-5, 0.0, 4e-5), 12.5, LEVEL,
        Fix(3, 9, 1.0, 0.2, 3.0, (1.0, 2.0, 3.0), t_ns=400_000_000),
    )  # fmt: skip
    sensors.measure(sample(GPS, (None, None, None, (None,) * 3, 2, 3), 0.6, valid=False))
    under = sensors.measure(imu)
    assert under is not None
    assert under.fix == Fix(0, 2, t_ns=600_000_000)
    sensors.reset()
    assert sensors.measure(imu) is None


def test_gps_time_runs_ahead_of_utc_by_the_leap_seconds():
    readings = Readings(0, EPOCH_NS, LEVEL[:3], LEVEL[:3], LEVEL[:3], 0.0, LEVEL, Fix())
    # 2024-01-01 was a Monday, in week 2295.
    assert (readings.gps_week, readings.gps_tow_ns) == (2295, (86_400 + 18) * 1_000_000_000)
    assert readings.utc.isoformat() == "2024-01-01T00:00:00+00:00"


def test_yaw_is_within_half_a_turn():
    half = math.radians(300.0) / 2
    readings = Readings(0, 0, LEVEL[:3], LEVEL[:3], LEVEL[:3], 0.0, (math.cos(half), 0.0, 0.0, math.sin(half)), Fix())
    assert math.degrees(readings.rpy[2]) == pytest.approx(-60.0)


def test_a_sensor_without_the_field_is_refused():
    with pytest.raises(CannotServe, match="imu"):
        InertialDevice(VectorNavTable(imu="rov/gps", attitude="rov/attitude", tcp_port=0), make_context())


def test_a_receiver_goes_with_the_vn_200_alone():
    with pytest.raises(ValueError, match="VN-200"):
        VectorNavTable(imu="rov/imu", attitude="rov/attitude", model="VN-200", tcp_port=0)
    with pytest.raises(ValueError, match="VN-200"):
        VectorNavTable(imu="rov/imu", attitude="rov/attitude", gps="rov/gps", tcp_port=0)
