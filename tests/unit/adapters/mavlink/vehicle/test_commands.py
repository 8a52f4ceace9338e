"""Commands: acknowledged as a real ArduSub 4.7 acknowledged them (measured), and carried out."""

from __future__ import annotations

import asyncio
import math

import pytest
from uwserver_adapters.mavlink.vehicle.modes import BY_NAME

from uwserver.adapter import UNANSWERED
from uwserver.ports import Refused, Reply

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4

GOLDEN = [
    *((512, (float(number),), ACCEPTED) for number in (148, 435, 242, 49)),
    (520, (1.0,), ACCEPTED),
    (511, (30.0, 100_000.0), ACCEPTED),
    (510, (30.0,), ACCEPTED),
    (410, (), ACCEPTED),
    (176, (1.0, 2.0), ACCEPTED),
    (179, (1.0,), ACCEPTED),
    (178, (0.0, 1.0), ACCEPTED),
    (115, (90.0, 0.0, 1.0, 0.0), ACCEPTED),
    (183, (9.0, 1500.0), ACCEPTED),
    (21, (), ACCEPTED),
    (241, (1.0,), ACCEPTED),
    (203, (), ACCEPTED),
    (205, (10.0,), ACCEPTED),
    (42428, (), ACCEPTED),
    (400, (0.0,), ACCEPTED),
    (512, (397.0,), FAILED),
    (512, (395.0,), FAILED),
    (176, (1.0, 99.0), FAILED),
    (209, (1.0,), FAILED),
    (300, (), FAILED),
    (185, (0.0,), FAILED),
    (519, (1.0,), UNSUPPORTED),
    (192, (), UNSUPPORTED),
    (22, (), UNSUPPORTED),
    (20, (), UNSUPPORTED),
    (246, (0.0,), UNSUPPORTED),
    (30001, (), UNSUPPORTED),
    (31010, (), UNSUPPORTED),
    (43000, (), UNSUPPORTED),
]


@pytest.mark.parametrize(("number", "p", "result"), GOLDEN, ids=str)
async def test_golden_acknowledgements(bench, number, p, result):
    assert await bench.station().command(number, *p) == result


@pytest.mark.parametrize(("number", "p"), [(176, (1.0, 16.0)), (17, ())])
async def test_what_needs_a_position_fails_without_one(bench, number, p):
    bench.rov.state["position_valid"] = False
    station = bench.station()
    assert await station.command(number, *p) == FAILED
    assert any("no position" in text for text in station.texts())


async def test_silence_to_commands_for_others(bench):
    assert await bench.station().command(520, 1.0, target=7) is None


async def test_each_of_several_stations_is_acknowledged_alone(bench):
    a, b = bench.station(255), bench.station(254)
    assert await a.command(400, 1.0) == ACCEPTED
    assert await b.command(176, 1.0, 2.0) == ACCEPTED
    assert [m.command for m in a.of("COMMAND_ACK")] == [400]
    assert [m.command for m in b.of("COMMAND_ACK")] == [176]
    assert "Arming motors" in a.texts()
    assert "Arming motors" in b.texts()


async def test_arming(bench):
    station, state = bench.station(), bench.rov.state
    assert await station.command(400, 1.0) == ACCEPTED
    bench.run(1.1)
    assert station.last("HEARTBEAT").base_mode & 128
    assert await station.command(400, 0.0) == ACCEPTED
    assert not state["armed"]
    bench.rov.said["leak"]["leak"] = True
    assert await station.command(400, 1.0) == FAILED
    assert await station.command(400, 1.0, 21196.0) == ACCEPTED
    assert state["armed"]
    assert await station.command(400, 0.5) == UNSUPPORTED


@pytest.mark.parametrize(
    ("number", "mode"),
    [(0, "stabilise"), (1, "acro"), (2, "depth_hold"), (3, "mission"), (4, "guided"), (9, "surface"),
     (16, "position_hold"), (19, "manual"), (21, "altitude_hold")],
)  # fmt: skip
async def test_modes(bench, number, mode):
    station = bench.station()
    bench.rov.items = [{"kind": "surface"}]  # without a mission AUTO is refused
    assert await station.command(176, 1.0, float(number)) == ACCEPTED
    assert bench.rov.state["mode"] == mode
    bench.run(1.1)
    assert station.last("HEARTBEAT").custom_mode == number


async def test_set_mode_message(bench):
    station = bench.station()
    station.send("SET_MODE", 1, 1, 2)
    await asyncio.sleep(0.01)
    assert bench.rov.state["mode"] == "depth_hold"
    assert (station.last("COMMAND_ACK").command, station.last("COMMAND_ACK").result) == (11, ACCEPTED)


async def test_asked_again_while_the_world_stands_still(bench):
    bench.rov.held.add("rov/autopilot/arm")
    station = bench.station()
    assert await station.command(400, 1.0) is None
    assert await station.command(400, 1.0) == 5
    call = bench.rov.calls[-1]
    from uwserver.ports import Reply

    call.finish(Reply(1, 1))
    assert station.last("COMMAND_ACK").result == ACCEPTED
    assert len([c for c in bench.rov.calls if c.service.endswith("/arm")]) == 1


async def test_reposition(bench):
    station = bench.station()
    place = bench.vehicle.bridge.home.origin.geodetic(30.0, -20.0)
    x, y = (round(math.degrees(angle) * 1e7) for angle in place)
    assert await station.command_int(192, (-1.0, 1.0, 0.0, 90.0), x, y, -12.0) == ACCEPTED
    assert bench.rov.state["mode"] == "guided"
    (value,) = bench.rov.commanded("position")
    assert value["p_N"] == pytest.approx((30.0, -20.0, 12.0), abs=0.02)
    assert value["heading"] == pytest.approx((math.pi / 2,))
    assert await station.command_int(192, (-1.0, 1.0, 0.0, 0.0), x, y, -12.0, frame=10) == DENIED
    assert await station.command_int(192, (-1.0, 0.0, 0.0, math.nan), 10**9, y, -12.0) == DENIED


async def test_turn(bench):
    station = bench.station()
    assert await station.command(115, 45.0, 0.0, -1.0, 1.0) == ACCEPTED
    assert bench.rov.commanded("heading")[-1]["heading"] == pytest.approx((-math.pi / 4,))
    assert await station.command(115, 350.0) == ACCEPTED
    assert bench.rov.commanded("heading")[-1]["heading"] == pytest.approx((math.radians(-10.0),))


async def test_home_and_origin(make_bench):
    bench = make_bench(origin_deg=None)
    station = bench.station()
    assert await station.command(410) == FAILED
    station.send("SET_GPS_GLOBAL_ORIGIN", 1, 600_000_000, 50_000_000, 0)
    assert (station.last("GPS_GLOBAL_ORIGIN").latitude, station.last("HOME_POSITION").longitude) == (
        600_000_000,
        50_000_000,
    )
    station.send("SET_GPS_GLOBAL_ORIGIN", 1, 610_000_000, 50_000_000, 0)
    assert station.last("GPS_GLOBAL_ORIGIN").latitude == 600_000_000
    assert await station.command_int(179, (0.0,) * 4, 600_100_000, 50_000_000, 2.0, frame=0) == ACCEPTED
    home = station.last("HOME_POSITION")
    assert (home.latitude, home.altitude) == (600_100_000, 2000)
    assert home.x == pytest.approx(1114.3, abs=1.0)
    bench.run(1.0)
    assert station.last("GLOBAL_POSITION_INT").relative_alt == -7000
    assert station.last("GLOBAL_POSITION_INT").alt == -5000


async def test_without_an_autopilot_it_is_told_what_to_do(make_bench):
    bench = make_bench(has_autopilot=False)
    station = bench.station()
    assert await station.command(400, 1.0) == FAILED
    assert any("[vehicles.rov.autopilot]" in "".join(station.texts()) for _ in [0])
    bench.run(1.1)
    assert station.last("HEARTBEAT").base_mode & 128 == 0
    station.send("MANUAL_CONTROL", 1, 1000, 0, 500, 0, 0)
    assert not bench.rov.commands


async def test_numbers_that_are_none_change_nothing(bench):
    station = bench.station()
    nan = math.nan
    for number in (400, 176, 511, 510, 512, 410, 179, 178, 115, 209, 183, 17, 300, 224, 185, 205, 246):
        if number != 17:
            assert await station.command(number, *(nan,) * 7) not in (None, ACCEPTED) or number == 410, number
        assert await station.command(number, *(math.inf,) * 7) is not None
    assert not bench.rov.state["armed"]


async def test_message_intervals(bench):
    station = bench.station()
    assert await station.command(511, 31.0, 50_000.0) == ACCEPTED  # ATTITUDE_QUATERNION
    bench.run(1.0)
    assert len(station.of("ATTITUDE_QUATERNION")) == 21  # at once, then 20 a second
    assert await station.command(510, 31.0) == ACCEPTED
    assert station.last("MESSAGE_INTERVAL").interval_us == 50_000
    assert await station.command(511, 31.0, -1.0) == ACCEPTED
    count = len(station.of("ATTITUDE_QUATERNION"))
    bench.run(1.0)
    assert len(station.of("ATTITUDE_QUATERNION")) == count
    assert await station.command(511, 999.0, 50_000.0) == FAILED
    assert await station.command(511, 31.0, -7.0) == DENIED


# -- motors and servo outputs --------------------------------------------------------------------------------------------------------------


def pulses(station):
    message = station.last("SERVO_OUTPUT_RAW")
    return [getattr(message, f"servo{k}_raw") for k in range(1, 17)]


def show(bench, station):
    bench.run(1.1)
    station.heard.clear()
    bench.run(1.1)
    return pulses(station)


async def test_servo_outputs_are_those_of_the_motors_and_the_payload(bench):
    station = bench.station()
    assert show(bench, station) == [1500] * 8 + [1100, 1500] + [0] * 6  # lights dark, camera level
    bench.rov.state["outputs"] = (1.0, -1.0, 0.25, 0.0, 0.0, 0.0, 0.0, -0.5)
    assert show(bench, station)[:8] == [1500] * 8, "disarmed"
    bench.rov.state["armed"] = True
    assert show(bench, station)[:8] == [1900, 1100, 1600, 1500, 1500, 1500, 1500, 1300]
    assert await station.command(205, 45.0) == ACCEPTED
    assert await station.command(183, 12, 1700) == ACCEPTED
    assert show(bench, station)[8:12] == [1100, 1900, 0, 1700]
    told = {m.name: m.value for m in station.of("NAMED_VALUE_FLOAT")}
    assert (told["CamTilt"], told["CamPan"]) == (0.0, 0.5), "as ArduSub tells a camera that looks up"
    w, x, y, z = station.last("GIMBAL_DEVICE_ATTITUDE_STATUS").q
    assert (w, x, y, z) == pytest.approx((math.cos(math.pi / 8), 0, math.sin(math.pi / 8), 0))
    assert await station.command(183, 3, 1700) == FAILED, "an output of a motor is the autopilot's"


async def test_a_servo_output_of_the_lights_is_their_brightness_and_that_of_the_mount_is_the_mounts(bench):
    station = bench.station()
    assert await station.command(183, 9, 1500) == ACCEPTED
    assert await station.command(183, 10, 1500) == FAILED
    assert show(bench, station)[8] == 1500
    assert {m.name: m.value for m in station.of("NAMED_VALUE_FLOAT")}["Lights1"] == 0.5


def test_lights_of_a_button(bench):
    station = bench.station()
    bench.vehicle.parameters.set("BTN3_FUNCTION", 32.0)
    station.send("MANUAL_CONTROL", 1, 0, 0, 500, 0, 8)
    assert show(bench, station)[8] == 1200  # one of eight steps


def test_six_motors_leave_the_camera_where_it_is(make_bench):
    bench = make_bench(thrusters=6)
    station = bench.station()
    assert show(bench, station) == [1500] * 6 + [0, 1500, 1100, 1500] + [0] * 6


async def test_a_motor_test(bench):
    station = bench.station()
    assert await station.command(209, 0, 1, 1600, 1, 0, 2) == FAILED
    assert station.texts()[-1] == "Arm motors before testing motors."
    await station.command(400, 1.0)
    for motor, kind, throttle in ((0, 1, 1600), (7, 1, 1100), (2, 0, 75.0)):
        assert await station.command(209, motor, kind, throttle, 1, 0, 2) == ACCEPTED
    assert bench.rov.commanded("test")[-1] == {"outputs": (0.25, 0, 0.5, 0, 0, 0, 0, -1.0)}
    assert await station.command_int(209, (0, 1, 1500, 1), 0, 2, 0.0) == ACCEPTED
    assert bench.rov.commanded("test")[-1] == {"outputs": (0, 0, 0.5, 0, 0, 0, 0, -1.0)}
    for bad in (
        (8, 1, 1600, 1, 0, 2),
        (-1, 1, 1600, 1, 0, 2),
        (0, 2, 1600, 1, 0, 2),
        (0, 1, math.nan, 1, 0, 2),
        (0, 1, 0, 1, 0, 2),  # no pulse; not full astern
        (0, 1, 1600, 1, 0, 0),
    ):
        assert await station.command(209, *bad) == FAILED, bad
    assert len(bench.rov.commanded("test")) == 4
    await station.command(400, 0.0)
    await station.command(400, 1.0)
    assert await station.command(209, 1, 1, 1700, 1, 0, 2) == ACCEPTED
    assert bench.rov.commanded("test")[-1] == {"outputs": (0, 0.5, 0, 0, 0, 0, 0, 0)}, "a test begins with all at rest"


async def test_a_motor_test_that_ended_elsewhere_begins_with_all_at_rest(bench):
    """By another client that disarms and arms, or by a change of mode."""
    station = bench.station()
    bench.rov.state["armed"] = True
    assert await station.command(209, 0, 1, 1900, 1, 0, 2) == ACCEPTED
    bench.run(0.4)
    assert await station.command(209, 1, 1, 1900, 1, 0, 2) == ACCEPTED
    assert bench.rov.commanded("test")[-1] == {"outputs": (1.0, 1.0, 0, 0, 0, 0, 0, 0)}
    bench.run(0.6)
    assert await station.command(209, 2, 1, 1700, 1, 0, 2) == ACCEPTED
    assert bench.rov.commanded("test")[-1] == {"outputs": (0, 0, 0.5, 0, 0, 0, 0, 0)}


async def test_a_motor_test_that_the_autopilot_refuses_is_told(bench):
    station = bench.station()
    bench.rov.state["armed"] = True
    bench.rov.held.add("rov/autopilot/test")
    assert await station.command(209, 0, 1, 1600, 1, 0, 2) == ACCEPTED
    fault = Refused("denied", "works while the autopilot is armed").fault
    bench.rov.calls[-1].finish(Reply(0, 0, fault=fault))
    assert station.texts()[-1] == "Motor test: works while the autopilot is armed"


def test_outputs_beyond_the_eighth_motor_are_no_motors(make_bench):
    """SERVOn_FUNCTION 41 is something else in ArduSub."""
    bench = make_bench(thrusters=10)
    station = bench.station()
    bench.vehicle.parameters.set("SERVO11_FUNCTION", 41.0)
    assert show(bench, station) == [1500] * 8 + [1100, 1500] + [0] * 6


async def test_a_station_that_floods_keeps_others_from_nothing(bench):
    """What waits for the world is counted and queued for each channel, and for the vehicle's own fail-safes."""
    flood, other = bench.station(), bench.station()
    bench.rov.held.add("rov/autopilot/set_mode")
    for _ in range(UNANSWERED + 10):
        bench.now += 0.001
        flood.send("SET_MODE", 1, 1, 2)
    assert len(bench.rov.calls) == UNANSWERED
    other.send("SET_MODE", 1, 1, 2)
    bench.vehicle.bridge.set_mode(BY_NAME["ALT_HOLD"], lambda reason: None)
    assert len(bench.rov.calls) == UNANSWERED + 2
    assert set(bench.rov.queues) == {str(flood.channel.number), str(other.channel.number), "0"}
    assert len({call.source for call in bench.rov.calls}) == 1
    bench.router.close(flood.channel)
    for call in bench.rov.calls:
        call.finish(Reply(1, 1))
