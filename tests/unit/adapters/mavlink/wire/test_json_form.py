"""Messages as JSON: a table both ways, pymavlink as the judge of the frames, all messages of the dialect, and garbage."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from uwserver_adapters.mavlink.wire.dialect import Dialect
from uwserver_adapters.mavlink.wire.frames import Decoder, Frame
from uwserver_adapters.mavlink.wire.json_form import LONGEST, BadJson, fields_of, frame_of, text_of

pymavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")

DIALECT = Dialect()
SENSORS = {"bits": 0x0300_0008}

# The message as pymavlink has it, and as mavlink2rest shows it. HEARTBEAT, DISTANCE_SENSOR and POWER_STATUS have the form that its users quote.
TABLE: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
    (
        "heartbeat",
        (12, 3, 81, 19, 5, 3),
        {
            "custom_mode": 19,
            "mavtype": {"type": "MAV_TYPE_SUBMARINE"},
            "autopilot": {"type": "MAV_AUTOPILOT_ARDUPILOTMEGA"},
            "base_mode": {"bits": 81},
            "system_status": {"type": "MAV_STATE_CRITICAL"},
            "mavlink_version": 3,
        },
    ),
    (
        "attitude",
        (68104588, -0.25, 0.5, -1.25, 0.0, 0.125, 2.0),
        {
            "time_boot_ms": 68104588,
            "roll": -0.25,
            "pitch": 0.5,
            "yaw": -1.25,
            "rollspeed": 0.0,
            "pitchspeed": 0.125,
            "yawspeed": 2.0,
        },
    ),
    ("power_status", (5000, 0, 3), {"Vcc": 5000, "Vservo": 0, "flags": {"bits": 3}}),
    (
        "distance_sensor",
        (4482, 20, 700, 25, 1, 0, 25, 255, 0.5, 0.25, (1.0, 0.0, 0.0, 0.0), 90),
        {
            "time_boot_ms": 4482,
            "min_distance": 20,
            "max_distance": 700,
            "current_distance": 25,
            "mavtype": {"type": "MAV_DISTANCE_SENSOR_ULTRASOUND"},
            "id": 0,
            "orientation": {"type": "MAV_SENSOR_ROTATION_PITCH_270"},
            "covariance": 255,
            "horizontal_fov": 0.5,
            "vertical_fov": 0.25,
            "quaternion": [1.0, 0.0, 0.0, 0.0],
            "signal_quality": 90,
        },
    ),
    (
        "param_value",
        (b"FRAME_CONFIG", 2.0, 9, 446, 3),
        {
            "param_id": [*"FRAME_CONFIG", *"\0" * 4],
            "param_value": 2.0,
            "param_type": {"type": "MAV_PARAM_TYPE_REAL32"},
            "param_count": 446,
            "param_index": 3,
        },
    ),
    (
        "statustext",
        (4, b"Leak"),
        {"severity": {"type": "MAV_SEVERITY_WARNING"}, "text": [*"Leak", *"\0" * 46], "id": 0, "chunk_seq": 0},
    ),
    (
        "command_long",
        (1, 1, 400, 0, 1.0, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0),
        {
            "target_system": 1,
            "target_component": 1,
            "command": {"type": "MAV_CMD_COMPONENT_ARM_DISARM"},
            "confirmation": 0,
            "param1": 1.0,
            "param2": None,
            **{f"param{n}": 0.0 for n in range(3, 8)},
        },
    ),
    (
        "command_ack",
        (60_000, 3, 7, -2, 255, 190),
        {
            "command": 60_000,
            "result": {"type": "MAV_RESULT_UNSUPPORTED"},
            "progress": 7,
            "result_param2": -2,
            "target_system": 255,
            "target_component": 190,
        },
    ),
    (
        "sys_status",
        (0x0300_0008, 0x0300_0008, 0, 100, 16057, 50, -1, 0, 0, 0, 0, 0, 0),
        {
            "onboard_control_sensors_present": SENSORS,
            "onboard_control_sensors_enabled": SENSORS,
            "onboard_control_sensors_health": {"bits": 0},
            "load": 100,
            "voltage_battery": 16057,
            "current_battery": 50,
            "battery_remaining": -1,
            **dict.fromkeys(("drop_rate_comm", "errors_comm", *(f"errors_count{n}" for n in range(1, 5))), 0),
            **{f"onboard_control_sensors_{what}_extended": {"bits": 0} for what in ("present", "enabled", "health")},
        },
    ),
    (
        "gps_global_origin",
        (338103130, -1183938670, 15000, 1 << 63),
        {"latitude": 338103130, "longitude": -1183938670, "altitude": 15000, "time_usec": 1 << 63},
    ),
    (
        "manual_control",
        (1, 1000, -1000, 500, 0, 5),
        {
            "target": 1, "x": 1000, "y": -1000, "z": 500, "r": 0, "buttons": 5, "buttons2": 0, "enabled_extensions": 0,
            "s": 0, "t": 0, **{f"aux{n}": 0 for n in range(1, 7)},
        },
    ),
    (
        "file_transfer_protocol",
        (0, 255, 190, [*range(251)]),
        {"target_network": 0, "target_system": 255, "target_component": 190, "payload": [*range(251)]},
    ),
]  # fmt: skip


def framed(data: bytes) -> Frame:
    decoder = Decoder(DIALECT)
    decoder.receive(data)
    frame = decoder.next_event()
    assert isinstance(frame, Frame)
    return frame


def shown(data: bytes) -> dict[str, Any]:
    frame = framed(data)
    layout = DIALECT.by_id[frame.id]
    return dict(json.loads(text_of(frame, layout.name, fields_of(frame, layout))))


def text(message: dict[str, Any], **header: Any) -> bytes:
    return json.dumps(
        {"header": {"system_id": 1, "component_id": 1, "sequence": 7} | header, "message": message}
    ).encode()


@pytest.mark.parametrize(("name", "values", "fields"), TABLE, ids=[row[0] for row in TABLE])
def test_the_table_both_ways(name: str, values: tuple[Any, ...], fields: dict[str, Any]) -> None:
    mav = pymavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.seq = 7
    packed = getattr(mav, f"{name}_encode")(*values).pack(mav)
    message = {"type": name.upper(), **fields}
    assert shown(packed) == {"header": {"system_id": 1, "component_id": 1, "sequence": 7}, "message": message}
    assert frame_of(text(message), DIALECT) == packed


def test_every_message_of_the_dialect_comes_back() -> None:
    rng = np.random.default_rng(6)
    mav = pymavlink.MAVLink(None, srcSystem=9, srcComponent=8)
    for number, definition in pymavlink.mavlink_map.items():
        if number < 0:
            continue
        payload = rng.integers(0, 0x40, definition.unpacker.size, np.uint8).tobytes()  # floats below 2
        values = DIALECT.by_id[number].decode(payload, 9, 8).fields
        packed = definition(*(values[field] for field in definition.fieldnames)).pack(mav)
        assert frame_of(json.dumps(shown(packed)).encode(), DIALECT) == packed, definition.msgname


def test_numbers_and_texts_do_as_well() -> None:
    loose = frame_of(text({"type": "HEARTBEAT", "mavtype": 6, "base_mode": 4}), DIALECT)
    strict = {"type": "HEARTBEAT", "mavtype": {"type": "MAV_TYPE_GCS"}, "base_mode": {"bits": 4}}
    assert loose == frame_of(text(strict), DIALECT)
    short = frame_of(text({"type": "STATUSTEXT", "text": "Leak"}), DIALECT)
    assert short == frame_of(text({"type": "STATUSTEXT", "text": [*"Leak"]}), DIALECT)


GOOD = {"type": "COMMAND_LONG", "command": 400}


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "truncated"),
        (b"null", "object"),
        (b"{}", "header"),
        (b"\xff\xfe{", "malformed"),
        (b"[" * 40, "nested"),
        (b'{"header":{"system_id":1,"component_id":1},"message":{"type":' + b'{"a":' * 3000, "maps and lists"),
        (text(GOOD | {"param1": [[]]})[:-2] + b"," + b"[" * 40, "nested"),
        (b'{"header":{"system_id":1,"component_id":1},"message":{"\xff":1}}', "utf-8"),
        (b" " * (LONGEST + 1), "at most"),
        (text(GOOD, system_id=256), "system_id"),
        (text(GOOD, component_id=-1), "component_id"),
        (text(GOOD, sequence=1.5), "sequence"),
        (text({}), "no message None"),
        (text({"type": "NOTHING"}), "no message 'NOTHING'"),
        (text({"type": ["HEARTBEAT"]}), "no message"),
        (text(GOOD | {"param1": "1"}), "param1"),
        (text(GOOD | {"param1": True}), "param1"),
        (text(GOOD | {"param1": 10**60}), "param1"),
        (text(GOOD | {"target_system": 256}), "target_system"),
        (text(GOOD | {"target_system": None}), "target_system"),
        (text(GOOD | {"target_system": 1.0}), "target_system"),
        (text(GOOD | {"command": {"type": "MAV_CMD_NONE_SUCH"}}), "command"),
        (text(GOOD | {"command": {"type": ["MAV_CMD"]}}), "command"),
        (text(GOOD | {"command": {"bits": 1}}), "command"),
        (text({"type": "HEARTBEAT", "base_mode": {"bits": 256}}), "base_mode"),
        (text({"type": "HEARTBEAT", "base_mode": {"type": "MAV_MODE_FLAG_TEST_ENABLED"}}), "base_mode"),
        (text({"type": "PARAM_SET", "param_id": "SEVENTEEN_LETTERS"}), "param_id"),
        (text({"type": "PARAM_SET", "param_id": ["AB"]}), "param_id"),
        (text({"type": "PARAM_SET", "param_id": 5}), "param_id"),
        (text({"type": "DISTANCE_SENSOR", "quaternion": [0.0] * 5}), "quaternion"),
        (text({"type": "DISTANCE_SENSOR", "quaternion": 0.0}), "quaternion"),
        (text({"type": "DISTANCE_SENSOR", "quaternion": [[0.0]]}), "quaternion"),
    ],
)
def test_what_is_no_message_is_refused(data: bytes, told: str) -> None:
    with pytest.raises(BadJson, match=told):
        frame_of(data, DIALECT)


def test_fields_of_a_newer_definition_are_not_looked_at() -> None:
    # As Cockpit asks for the time, each 5 s; pymavlink 2.4.50 does not know that it has an address.
    asked = {"type": "TIMESYNC", "ts1": 844206199999, "tc1": 0, "target_system": 1, "target_component": 1}
    frame = framed(frame_of(text(asked, component_id=240), DIALECT))
    fields = fields_of(frame, DIALECT.by_name["TIMESYNC"])
    assert (fields["ts1"], fields["tc1"]) == (844206199999, 0)
    assert frame_of(text(GOOD | {"param8": []}), DIALECT) == frame_of(text(GOOD), DIALECT)


def test_broken_text_never_raises_anything_else() -> None:
    rng = np.random.default_rng(7)
    whole = text(
        {"type": "HEARTBEAT", "mavtype": {"type": "MAV_TYPE_GCS"}, "base_mode": {"bits": 4}, "custom_mode": 19}
    )
    for _ in range(2000):
        broken = bytearray(whole)
        for at in rng.integers(0, len(whole), int(rng.integers(1, 4))):
            broken[at] = int(rng.integers(0, 256))
        try:
            framed(frame_of(bytes(broken[: int(rng.integers(0, len(whole) + 1))]), DIALECT))
        except BadJson:
            continue
