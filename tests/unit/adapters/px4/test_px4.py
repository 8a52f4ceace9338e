"""PX4's simulator interface: messages as pymavlink reads them, and the lock-step with a hand-made autopilot on a loopback connection."""

from __future__ import annotations

import contextlib
import math
import socket
from typing import Any

import numpy as np
import pytest
from kernel_buffers import keep_small

mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="pymavlink is not installed")

from px4_rig import connected, rig  # noqa: E402  # needs pymavlink
from uwserver_adapters.px4 import codec  # noqa: E402
from uwserver_adapters.px4.door import GREETING_S, PATIENCE_S  # noqa: E402

from uwserver.adapter import Order  # noqa: E402


def by_type(messages: list[Any]) -> dict[str, Any]:
    return {message.get_type(): message for message in messages}


# -- lock-step ----------------------------------------------------------------------------------------------------------------------------


def test_nobody_there_is_no_step() -> None:
    with rig() as r:
        assert r.order() is None
        assert r.stats.peers == 0


def test_time_goes_on_by_itself_until_the_first_controls() -> None:
    with rig() as r, connected(r) as px4:
        for n in range(5):
            assert r.order() == Order(4, ())
            r.tick()
            assert r.stats.peers == 1, n
        sensors = [message for message in px4.read() if message.get_type() == "HIL_SENSOR"]
        assert [message.time_usec for message in sensors] == [4000, 8000, 12000, 16000, 20000]
        assert {message.id for message in sensors} == {0}


def test_nothing_moves_before_the_autopilot_speaks() -> None:
    with rig() as r:
        px4 = r.connect()
        with contextlib.closing(px4.stream):
            assert r.order() is None
            assert px4.names() == ["HEARTBEAT"]
            px4.greet()
            assert r.order() is not None


@pytest.mark.parametrize("garbage", [b"\x00\xfd\x01\x00" * 200, b"\xfd\x00\x00" + bytes(9)])
def test_who_says_no_mavlink_is_sent_away(garbage: bytes) -> None:
    with rig() as r, connected(r) as px4:
        assert r.order() == Order(4, ())
        for _ in range(400):
            try:
                px4.stream.send(garbage)
            except OSError:
                break
            r.order()
        assert r.stats.peers == 0
        assert "is no MAVLink" in r.stats.last_error


def test_armed_in_lockstep_each_step_waits_for_its_controls() -> None:
    with rig() as r, connected(r) as px4:
        assert r.order() == Order(4, ())
        r.tick()
        px4.controls([0.5, -0.5, 1.0, -1.0, 0.25, 0.0, 0.0, 0.125])
        order = r.order()
        assert order == Order(4, [("rov/thrusters", {"u": [0.5, -0.5, 1.0, -1.0, 0.25, 0.0, 0.0, 0.125]})])
        r.tick()
        assert r.order() is None, "it waits"
        r.now += 10.0
        assert r.order() is None, "as long as it takes"
        px4.controls([0.1])
        assert r.order() is not None
        assert r.stats.details["is_locked"] is True
        assert r.stats.details["controls"] == 2


def test_of_several_controls_the_last_counts() -> None:
    with rig() as r, connected(r) as px4:
        assert r.order() is not None
        for level in (0.1, 0.2, 0.3):
            px4.controls([level])
        order = r.order()
        assert order is not None
        assert order.commands[0][1]["u"][0] == pytest.approx(0.3)
        assert r.order() is None


def test_outputs_for_an_older_sample_let_nobody_go_on() -> None:
    """As PX4 sends them when sensor messages went out before it had any outputs: else it would lag by one for ever."""
    with rig() as r, connected(r) as px4:
        for _ in range(3):
            assert r.order() is not None
            r.tick()
        px4.controls([0.1], t_us=8000)
        assert r.order() is None
        assert (r.stats.details["controls"], r.stats.details["late"]) == (1, 1)
        px4.controls([0.2], t_us=12000)
        order = r.order()
        assert order is not None
        assert order.commands[0][1]["u"][0] == pytest.approx(0.2)
        assert r.stats.details["late"] == 1


def test_disarmed_it_waits_too_but_not_for_ever() -> None:
    """PX4 has outputs for each sample also while disarmed, and its estimator misses each one that it has no time for; some modes have none."""
    with rig() as r, connected(r) as px4:
        assert r.order() is not None
        px4.controls([0.5] * 8, mode=1)
        assert r.order() == Order(4, [("rov/thrusters", {"u": [0.0] * 8})])
        r.tick()
        assert r.order() is None, "it waits"
        assert r.stats.details["is_locked"] is True
        r.now += PATIENCE_S
        for _ in range(3):
            assert r.order() == Order(4, ()), "freely again"
            r.tick()
        assert r.stats.details["missed"] == 1
        assert r.stats.details["is_locked"] is False
        px4.controls([0.5] * 8, mode=1)
        assert r.order() is not None
        r.tick()
        assert r.order() is None, "and in lock-step again"


def test_without_lockstep_it_does_not_wait() -> None:
    with rig() as r, connected(r) as px4:
        assert r.order() is not None
        r.tick()
        px4.controls([0.5] * 8, flags=0, t_us=1)
        for _ in range(3):
            order = r.order()
            assert order is not None
            assert order.commands == [("rov/thrusters", {"u": [0.5] * 8})]
            r.tick()
        assert r.stats.details["late"] == 0, "its clock is another"


def test_without_lockstep_the_world_is_no_faster_than_time() -> None:
    with rig() as r, connected(r):
        assert r.order() is not None
        before = r.now
        for _ in range(10):
            assert r.order() is not None
        assert r.now - before == pytest.approx(0.04, abs=0.005)


def test_outputs_that_are_no_numbers_or_outside() -> None:
    with rig() as r, connected(r) as px4:
        assert r.order() is not None
        px4.controls([math.nan, math.inf, 3.0, -7.0, 0.5])
        order = r.order()
        assert order is not None
        assert order.commands[0][1]["u"] == [0.0, 0.0, 1.0, -1.0, 0.5, 0.0, 0.0, 0.0]
        assert r.stats.details["limited"] == 4


def test_garbage_is_counted_and_the_next_message_understood() -> None:
    with rig() as r, connected(r) as px4:
        assert r.order() is not None
        px4.stream.sendall(b"\xfd\x00garbage\xff" * 20)
        px4.stream.sendall(px4.mav.heartbeat_encode(0, 12, 0, 0, 0).pack(px4.mav)[:-1] + b"\x00")
        px4.controls([0.5])
        for _ in range(20):
            order = r.order()
            if order is not None and order.commands and r.stats.details["controls"]:
                break
        assert r.stats.details["controls"] == 1
        assert r.stats.details["bad"] > 0
        assert r.stats.errors == r.stats.details["bad"]


def test_what_was_said_before_and_pieces_of_it_give_no_output_that_is_none() -> None:
    """Messages cut, bent and played back at random: each step has outputs between -1 and 1 or none, and whoever speaks no MAVLink goes."""
    dice = np.random.default_rng(14)
    with rig() as r:
        px4, steps = r.connect(), 0
        px4.greet()
        said = [
            px4.mav.hil_actuator_controls_encode(t_us, [level] * 16, 129, 1).pack(px4.mav)
            for t_us, level in ((2**40, 0.5), (0, 1.0), (2**63, math.nan), (2**64 - 1, -math.inf), (2**40, 1e30))
        ]
        for _ in range(400):
            data = bytearray(said[dice.integers(len(said))])
            if dice.random() < 0.5:
                data[dice.integers(len(data))] = dice.integers(256)
            if dice.random() < 0.2:
                del data[dice.integers(len(data)) :]
            try:
                px4.stream.sendall(bytes(data))
            except OSError:
                px4.stream.close()
                px4 = r.connect()
                px4.greet()
            order = r.order()
            if order is not None:
                steps += 1
                assert order.ticks == 4
                for _, value in order.commands:
                    levels: Any = value["u"]
                    assert all(-1.0 <= level <= 1.0 for level in levels)
                r.tick()
        px4.stream.close()
        assert steps > 50
        assert r.stats.details["bad"] > 50
        assert r.stats.details["limited"] > 0


def test_an_autopilot_that_restarts_connects_again() -> None:
    with rig() as r:
        with connected(r) as px4:
            assert r.order() is not None
            px4.controls([0.5])
            assert r.order() is not None
        assert r.order() is None
        assert r.stats.peers == 0
        assert "the connection to the autopilot ended" in r.stats.last_error
        with connected(r) as px4:
            assert r.order() == Order(4, ()), "freely again"
            r.tick()
            assert "HIL_SENSOR" in px4.names()
        assert r.stats.details["connections"] == 2
        assert r.conflicts == []


def test_who_speaks_last_drives() -> None:
    with rig() as r, connected(r) as first:
        assert r.order() is not None
        with connected(r) as second:
            assert r.conflicts == []
            while r.stats.details["connections"] < 2:
                r.order()
            assert [text.partition(":")[0] for text in r.conflicts] == ["two autopilots connect here"]
            first.read()
            r.tick()
            assert "HIL_SENSOR" in second.names()
            assert "HIL_SENSOR" not in first.names()
            assert r.stats.peers == 1


def test_a_ground_station_does_not_take_the_vehicle_over() -> None:
    """It looks for a vehicle at any port it is told, with heartbeats and requests; PX4, whose connection ended, would not come again."""
    with rig() as r, connected(r) as px4:
        assert r.order() is not None
        station = r.connect()
        for _ in range(3):
            station.send(station.mav.heartbeat_encode(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0))
            station.send(
                station.mav.command_long_encode(1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 30, 1e5, 0, 0, 0, 0, 0)
            )
            r.order()
            r.tick()
        assert r.stats.details["connections"] == 1
        assert "HIL_SENSOR" in px4.names()
        r.now += 10.0
        for _ in range(5):
            r.order()
        assert r.stats.details["refused"] == {"no autopilot": 1}
        station.close()


@pytest.mark.parametrize(
    "said", [b"", b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n", b"\x16\x03\x01\x02\x00\x01", b"garbage" * 100]
)
def test_a_stranger_does_not_end_the_autopilot_s_connection(said: bytes) -> None:
    with rig() as r, connected(r) as px4:
        assert r.order() is not None
        controls = px4.mav.hil_actuator_controls_encode(2**40, [0.5] * 16, 128 | 1, 1).pack(px4.mav)
        with contextlib.ExitStack() as stack:
            strangers = [stack.enter_context(socket.create_connection(r.listener.getsockname())) for _ in range(10)]
            for stranger in strangers:
                stranger.sendall(said + (controls if said.startswith(b"POST") else b""))
            for _ in range(20):
                r.order()
            px4.controls([0.25])
            assert r.order() == Order(4, [("rov/thrusters", {"u": [0.25, *[0.0] * 7]})])
            assert (r.stats.peers, r.stats.details["connections"], r.stats.details["controls"]) == (1, 1, 1)
            r.now += GREETING_S
            r.order()
            strangers[-1].settimeout(60.0)
            answer = b""
            with contextlib.suppress(ConnectionError):
                while piece := strangers[-1].recv(1000):
                    answer += piece
            assert (b"HTTP/1.1 400 " in answer) == said.startswith(b"POST")


def test_an_autopilot_that_does_not_read_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    keep_small(monkeypatch)
    with rig() as r, connected(r) as px4:
        px4.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        assert r.order() is not None
        for _ in range(100_000):
            r.tick()
            if r.stats.peers == 0:
                break
        assert r.stats.peers == 0
        assert "does not read" in r.stats.last_error


def test_its_clock_never_goes_back() -> None:
    with rig() as r, connected(r) as px4:
        assert r.order() is not None
        for _ in range(3):
            r.tick()
        r.t_ns = 0  # world/reset
        for _ in range(3):
            r.tick()
        stamps = [m.time_usec for m in px4.read() if m.get_type() == "HIL_SENSOR"]
        assert stamps == sorted(set(stamps))
        assert stamps[-1] - stamps[-2] == 4000


# -- messages ---------------------------------------------------------------------------------------------------------------------------


def test_sensor_messages() -> None:
    with rig(extras=True) as r, connected(r) as px4:
        assert r.order() is not None
        r.tick(magnetometer=((2e-5, -1e-5, 4.5e-5),), depth=(10.0, 12.5), altimeter=(7.25,))
        r.tick()
        first, second = (m for m in px4.read() if m.get_type() == "HIL_SENSOR")
        assert (first.xacc, first.yacc, first.zacc) == pytest.approx((0.0, 0.0, -9.8))
        assert (first.xgyro, first.ygyro, first.zgyro) == pytest.approx((0.01, 0.02, 0.03))
        assert (first.xmag, first.ymag, first.zmag) == pytest.approx((0.2, -0.1, 0.45)), "gauss"
        assert first.fields_updated == 0b1101111111111
        assert first.temperature == 12.5
        assert first.pressure_alt == -10.0
        assert first.abs_pressure == pytest.approx(1013.25 * (1 + 0.0065 * 10 / 288.15) ** 5.2559)
        assert second.fields_updated == 0b111111, "nothing new of the slower ones"


def test_a_barometer_reads_the_depth_back() -> None:
    for depth in (0.0, 5.0, 100.0, 1000.0):
        kelvin = 288.15 * (codec.air_pressure_hPa(-depth) / 1013.25) ** (1 / 5.2559)
        assert (kelvin - 288.15) / 0.0065 == pytest.approx(depth, abs=1e-6)


def test_gps_only_with_a_fix() -> None:
    with rig(extras=True) as r, connected(r) as px4:
        assert r.order() is not None
        r.tick()
        r.tick(gps=(math.radians(60.0), math.radians(-5.0), -0.25, (3.0, -4.0, 0.5), 1.5, 2.5, 0.1, 9, 3))
        r.tick(gps=(None, None, None, (None,) * 3, None, None, None, 0, 0))
        (fix,) = (m for m in px4.read() if m.get_type() == "HIL_GPS")
        assert (fix.lat, fix.lon, fix.alt) == (600_000_000, -50_000_000, -250)
        assert (fix.vel, fix.vn, fix.ve, fix.vd) == (500, 300, -400, 50)
        assert (fix.eph, fix.epv, fix.satellites_visible, fix.fix_type) == (150, 250, 9, 3)
        assert fix.cog == round((360 - math.degrees(math.atan2(4, 3))) * 100)


def test_truth_odometry_and_distance() -> None:
    half = math.sqrt(0.5)
    with rig(extras=True, odometry_s=0.02) as r, connected(r) as px4:
        assert r.order() is not None
        for n in range(10):
            r.tick(
                truth_pose=((100.0, 200.0, 3.0), (half, 0.0, 0.0, half)), **({"altimeter": (7.25,)} if n == 4 else {})
            )
        messages = px4.read()
        names = [message.get_type() for message in messages]
        assert (names.count("HIL_SENSOR"), names.count("ODOMETRY"), names.count("DISTANCE_SENSOR")) == (10, 3, 1)
        assert 5 <= names.count("HIL_STATE_QUATERNION") <= 10, "each 5 ms of steps of 4 ms"
        found = by_type(messages)
        state, odometry, distance = (found[k] for k in ("HIL_STATE_QUATERNION", "ODOMETRY", "DISTANCE_SENSOR"))
        assert state.lat == round((60.0 + math.degrees(100.0 / 6_378_137.0)) * 1e7)
        assert state.lon == round((5.0 + math.degrees(200.0 / 6_378_137.0 / 0.5)) * 1e7)
        assert state.alt == -3000
        assert (state.vx, state.vy, state.vz) == (0, 50, 25), "surge goes east, cm/s"
        assert (odometry.frame_id, odometry.child_frame_id) == (1, 12)
        assert (odometry.x, odometry.y, odometry.z) == (100.0, 200.0, 3.0)
        assert odometry.q == pytest.approx((half, 0.0, 0.0, half))
        assert (odometry.vx, odometry.vy, odometry.vz) == (0.5, 0.0, 0.25)
        diagonal = [odometry.pose_covariance[i] for i in (0, 6, 11, 15, 18, 20)]
        assert diagonal == pytest.approx([0.01] * 3 + [0.0004] * 3)
        assert sum(odometry.pose_covariance) == pytest.approx(sum(diagonal))
        assert (distance.current_distance, distance.min_distance, distance.max_distance) == (725, 30, 5000)
        assert distance.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270


def test_the_truth_comes_as_often_as_it_is_asked_for() -> None:
    with rig() as r, connected(r) as px4:
        px4.send(px4.mav.command_long_encode(0, 0, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 115, -1.0, 0, 0, 0, 0, 0))
        assert r.order() is not None
        for _ in range(10):
            r.tick()
            r.order()
        assert px4.names().count("HIL_STATE_QUATERNION") <= 1


def test_no_message_holds_what_is_no_number() -> None:
    nan = math.nan
    with rig(extras=True, odometry_s=0.004) as r, connected(r) as px4:
        assert r.order() is not None
        r.tick(imu=((nan,) * 3, (None,) * 3, None), truth_pose=((nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
        r.tick()
        r.tick(
            imu=((nan,) * 3, (nan,) * 3, nan),
            truth_velocity=((nan,) * 3, (nan,) * 3),
            magnetometer=((nan,) * 3,),
            altimeter=(None,),
        )
        messages = [m for m in px4.read() if m.get_type() not in ("HEARTBEAT", "BAD_DATA")]
        assert {m.get_type() for m in messages} == {"HIL_SENSOR", "HIL_STATE_QUATERNION", "ODOMETRY"}
        for message in messages:
            for value in message.to_dict().values():
                for number in value if isinstance(value, list) else [value]:
                    assert not isinstance(number, float) or math.isfinite(number), message
