"""Telemetry: each number in the unit of its message, what is sent how often, and nothing where nothing is known."""

from __future__ import annotations

import math

import pytest
from uwserver_adapters.mavlink.vehicle.modes import MODES
from uwserver_adapters.mavlink.wire.codec import datum

from uwserver.frames import quat_from_rpy
from uwserver.ports import Event

INTERVALS = {
    "ATTITUDE": 10,
    "AHRS2": 10,
    "VFR_HUD": 10,
    "GLOBAL_POSITION_INT": 3,
    "SYS_STATUS": 2,
    "RAW_IMU": 2,
    "RC_CHANNELS": 2,
    "HEARTBEAT": 1,
}


@pytest.fixture
def told(bench):
    bench.rov.state |= {
        "q_NB": quat_from_rpy(0.1, -0.2, -1.0),
        "p_ref_N": (4.0, 6.0, 7.0),
        "depth_ref": 7.0,
        "heading_ref": -2.0,
        "altitude": 9.5,
    }
    station = bench.station()
    bench.run(2.0)
    return station


EXPECTED = {
    "ATTITUDE": {"roll": 0.1, "pitch": -0.2, "yaw": -1.0, "rollspeed": 0.01, "pitchspeed": 0.02, "yawspeed": 0.03},
    "AHRS2": {"roll": 0.1, "pitch": -0.2, "yaw": -1.0, "altitude": -5.0},
    "LOCAL_POSITION_NED": {"x": 1.0, "y": 2.0, "z": 5.0, "vx": 0.1, "vy": 0.2, "vz": 0.3},
    "GLOBAL_POSITION_INT": {"alt": -5000, "relative_alt": -5000, "vx": 10, "vy": 20, "vz": 30, "hdg": 30270},
    "VFR_HUD": {"groundspeed": math.hypot(0.1, 0.2), "heading": 302, "alt": -5.0, "climb": -0.3, "throttle": 0},
    "RAW_IMU": {"xacc": 0, "yacc": 0, "zacc": -1000, "xgyro": 10, "ygyro": -20, "zgyro": 30},
    "SCALED_PRESSURE2": {"press_abs": 1500.0, "temperature": 1250},
    "SCALED_PRESSURE3": {"press_abs": 0.0, "temperature": 1250},
    "SYS_STATUS": {"voltage_battery": 15200, "current_battery": 350, "battery_remaining": 75},
    "BATTERY_STATUS": {"current_battery": 350, "battery_remaining": 75, "energy_consumed": 120, "current_consumed": -1},
    "DISTANCE_SENSOR": {"current_distance": 950, "orientation": 25, "signal_quality": 50},
    "RANGEFINDER": {"distance": 9.5},
    "GPS_RAW_INT": {"fix_type": 3, "lat": 572957795, "lon": 114591559, "alt": 500, "vel": 141, "cog": 4500,
                    "satellites_visible": 9, "h_acc": 1500, "v_acc": 2500, "vel_acc": 100},
    "NAV_CONTROLLER_OUTPUT": {"nav_bearing": -115, "target_bearing": 53, "wp_dist": 5, "alt_error": -2.0},
    "EKF_STATUS_REPORT": {"flags": 0x7F},
    "MISSION_CURRENT": {"seq": 0, "total": 65535, "mission_state": 1},
}  # fmt: skip


@pytest.mark.parametrize("name", EXPECTED)
def test_units(told, name):
    message = told.last(name)
    assert {field: getattr(message, field) for field in EXPECTED[name]} == pytest.approx(EXPECTED[name], abs=1e-6)


def test_geodetic_place(bench, told):
    latitude, longitude = bench.vehicle.bridge.home.origin.geodetic(1.0, 2.0)
    message = told.last("GLOBAL_POSITION_INT")
    assert (message.lat, message.lon) == (round(math.degrees(latitude) * 1e7), round(math.degrees(longitude) * 1e7))
    assert message.time_boot_ms <= 2000


@pytest.mark.parametrize("lat", [-89.0, -33.0, 0.0, 63.44, 89.0])
@pytest.mark.parametrize("lon", [-179.999, 0.0, 10.39, 179.999])
def test_places_there_and_back(lat, lon):
    origin = datum(lat, lon)
    for north, east in ((0.0, 0.0), (1000.0, -2000.0), (-7.0, 3.0)):
        assert origin.north_east(*origin.geodetic(north, east)) == pytest.approx((north, east), abs=1e-6)


def test_the_place_is_that_of_the_world(bench):
    from uwserver.environment.earth import latitude_longitude

    origin = bench.vehicle.bridge.home.origin
    there = latitude_longitude(5000.0, -3000.0, origin.latitude, origin.longitude)
    assert origin.geodetic(5000.0, -3000.0) == pytest.approx(there, abs=1e-14)


def test_rates_of_a_link_that_asks_for_nothing(bench):
    station = bench.station()
    bench.run(10.0)
    for name, rate in INTERVALS.items():
        assert abs(len(station.of(name)) - 10 * rate) <= 1, name


def test_streams_are_asked_for_in_groups(bench):
    station, other = bench.station(), bench.station(254)
    for group, rate in (
        (1, 2),
        (2, 2),
        (3, 2),
        (6, 3),
        (10, 20),
        (11, 10),
        (12, 3),
    ):  # as QGroundControl does for a Sub
        station.send("REQUEST_DATA_STREAM", 1, 1, group, rate, 1)
    bench.run(10.0)
    assert abs(len(station.of("ATTITUDE")) - 200) <= 1
    assert abs(len(other.of("ATTITUDE")) - 100) <= 1
    station.send("REQUEST_DATA_STREAM", 1, 1, 0, 4, 1)  # all, as MAVProxy does
    count = len(station.of("ATTITUDE"))
    bench.run(10.0)
    assert abs(len(station.of("ATTITUDE")) - count - 40) <= 1
    station.send("REQUEST_DATA_STREAM", 1, 1, 0, 4, 0)
    station.heard.clear()
    bench.run(2.0)
    assert {m.get_type() for m in station.heard} == {"HEARTBEAT"}
    station.send("REQUEST_DATA_STREAM", 1, 1, 99, 4, 1)
    assert bench.counters["refused"] == 1


def test_a_message_is_encoded_once_for_all(bench):
    stations = [bench.station(255 - k) for k in range(4)]
    stats = bench.rov.stats
    bench.run(5.0)
    assert stats.samples_sent == 4 * stats.encoded
    counts = {len(station.heard) for station in stations}
    assert counts == {stats.encoded}
    assert not any(station.mav.total_receive_errors for station in stations)
    for station in stations:
        assert [m.get_seq() for m in station.heard] == [k % 256 for k in range(len(station.heard))]


def test_a_world_that_stands_still_sends_heartbeats_alone(bench):
    station = bench.station()
    for _ in range(100):
        bench.now += 0.05
        bench.router.tick()
    assert {m.get_type() for m in station.heard} == {"HEARTBEAT"}
    assert 4 <= len(station.heard) <= 6


def test_nothing_is_told_where_nothing_is_known(bench):
    bench.rov.invalid |= {"autopilot/state", "imu", "pressure", "depth", "echo", "battery", "leak", "gps"}
    station = bench.station()
    bench.run(3.0)
    silent = {"ATTITUDE", "AHRS2", "RAW_IMU", "SCALED_PRESSURE2", "SCALED_PRESSURE3", "RANGEFINDER", "DISTANCE_SENSOR",
              "BATTERY_STATUS", "LOCAL_POSITION_NED"}  # fmt: skip
    assert not silent & {m.get_type() for m in station.heard}
    assert station.last("SYS_STATUS").voltage_battery == 65535
    assert station.last("GPS_RAW_INT").fix_type == 1
    assert station.last("EKF_STATUS_REPORT").flags == 0


@pytest.mark.parametrize("bad", [None, math.nan, math.inf, 1e308, "text", (1.0,), True])
def test_strange_values_of_the_world_break_nothing(bench, bad):
    for values in (bench.rov.state, *bench.rov.said.values()):
        for name in values:
            values[name] = (bad,) * len(values[name]) if isinstance(values[name], tuple) else bad
    station = bench.station()
    bench.run(2.0)
    assert station.of("HEARTBEAT")
    assert station.mav.total_receive_errors == 0


def test_identity(bench):
    station = bench.station()
    for number, name in ((148, "AUTOPILOT_VERSION"), (435, "AVAILABLE_MODES"), (436, "CURRENT_MODE")):
        station.send("COMMAND_LONG", 1, 1, 512, 0, number, 0, 0, 0, 0, 0, 0)
        assert name == "AUTOPILOT_VERSION" or station.of(f"UNKNOWN_{number}")
    version = station.last("AUTOPILOT_VERSION")
    assert version.flight_sw_version >> 24 == 4
    assert bytes(version.flight_custom_version) == b"uwserver"
    needed = 1 | 2 | 4 | 64 | 128 | 256 | 2048 | 8192
    assert version.capabilities & needed == needed


@pytest.mark.parametrize(
    ("asked", "count"), [(0, len(MODES)), (1, 1), (len(MODES), 1), (len(MODES) + 1, 0), (math.nan, len(MODES))]
)
def test_modes_come_one_by_one_or_all(bench, asked, count):
    """QGroundControl asks for mode 1, then for the next of the last that it was told."""
    station = bench.station()
    station.send("COMMAND_LONG", 1, 1, 512, 0, 435, asked, 0, 0, 0, 0, 0)
    assert len(station.of("UNKNOWN_435")) == count
    assert station.last("COMMAND_ACK").result == (0 if count else 4)


def test_timesync_and_silence_to_a_ping(bench):
    station = bench.station()
    bench.run(1.0)
    station.send("TIMESYNC", 0, 1234)
    assert (station.last("TIMESYNC").tc1, station.last("TIMESYNC").ts1) == (bench.rov.tick * 4_000_000, 1234)
    station.send("TIMESYNC", 55, 1234)
    assert len(station.of("TIMESYNC")) == 1
    station.send("PING", 0, 0, 1, 1)
    assert not station.of("PING")


def test_the_clock_is_that_of_the_scenario(bench):
    station = bench.station()
    bench.run(2.0)
    told = station.last("SYSTEM_TIME")
    epoch_us = 1_704_067_200_000_000  # 2024-01-01, as the fake world says
    assert told.time_unix_usec - epoch_us == pytest.approx(told.time_boot_ms * 1000, abs=1000)


def test_without_a_position_there_are_no_satellites(bench):
    station = bench.station()
    bench.rov.invalid.add("gps")
    bench.run(1.0)
    told = station.last("GPS_RAW_INT")
    assert (told.fix_type, told.satellites_visible) == (1, 0)


def test_events_are_told_and_long_texts_come_in_pieces(bench):
    station = bench.station()
    bench.rov.say(Event("fault", 1, 1, "x" * 120))
    bench.rov.say(Event("watchdog", 1, 1, "y" * 50))
    bench.rov.say(Event("diverged", 1, 1, "z" * 100))
    pieces = [(m.severity, m.id, m.chunk_seq, len(m.text)) for m in station.of("STATUSTEXT")]
    assert pieces == [
        (4, 1, 0, 50),
        (4, 1, 1, 50),
        (4, 1, 2, 20),
        (5, 0, 0, 50),
        (2, 2, 0, 50),
        (2, 2, 1, 50),
        (2, 2, 2, 0),
    ]


def test_the_lamps_of_a_vehicle_without_fence(told):
    """As ArduSub: its fence is there and healthy, but not switched on; MAVProxy would cry "fence breach"."""
    status, fence = told.last("SYS_STATUS"), 1 << 20
    assert status.onboard_control_sensors_present & fence
    assert status.onboard_control_sensors_health & fence
    assert not status.onboard_control_sensors_enabled & fence


def test_a_leak_that_forbids_arming_shows_before(bench):
    station, prearm = bench.station(), 1 << 28

    def healthy():
        bench.run(1.0)
        return bool(station.last("SYS_STATUS").onboard_control_sensors_health & prearm)

    assert healthy()
    bench.rov.said["leak"]["leak"] = True
    assert not healthy()
    bench.rov.state["armed"] = True  # forced: who is armed has passed
    assert healthy()


def test_events_name_our_ports_shortly(bench):
    station = bench.station()
    for path in ("rov/autopilot/velocity", "rov/thrusters", "rov2/dvl"):
        bench.rov.say(Event("watchdog", 1, 1, f'no command for "{path}" in 1 s: it went to neutral'))
    bench.rov.say(Event("mode", 1, 1, '"rov/autopilot" armed in mode depth_hold'))
    assert [m.text for m in station.of("STATUSTEXT")] == [
        "no command for velocity in 1 s: it went to neutral",
        "no command for thrusters in 1 s: it went to neutra",
        "l",
        'no command for "rov2/dvl" in 1 s: it went to neutr',
        "al",
        "armed in mode ALT_HOLD",
    ]


def test_turns_of_the_tether(bench):
    station = bench.station()
    for k in range(21):
        bench.rov.state["q_NB"] = quat_from_rpy(0.0, 0.0, -0.2 * math.pi * k)
        bench.run(0.05)
    bench.run(1.0)
    turns = [m.value for m in station.of("NAMED_VALUE_FLOAT") if m.name == "TetherTrn"]
    assert turns[-1] == pytest.approx(-2.0, abs=1e-6)
