"""The A50's JSON: keys and types of the maker's example reports, numbers of the sample, commands, garbage; its positions in closed form."""

from __future__ import annotations

import asyncio
import json
import math
from typing import Any

import pytest
from devices_rig import ATTITUDE, DVL, EPOCH_NS, LOCKED, LOST, S, ask, make_context, sample
from uwserver_adapters.devices import water_linked_a50
from uwserver_adapters.devices.device import Garbage
from uwserver_adapters.devices.water_linked_a50 import DeadReckoning, WaterLinkedA50, WaterLinkedA50Table

from uwserver.adapter import CannotServe
from uwserver.frames import quat_from_rpy
from uwserver.testing import CodecCase, FakeContext, check_codec
from uwserver.testing.codecs import read_all


def run(reckoning: DeadReckoning, yaw: float, v: tuple[float, float, float], start: int, count: int) -> None:
    """`count` pings at 10 Hz from a time on (in tenths of seconds), the attitude with each."""
    for i in range(start, start + count):
        reckoning.see_attitude(i * S // 10, quat_from_rpy(0.0, 0.0, yaw))
        reckoning.see_velocity(i * S // 10, v, 0.01)


def test_a_straight_line_is_along_the_heading_of_the_start():
    reckoning = DeadReckoning()
    run(reckoning, 2.0, (1.0, 0.5, 0.25), 0, 101)
    assert reckoning.position() == pytest.approx((10.0, 5.0, 2.5))
    assert reckoning.variance == pytest.approx(100 * (0.01 * 0.1) ** 2)


def test_after_a_right_angle_forward_is_along_y():
    reckoning = DeadReckoning()
    run(reckoning, 0.7, (1.0, 0.0, 0.0), 0, 1)
    run(reckoning, 0.7 + math.pi / 2, (1.0, 0.0, 0.0), 1, 100)
    x, y, _ = reckoning.position()
    assert (x, y) == pytest.approx((0.05, 9.95))  # of the step in which it turns, half is forward
    assert reckoning.attitude()[2] == pytest.approx(math.pi / 2)


def test_a_reset_begins_at_zero_with_the_present_heading():
    reckoning = DeadReckoning()
    run(reckoning, 0.0, (1.0, 0.0, 0.0), 0, 50)
    run(reckoning, math.pi / 2, (1.0, 0.0, 0.0), 50, 1)
    reckoning.reset()
    assert reckoning.position() == (0.0, 0.0, 0.0)
    run(reckoning, math.pi / 2, (1.0, 0.0, 0.0), 51, 11)
    assert reckoning.position() == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)


def test_a_gap_is_not_counted_and_the_position_stands():
    reckoning = DeadReckoning()
    run(reckoning, 0.0, (1.0, 0.0, 0.0), 0, 11)
    reckoning.see_attitude(60 * S, quat_from_rpy(0.0, 0.0, 0.0))
    assert not reckoning.is_tracking
    assert reckoning.position()[0] == pytest.approx(1.0)
    run(reckoning, 0.0, (1.0, 0.0, 0.0), 600, 11)
    assert reckoning.position()[0] == pytest.approx(2.0)


def test_a_late_ping_is_turned_by_the_attitude_of_its_own_time():
    reckoning = DeadReckoning()
    for i in range(20):
        reckoning.see_attitude(i * S // 100, quat_from_rpy(0.0, 0.0, 0.0))
    reckoning.see_attitude(20 * S // 100, quat_from_rpy(0.0, 0.0, math.pi / 2))
    reckoning.see_velocity(0, (1.0, 0.0, 0.0), 0.0)
    reckoning.see_velocity(S // 10, (1.0, 0.0, 0.0), 0.0)
    # 0.1 s between the pings, and 0.1 s since the last.
    assert reckoning.position() == pytest.approx((0.2, 0.0, 0.0))


def test_between_pings_the_position_goes_on():
    reckoning = DeadReckoning()
    run(reckoning, 0.0, (2.0, 0.0, 0.0), 0, 2)
    reckoning.see_attitude(6 * S // 10, quat_from_rpy(0.0, 0.0, 0.0))
    assert reckoning.position()[0] == pytest.approx(1.2)


# The example of the maker's documentation of json_v3.3, its numbers shortened.
DOCUMENTED = """{"time":106.39,"vx":-3.7e-05,"vy":5.7e-05,"vz":2.5e-05,"fom":0.00016,"covariance":[[2.4e-08,-3.4e-09,-1.7e-09],
[-3.4e-09,1.5e-08,4.0e-10],[-1.7e-09,4.0e-10,1.6e-09]],"altitude":0.495,"transducers":[
{"id":0,"velocity":0.0001,"distance":0.557,"rssi":-30.5,"nsd":-88.7,"beam_valid":true},
{"id":1,"velocity":-1.5e-05,"distance":0.566,"rssi":-31.1,"nsd":-89.5,"beam_valid":true},
{"id":2,"velocity":2.8e-05,"distance":0.538,"rssi":-27.2,"nsd":-97.0,"beam_valid":true},
{"id":3,"velocity":1.9e-05,"distance":0.547,"rssi":-28.0,"nsd":-88.3,"beam_valid":true}],"velocity_valid":true,"status":0,
"tracking_mode":"bottom","format":"json_v3.3","type":"velocity","time_of_validity":1638191471563017,"time_of_transmission":1638191471752336}"""
POSITION = """{"ts":49056.809,"x":12.4,"y":64.6,"z":1.77,"std":0.002,"roll":0.6,"pitch":0.6,"yaw":0.6,"type":"position_local","status":0,
"format":"json_v3.3"}"""


def shape(value: Any) -> Any:
    """Keys in their order, and types."""
    if isinstance(value, dict):
        return [(key, shape(entry)) for key, entry in value.items()]
    return [shape(entry) for entry in value] if isinstance(value, list) else type(value)


def make(context: FakeContext | None = None, **keys: Any) -> WaterLinkedA50:
    return WaterLinkedA50Table(sensor="rov/dvl", **keys).build(context or make_context())


def one(messages: list[bytes]) -> dict[str, Any]:
    (message,) = messages
    assert message.endswith(b"\r\n")
    assert message.count(b"\n") == 1
    said: dict[str, Any] = json.loads(message)
    return said


def test_a_velocity_report_has_keys_order_and_types_of_the_makers():
    report = one(make().see(sample(DVL, LOCKED, 1.0, late_s=0.19)))
    assert shape(report) == shape(json.loads(DOCUMENTED))


def test_a_velocity_report_has_the_numbers_of_the_sample():
    device = make()
    device.see(sample(DVL, LOCKED, 1.0))
    report = one(device.see(sample(DVL, LOCKED, 1.125, late_s=0.19)))
    assert (report["vx"], report["vy"], report["vz"]) == (0.5, 0.1, -0.2)
    assert (report["fom"], report["altitude"], report["velocity_valid"]) == (0.004, 2.5, True)
    assert report["covariance"][1] == pytest.approx([2e-6, 3e-5, 0.0])
    assert report["time"] == 125.0
    assert report["time_of_validity"] == EPOCH_NS // 1000 + 1_125_000
    assert report["time_of_transmission"] == EPOCH_NS // 1000 + 1_315_000
    assert [beam["distance"] for beam in report["transducers"]] == [2.6, 2.7, 2.8, -1.0]
    assert [beam["beam_valid"] for beam in report["transducers"]] == [True, True, True, False]


def test_without_lock_the_report_says_so():
    report = one(make().see(sample(DVL, LOST, valid=False)))
    assert (report["velocity_valid"], report["altitude"], report["vx"]) == (False, -1.0, 0.0)


def test_the_mounting_offset_turns_velocity_and_covariance():
    device = make()
    replies, _ = ask(device, b'{"command":"set_config","parameters":{"mounting_rotation_offset":90}}\n')
    assert one(replies)["success"] is True
    report = one(device.see(sample(DVL, LOCKED)))
    # Turned to starboard by a right angle, what is forward for the device is starboard for the vehicle.
    assert (report["vx"], report["vy"]) == pytest.approx((-0.1, 0.5))
    assert (report["covariance"][0][0], report["covariance"][1][1], report["covariance"][0][1]) == pytest.approx(
        (3e-5, 1e-5, -2e-6)
    )


def test_positions_come_five_times_a_second_with_the_shape_of_the_makers():
    device = make(attitude="rov/attitude")
    reports = []
    for i in range(501):
        reports += device.see(sample(ATTITUDE, (quat_from_rpy(0.1, -0.2, 1.0), 1.0), i / 50))
        if i % 5 == 0:
            device.see(sample(DVL, LOCKED, i / 50))
    assert len(reports) == 51
    last = json.loads(reports[-1])
    assert shape(last) == shape(json.loads(POSITION))
    assert last["ts"] == pytest.approx(EPOCH_NS / 1e9 + 10.0)
    assert (last["roll"], last["pitch"], last["yaw"]) == pytest.approx((5.7296, -11.4592, 0.0), abs=1e-3)
    assert last["x"] ** 2 + last["y"] ** 2 + last["z"] ** 2 == pytest.approx(10.0**2 * 0.3, rel=1e-2)
    one(ask(device, b'{"command":"reset_dead_reckoning"}\n')[0])
    first = one(device.see(sample(ATTITUDE, (quat_from_rpy(0.1, -0.2, 1.0), 1.0), 10.2)))
    assert (first["x"], first["y"], first["z"], first["std"]) == (0.0, 0.0, 0.0, 0.0)


def test_commands_are_answered_in_the_documented_form():
    device = make(speed_of_sound_mps=1475.0)
    said = one(ask(device, b'{"command": "get_config"}\n')[0])
    assert said == {
        "response_to": "get_config", "success": True, "error_message": "",
        "result": {
            "speed_of_sound": 1475.0, "acoustic_enabled": True, "dark_mode_enabled": False, "mounting_rotation_offset": 0.0,
            "range_mode": "auto", "periodic_cycling_enabled": True,
        },
        "format": "json_v3.3", "type": "response",
    }  # fmt: skip
    for command in ("reset_dead_reckoning", "calibrate_gyro", "trigger_ping"):
        said = one(ask(device, b'{"command":"%s"}\n' % command.encode())[0])
        assert (said["response_to"], said["success"], said["result"]) == (command, True, None)
    assert one(ask(device, b'{"command":"get_version_info"}\n')[0])["result"]["product_name"] == "DVL A50"


def test_set_config_reaches_the_sensor_and_is_kept_once_it_was_taken():
    async def scene() -> None:
        context = make_context()
        device = make(context)
        replies, _ = ask(device, b'{"command":"set_config","parameters":{"speed_of_sound":1480,"range_mode":"=2"}}\n')
        assert replies == []
        await asyncio.sleep(0.01)
        assert one(replies)["success"] is True
        assert [(call.service, dict(call.args)) for call in context.calls] == [
            ("rov/dvl/set", {"sound_speed": 1480.0, "range_mode": 2})
        ]
        assert (device.configuration.speed_of_sound, device.configuration.range_mode) == (1480.0, "=2")

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ('{"speed_of_sound":5000}', "2000"),
        ('{"speed_of_sound":"fast"}', "str"),
        ('{"speed_of_sound":null}', "null"),
        ('{"speed_of_sond":1480}', "speed_of_sond"),
        ('{"range_mode":"1<=3"}', "not simulated"),
        ('{"range_mode":"=2","dark_mode_enabled":3}', "bool"),
        ("{}", "parameters"),
        ("[1]", "parameters"),
    ],
)
def test_a_wrong_set_config_changes_nothing_and_says_why(parameters: str, word: str):
    context = make_context()
    device = make(context)
    before = device.configuration
    said = one(ask(device, b'{"command":"set_config","parameters":%s}\n' % parameters.encode())[0])
    assert (said["success"], said["response_to"]) == (False, "set_config")
    assert word in said["error_message"]
    assert device.configuration == before
    assert context.calls == []


def test_without_sound_nothing_is_heard_but_pings_that_were_asked_for():
    device = make()
    ask(device, b'{"command":"set_config","parameters":{"acoustic_enabled":false}}\n')
    assert device.see(sample(DVL, LOCKED)) == []
    replies, _ = ask(device, b'{"command":"trigger_ping"}\n' * 16)
    assert [json.loads(reply)["success"] for reply in replies] == [True] * 15 + [False]
    assert sum(len(device.see(sample(DVL, LOCKED, t / 10))) for t in range(1, 40)) == 15


SHORT = 500
"""Longest line where lines are read byte by byte."""
GARBAGE = (
    b"\xff\x00\x80 nothing\n",
    b"{}\n",
    b"[1,2]\n",
    b'{"command":7}\n',
    b'{"command":"fly"}\n',
    b"[" * 400 + b"\n",
    b"x" * (SHORT + 1) + b"\n",
)


def test_lines_are_read_whole_and_byte_by_byte_and_after_garbage(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(water_linked_a50, "LINE_LIMIT", SHORT)
    cases = [
        CodecCase("get", b'{"command": "get_config"}\r\n', (b'{"command": "get_config"}',)),
        CodecCase("reset", b'{"command":"reset_dead_reckoning"}\n', (b'{"command":"reset_dead_reckoning"}',)),
    ]
    check_codec(make().reader, cases, need_data=None, garbage=GARBAGE, resynchronises=True)


def test_a_line_that_is_too_long_is_garbage():
    limit, command = water_linked_a50.LINE_LIMIT, b'{"command":"get_config"}'
    first, *_, last = read_all(make().reader(), [b"x" * (limit + 1) + b"\n" + command + b"\n"], None)
    assert isinstance(first, Garbage)
    assert last == command
    assert len(ask(make(), b"[" * (limit - 1) + b"\n")[1]) == 1, "nested as deep as a line allows"


@pytest.mark.parametrize("garbage", GARBAGE[:5])
def test_garbage_is_counted_and_answered_and_the_next_command_is_obeyed(garbage: bytes):
    replies, bad = ask(make(), garbage + b'{"command":"get_config"}\n')
    assert len(bad) == 1
    first, second = map(json.loads, replies)
    assert (first["success"], second["success"]) == (False, True)
    assert first["error_message"]


def test_a_sensor_that_is_no_dvl_is_told():
    with pytest.raises(CannotServe, match='sensor: "rov/depth" has no field "v_S", it has: depth, temperature'):
        WaterLinkedA50Table(sensor="rov/depth").build(make_context())
    with pytest.raises(CannotServe, match=r'no sensor .*"rov/dvll".*rov/dvl'):
        WaterLinkedA50Table(sensor="rov/dvll").build(make_context())
