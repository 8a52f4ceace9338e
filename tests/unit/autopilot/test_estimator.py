"""The estimator on hand-made samples: mounts, delays, dead reckoning, fixes of every kind, what is too old, what is too far off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.autopilot.allocation import wrench_allocation
from uwserver.autopilot.arrays import AutopilotArrays, AutopilotRow
from uwserver.autopilot.config import Gains
from uwserver.autopilot.estimator import STUBBORN, place_at
from uwserver.autopilot.modes import known
from uwserver.autopilot.state import NEVER
from uwserver.autopilot.vehicle_spec import Dynamics, SensorInput, SensorInputs, SiteData, VehicleSpec
from uwserver.environment.earth import latitude_longitude
from uwserver.frames import conjugate, multiply, quat_from_rpy, rotate, rpy_from_quat
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.straight import straight
from uwserver.ports import Field
from uwserver.recording.channels import message_of
from uwserver.sensors import (
    AltimeterConfig,
    AttitudeConfig,
    BatteryConfig,
    DvlConfig,
    GpsConfig,
    ImuConfig,
    LblConfig,
    LeakConfig,
    MotionCaptureConfig,
    Pose,
    PressureConfig,
    UsblConfig,
)
from uwserver.sensors.acoustic.positioning.interrogation import Beacon
from uwserver.step.streams import ENTRY

RATE = 50.0
GAINS = Gains()
G = 9.81


BEACONS = {"b": Beacon(position_ned_m=(0.0, 0.0, 9.0))}
FIELDS = {
    str(config.__struct_config__.tag): config.build(Pose()).fields
    for config in (
        AttitudeConfig(rate_hz=1), ImuConfig(rate_hz=1), DvlConfig(rate_hz=1), AltimeterConfig(rate_hz=1), GpsConfig(rate_hz=1),
        MotionCaptureConfig(rate_hz=1), LeakConfig(rate_hz=1), BatteryConfig(rate_hz=1), PressureConfig(rate_hz=1, output="depth"),
        LblConfig(rate_hz=1, beacons=BEACONS), UsblConfig(rate_hz=1, beacons=BEACONS),
    )
}  # fmt: skip


def sensor(kind, **keys):
    """A sensor of the shipped kind; one of pressure tells depth, unless `density` says otherwise."""
    absolute = kind == "pressure" and "density" in keys
    return SensorInput(
        message_of({"kind": kind}), PressureConfig(rate_hz=1).build(Pose()).fields if absolute else FIELDS[kind], **keys
    )


ONES = (1.0,) * 6
NO_BODIES = Hydrodynamics((), 1.0 / RATE)


def row(site=None, **sensors):
    """An autopilot alone, disarmed."""
    inputs = SensorInputs({f"rov/{name}": sensor for name, sensor in sensors.items()}, site or SiteData())
    dynamics, allocation = Dynamics(ONES, ONES, ONES, ONES), wrench_allocation(ONES)
    return AutopilotRow(
        VehicleSpec(
            path="rov/autopilot", inputs=inputs, allocation=allocation, dynamics=dynamics, held=(), shares=(), names=("x",) * 6, blocked=(),
            gains=GAINS, divisor=1, dt=1.0 / RATE,
        )
    )  # fmt: skip


class Bench:
    """An estimator with a clock of its own."""

    def __init__(self, site=None, **sensors):
        self.row, self.sensors = row(site, **sensors), sensors
        self.e = self.row.estimate
        self.t_ns = 0

    def hear(self, name, *value, late_s=0.0):
        missing = (None,) * (len(self.sensors[name].fields) - len(value))
        self.row.on_sample(f"rov/{name}", value + missing, self.t_ns - round(late_s * 1e9), self.t_ns)

    def run(self, seconds, **every_step):
        for _ in range(round(seconds * RATE)):
            for name, value in every_step.items():
                self.hear(name, *value)
            assert not self.row.arrays.step(NO_BODIES.table, 0, self.t_ns)
            self.t_ns += round(1e9 / RATE)

    @property
    def known(self):
        return known(self.e, GAINS, self.t_ns)


def test_attitude_takes_off_the_mount_and_the_declination():
    q_BS = quat_from_rpy(0.1, -0.2, 0.7)
    q_NB = quat_from_rpy(0.05, 0.1, 2.0)
    declination = 0.06
    bench = Bench(ahrs=sensor("attitude", q=q_BS, north=declination))
    magnetic = multiply(quat_from_rpy(0, 0, -declination), multiply(q_NB, q_BS))
    bench.hear("ahrs", magnetic, 0.0)
    assert rpy_from_quat(bench.e.q) == pytest.approx((0.05, 0.1, 2.0), abs=1e-9)
    assert bench.known.heading


def test_the_gyroscope_carries_the_attitude_between_samples():
    bench = Bench(ahrs=sensor("attitude"), imu=sensor("imu"))
    bench.hear("ahrs", quat_from_rpy(0, 0, 0), 0.0)
    bench.run(0.5, imu=((0.0, 0.0, -G), (0.0, 0.0, 0.4), 10.0))
    # 24 intervals between 25 readings.
    assert rpy_from_quat(bench.e.q)[2] == pytest.approx(0.4 * 24 / RATE, abs=1e-5)


def test_a_late_attitude_is_turned_on_to_now():
    bench = Bench(ahrs=sensor("attitude"), imu=sensor("imu"))
    bench.hear("imu", (0.0, 0.0, -G), (0.0, 0.0, 0.5), 10.0)
    bench.hear("ahrs", quat_from_rpy(0, 0, 1.0), 1.0, late_s=0.1)
    assert rpy_from_quat(bench.e.q)[2] == pytest.approx(1.05, abs=1e-4)


def test_without_attitude_sensor_the_specific_force_shows_the_vertical_but_not_north():
    q = quat_from_rpy(0.2, -0.3, 0.0)
    f = rotate(conjugate(q), (0.0, 0.0, -G))
    bench = Bench(imu=sensor("imu"))
    bench.hear("imu", f, (0.0, 0.0, 0.0), 10.0)
    assert rpy_from_quat(bench.e.q)[:2] == pytest.approx((0.2, -0.3), abs=1e-9)
    assert bench.known.attitude
    assert not bench.known.heading
    # A tilt that is wrong is taken out in the time that the filter says.
    bench.e.q = quat_from_rpy(0.0, 0.0, 0.0)
    bench.run(20.0, imu=(f, (0.0, 0.0, 0.0), 10.0))
    assert rpy_from_quat(bench.e.q)[:2] == pytest.approx((0.2, -0.3), abs=1e-3)


def test_a_rate_comes_from_attitudes_where_there_is_no_gyroscope():
    bench = Bench(ahrs=sensor("attitude"))
    for k in range(100):
        bench.hear("ahrs", quat_from_rpy(0, 0, 0.3 * k / RATE), 0.0)
        bench.run(1.0 / RATE)
    assert bench.e.w == pytest.approx((0, 0, 0.3), abs=1e-3)


def test_depth_is_that_of_the_origin():
    bench = Bench(ahrs=sensor("attitude"), depth=sensor("pressure", p=(-0.5, 0.0, 0.0)))
    bench.hear("ahrs", quat_from_rpy(0, 0.3, 0), 0.0)
    bench.run(5.0, depth=(10.0, 8.0), ahrs=(quat_from_rpy(0, 0.3, 0), 0.0))
    # Nose up: the sensor in the stern is deeper.
    assert bench.e.p[2] == pytest.approx(10.0 - 0.5 * math.sin(0.3), abs=0.01)


def test_depth_from_absolute_pressure():
    bench = Bench(depth=sensor("pressure", density=1025.0 * G, atmosphere=101_325.0))
    bench.run(5.0, depth=(101_325.0 + 1025.0 * G * 7.0, 8.0))
    assert bench.e.p[2] == pytest.approx(7.0, abs=0.01)
    assert bench.e.v[2] == pytest.approx(0.0, abs=0.01)


def test_a_dvl_counts_in_its_mount_s_frame_and_place():
    """It sits ahead of the origin, turned by 90 degrees; the vehicle turns and does not move."""
    q_BS = quat_from_rpy(0, 0, math.pi / 2)
    bench = Bench(ahrs=sensor("attitude"), imu=sensor("imu"), dvl=sensor("dvl", p=(0.5, 0, 0), q=q_BS))
    w = 0.2
    v_S = rotate(conjugate(q_BS), (0.0, w * 0.5, 0.0))
    for k in range(100):
        bench.hear("ahrs", quat_from_rpy(0, 0, w * k / RATE), 0.0)
        bench.hear("imu", (0.0, 0.0, -G), (0.0, 0.0, w), 10.0)
        bench.hear("dvl", v_S, 8.0, 0.01)
        bench.run(1.0 / RATE)
    assert bench.e.v == pytest.approx((0, 0, 0), abs=1e-3)
    assert bench.known.velocity


def test_dead_reckoning_adds_up_and_set_position_corrects_it():
    bench = Bench(ahrs=sensor("attitude"), dvl=sensor("dvl"))
    still = (quat_from_rpy(0, 0, math.pi / 2), 0.0)
    bench.run(10.0, ahrs=still, dvl=((0.5, 0.0, 0.0), 8.0, 0.01))
    assert bench.e.p[0] == pytest.approx(0.0, abs=0.05)
    assert bench.e.p[1] == pytest.approx(5.0, abs=0.1)
    assert bench.known.position
    place_at(bench.e, 100.0, 200.0, 3.0)
    bench.run(2.0, ahrs=still, dvl=((0.5, 0.0, 0.0), 8.0, 0.01))
    assert bench.e.p[:2] == pytest.approx((100.0, 201.0), abs=0.1)


def test_it_begins_where_the_operator_says():
    bench = Bench(SiteData(start=(3.0, 4.0, 5.0)), dvl=sensor("dvl"))
    assert bench.e.p == (3.0, 4.0, 5.0)


def test_altitude_reaches_down_from_the_mount():
    bench = Bench(ahrs=sensor("attitude"), altimeter=sensor("altimeter", p=(0, 0, 0.2)), depth=sensor("pressure"))
    level = (quat_from_rpy(0, 0, 0), 0.0)
    bench.run(3.0, ahrs=level, depth=(5.0, 8.0), altimeter=(9.8, 1.0))
    assert bench.e.bottom - bench.e.p[2] == pytest.approx(10.0, abs=0.02)
    tilted = (quat_from_rpy(0.3, 0, 0), 0.0)
    bench.run(5.0, ahrs=tilted, depth=(5.0, 8.0), altimeter=(9.8, 1.0))
    assert bench.e.bottom - bench.e.p[2] == pytest.approx(10.0 * math.cos(0.3), abs=0.02)


# -- fixes -------------------------------------------------------------------------------------------------------------------------------


def test_gps_is_a_place_of_the_antenna():
    origin = (1.1, 0.2)
    site = SiteData(latitude=origin[0], longitude=origin[1])
    bench = Bench(site, ahrs=sensor("attitude"), gps=sensor("gps", p=(0.5, 0, 0)))
    latitude, longitude = latitude_longitude(40.5, -30.0, *origin)
    bench.run(5.0, ahrs=(quat_from_rpy(0, 0, 0), 0.0), gps=(latitude, longitude, 0.2, (0, 0, 0), 1.0, 1.0, 0.1, 12, 3))
    assert bench.e.p[:2] == pytest.approx((40.0, -30.0), abs=0.05)


def test_usbl_turns_what_it_hears_into_the_vehicle_s_own_place():
    site = SiteData(beacons={"b": (20.0, 10.0, 30.0)})
    q_BS = quat_from_rpy(0.0, 0.0, 0.5)
    q = quat_from_rpy(0.0, 0.1, 1.0)
    bench = Bench(site, ahrs=sensor("attitude"), usbl=sensor("usbl", p=(0.0, 0.0, 0.3), q=q_BS))
    p_NB = (2.0, -3.0, 5.0)
    p_NS = tuple(a + b for a, b in zip(p_NB, rotate(q, (0.0, 0.0, 0.3)), strict=True))
    away = tuple(b - a for a, b in zip(p_NS, site.beacons["b"], strict=True))
    seen = rotate(conjugate(q_BS), rotate(conjugate(q), away))
    bench.run(5.0, ahrs=(q, 0.0), usbl=("b", math.dist(away, (0, 0, 0)), 0.0, 0.0, seen, 0.05, (0.0,) * 4))
    assert bench.e.p[:2] == pytest.approx((2.0, -3.0), abs=0.05)
    before = bench.e.fix_ns
    bench.hear("usbl", "unheard of", 10.0, 0.0, 0.0, seen, 0.05, (0.0,) * 4)
    assert bench.e.fix_ns == before


def test_ranges_of_three_beacons_meet_in_one_place():
    beacons = {"a": (50.0, 0.0, 20.0), "b": (-40.0, 40.0, 20.0), "c": (-10.0, -60.0, 20.0)}
    bench = Bench(
        SiteData(beacons=beacons, start=(0.0, 0.0, 5.0)), ahrs=sensor("attitude"), lbl=sensor("lbl", sigma=0.3)
    )
    p = (4.0, -6.0, 5.0)
    for k in range(90):
        name = "abc"[k % 3]
        bench.hear("ahrs", quat_from_rpy(0, 0, 0), 0.0)
        bench.hear("lbl", name, math.dist(p, beacons[name]), 0.1)
        bench.run(1.0 / RATE)
    assert bench.e.p[:2] == pytest.approx(p[:2], abs=0.2)


def test_a_late_fix_is_one_of_where_the_vehicle_was():
    bench = Bench(ahrs=sensor("attitude"), dvl=sensor("dvl"), mocap=sensor("motion_capture", sigma=0.01))
    level = quat_from_rpy(0, 0, 0)
    for k in range(500):
        x = 0.5 * k / RATE
        bench.hear("ahrs", level, 0.0)
        bench.hear("dvl", (0.5, 0.0, 0.0), 8.0, 0.01)
        bench.hear("mocap", (x - 0.5 * 0.4, 0.0, 5.0), level, late_s=0.4)
        bench.run(1.0 / RATE)
    assert bench.e.p[0] == pytest.approx(0.5 * 500 / RATE, abs=0.03)


def test_one_fix_far_off_is_not_believed_many_are():
    bench = Bench(ahrs=sensor("attitude"), dvl=sensor("dvl"), mocap=sensor("motion_capture", sigma=0.01))
    level = quat_from_rpy(0, 0, 0)
    here = ((0.0, 0.0, 5.0), level)
    bench.run(5.0, ahrs=(level, 0.0), dvl=((0.0, 0.0, 0.0), 8.0, 0.01), mocap=here)
    bench.hear("mocap", (50.0, 0.0, 5.0), level)
    assert abs(bench.e.p[0]) < 0.01
    for _ in range(STUBBORN):
        bench.hear("mocap", (50.0, 0.0, 5.0), level)
    assert bench.e.p[0] == pytest.approx(50.0, abs=0.5)


def test_a_false_echo_is_not_believed_a_real_jump_is():
    bench = Bench(ahrs=sensor("attitude"), dvl=sensor("dvl"))
    bench.run(2.0, ahrs=(quat_from_rpy(0, 0, 0), 0.0), dvl=((0.2, 0.0, 0.0), 8.0, 0.01))
    bench.hear("dvl", (1.5, 0.0, 0.0), 8.0, 0.01)
    assert bench.e.v[0] == pytest.approx(0.2, abs=0.01)
    for _ in range(6):
        bench.hear("dvl", (1.5, 0.0, 0.0), 8.0, 0.01)
    assert bench.e.v[0] > 0.5


def test_frequent_fixes_alone_give_a_velocity():
    bench = Bench(mocap=sensor("motion_capture", sigma=0.01))
    level = quat_from_rpy(0, 0, 0)
    for k in range(300):
        bench.hear("mocap", (0.3 * k / RATE, 0.0, 5.0), level)
        bench.run(1.0 / RATE)
    assert bench.known.velocity
    assert bench.e.v[0] == pytest.approx(0.3, abs=0.02)


# -- what is lost ------------------------------------------------------------------------------------------------------------------------


def test_everything_is_lost_after_its_time_out():
    bench = Bench(
        ahrs=sensor("attitude"),
        depth=sensor("pressure"),
        dvl=sensor("dvl"),
        altimeter=sensor("altimeter"),
        imu=sensor("imu"),
    )
    assert not any(bench.known)
    level = (quat_from_rpy(0, 0, 0), 0.0)
    bench.run(1.0, ahrs=level, depth=(5.0, 8.0), dvl=((0.0, 0.0, 0.0), 8.0, 0.01), altimeter=(5.0, 1.0))
    assert all(bench.known)
    for name, timeout in (
        ("attitude", GAINS.attitude_timeout_s),
        ("depth", GAINS.depth_timeout_s),
        ("altitude", GAINS.altitude_timeout_s),
    ):
        since = bench.t_ns - round(1e9 / RATE)
        assert getattr(known(bench.e, GAINS, since + round(timeout * 1e9)), name)
        assert not getattr(known(bench.e, GAINS, since + round(timeout * 1e9) + 1), name)


def told_of(*samples):
    """Records of a world, of (stream, t_ns, valid)."""
    told = np.zeros(len(samples), ENTRY)
    for name, column in zip(("stream", "t_ns", "valid"), zip(*samples, strict=True), strict=True):
        told[name] = column
    return told


def test_each_sample_goes_to_who_hears_it_and_an_invalid_one_tells_nothing():
    """Two vehicles in the same arrays; streams 3 and 1 are their depths, 0 is nobody's."""
    first, second = row(depth=sensor("pressure")), row(SiteData(start=(0.0, 0.0, 4.0)), depth=sensor("pressure"))
    second.spec.inputs.ports = ("other/depth",)
    arrays = AutopilotArrays()
    arrays.gather([first, second], {"rov/depth": 3, "other/depth": 1}, 4)
    assert second.estimate.p == (0.0, 0.0, 4.0)
    told = told_of((3, 5, 1), (1, 6, 0), (0, 7, 1))
    straight(arrays.entries.listen_all)(arrays.table, told, np.array([[2.0, 8.0], [9.0, 8.0], [9.0, 8.0]]), 3, 10)
    assert first.estimate.p[2] == pytest.approx(2.0, abs=1e-3)
    assert (first.estimate.depth_ns, second.estimate.p, second.estimate.depth_ns) == (5, (0.0, 0.0, 4.0), NEVER)
    told["valid"] = 1
    straight(arrays.entries.listen_all)(arrays.table, told, np.array([[2.0, 8.0], [9.0, 8.0], [9.0, 8.0]]), 2, 10)
    assert second.estimate.depth_ns == 6


def test_several_may_hear_one_stream():
    rows = [row(SiteData(start=(0.0, 0.0, z)), depth=sensor("pressure")) for z in (0.0, 4.0, 8.0)]
    arrays = AutopilotArrays()
    arrays.gather(rows, {"rov/depth": 1}, 2)
    straight(arrays.entries.listen_all)(arrays.table, told_of((1, 5, 1)), np.array([[2.0, 8.0]]), 1, 10)
    assert [each.estimate.depth_ns for each in rows] == [5, 5, 5]
    arrays.gather(rows[1:], {"rov/depth": 0}, 2)
    straight(arrays.entries.listen_all)(arrays.table, told_of((0, 6, 1)), np.array([[2.0, 8.0]]), 1, 10)
    assert [each.estimate.depth_ns for each in rows] == [5, 6, 6]


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e12])
def test_a_sample_that_no_sensor_gives_tells_nothing(value):
    bench = Bench(
        ahrs=sensor("attitude"), imu=sensor("imu"), depth=sensor("pressure"), dvl=sensor("dvl"), mocap=sensor("motion_capture"),
        lbl=sensor("lbl"), battery=sensor("battery"), site=SiteData(beacons={"b": (20.0, 0.0, 5.0)}),
    )  # fmt: skip
    before = bench.row.read()
    bench.hear("ahrs", (value, 0.0, 0.0, 0.0), 0.0)
    bench.hear("imu", (value, 0.0, 0.0), (0.0,) * 3, 10.0)
    bench.hear("imu", (0.0, 0.0, -G), (value, 0.0, 0.0), 10.0)
    bench.hear("depth", value, 8.0)
    bench.hear("dvl", (value, 0.0, 0.0), 8.0, 0.01)
    bench.hear("mocap", (value, 0.0, 0.0), quat_from_rpy(0, 0, 0))
    bench.hear("lbl", "b", None, 0.1)
    bench.hear("battery", 14.0, 2.0, 28.0, 0.0, None)
    assert repr(bench.row.read()) == repr(before)


def test_a_motion_that_nothing_tells_of_dies_away():
    bench = Bench(ahrs=sensor("attitude"), imu=sensor("imu"), dvl=sensor("dvl"))
    level = (quat_from_rpy(0, 0, 0), 0.0)
    bench.run(2.0, ahrs=level, dvl=((0.5, 0.0, 0.0), 8.0, 0.01))
    # A tilt error of 3 degrees would make 0.5 m/s2: integrated, 900 m in a minute.
    bench.run(60.0, ahrs=level, imu=((0.5, 0.0, -G), (0.0, 0.0, 0.0), 10.0))
    assert abs(bench.e.v[0]) < 0.01
    assert abs(bench.e.p[0]) < 6.0


def test_leak_and_battery_are_remembered():
    bench = Bench(leak=sensor("leak"), battery=sensor("battery"))
    bench.hear("leak", True)
    bench.hear("battery", 14.0, 2.0, 28.0, 0.0, 0.42)
    assert bench.e.leak
    assert bench.e.charge == 0.42


def test_fields_are_found_by_name():
    """The charge of a battery is what its field `charge` says, wherever it stands; a port without it is refused when the world is built."""
    charge, voltage = Field("charge", "1", "what is left"), Field("voltage", "V", "at the terminals")
    bench = Bench(battery=SensorInput("BatteryState", (charge, voltage)))
    bench.hear("battery", 0.7, 14.0)
    assert bench.e.charge == 0.7
    with pytest.raises(
        ValueError, match=r'"rov/battery" has no field "charge" \(did you mean "charges"\?\); it has: charges'
    ):
        Bench(battery=SensorInput("BatteryState", (Field("charges", "1", "what is left"),)))
