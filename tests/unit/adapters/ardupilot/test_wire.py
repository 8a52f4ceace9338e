"""Servo packets and lines, against a table of bytes and the reader that has the autopilot's own manners."""

from __future__ import annotations

import json
import math

import pytest
from uwserver_adapters.ardupilot import wire
from uwserver_adapters.ardupilot.wire import Frame
from uwserver_adapters.sil.in_the_loop import Scale
from uwserver_bench.autopilots.ardupilot_peer import Misread, read, servo_packet

STATE = (
    1_500_000_000,
    (0.01, -0.02, 0.03),
    (0.1, -0.2, -9.81),
    (1.5, -2.25, 19.0),
    (0.5, -0.5, 0.5, 0.5),
    (0.25, -1e-7, 3e-5),
)

# By hand: magic 0x481A, 1200 Hz, frame 7, channel 1 at 1500, channel 16 at 1900.
WHOLE_16 = bytes.fromhex("1a48 b004 07000000 dc05" + "0000" * 14 + "6c07")
WHOLE_32 = bytes.fromhex("8173 9001 ffffffff" + "dc05" * 32)


@pytest.mark.parametrize(
    ("data", "frame"),
    [
        (WHOLE_16, Frame(1200, 7, (1500, *[0] * 14, 1900))),
        (WHOLE_32, Frame(400, 2**32 - 1, (1500,) * 32)),
        (WHOLE_16[:-1], "bad_length"),
        (WHOLE_16 + b"\0", "bad_length"),
        (WHOLE_16[:10], "bad_length"),
        (WHOLE_16[:1], "bad_length"),
        (b"", "bad_length"),
        (WHOLE_16[:2] + WHOLE_32[2:], "bad_length"),  # 32 channels under the magic of 16
        (WHOLE_32[:2] + WHOLE_16[2:], "bad_length"),
        (b"\x00" * 40, "bad_magic"),
        (b"\xff" * 72, "bad_magic"),
        (b"\x48\x1a" + WHOLE_16[2:], "bad_magic"),  # the other byte order
        (b'{"timestamp":1}', "bad_magic"),
    ],
)
def test_servo_packets(data: bytes, frame: object) -> None:
    assert wire.parse(data) == frame


def test_every_truncation_is_refused() -> None:
    for whole in (WHOLE_16, WHOLE_32):
        assert all(wire.parse(whole[:size]) == "bad_length" for size in range(len(whole)))


def test_the_packets_of_the_peer_are_those_of_the_table() -> None:
    assert servo_packet(7, [1500, *[0] * 14, 1900]) == WHOLE_16
    assert servo_packet(2**32 - 1, [1500] * 32, 400, 32) == WHOLE_32


@pytest.mark.parametrize(
    ("pwm", "level"),
    [(0, 0.0), (1500, 0.0), (1900, 1.0), (1100, -1.0), (1700, 0.5), (1300, -0.5), (2200, 1.0), (800, -1.0), (65535, 1.0), (1, -1.0)],
)  # fmt: skip
def test_pulse_widths(pwm: int, level: float) -> None:
    scale = Scale()
    assert scale[pwm] == level
    assert scale[pwm] == level
    assert (pwm in scale.outside) == (pwm not in (0, 1500, 1900, 1100, 1700, 1300))


def test_neutral_need_not_be_in_the_middle() -> None:
    scale = Scale(1000, 1400, 2000)
    assert [scale[pwm] for pwm in (1000, 1200, 1400, 1700, 2000)] == [-1.0, -0.5, 0.0, 0.5, 1.0]


def test_a_line_is_read_as_it_was_meant() -> None:
    rest = wire.extras([1.25, 1000.0, 3.0, 4.0, 5.0, 6.5], (15.9, 12.5), True)
    data = wire.line(*STATE, rest)
    t_ns, w_B, f_B, p_NB, q_NB, v_NB_N = STATE
    assert (data[:1], data[-1:], data.count(b"\n")) == (b"\n", b"\n", 2)
    assert read(data) == {
        "timestamp": (t_ns * 1e-9,),
        "imu/gyro": w_B,
        "imu/accel_body": f_B,
        "position": p_NB,
        "quaternion": q_NB,
        "velocity": v_NB_N,
        **{f"rng_{n}": (value,) for n, value in enumerate((1.25, 1000.0, 3.0, 4.0, 5.0, 6.5), 1)},
        "no_time_sync": (1.0,),
        "battery/voltage": (15.9,),
        "battery/current": (12.5,),
    }
    whole = json.loads(data)  # and any JSON reader agrees
    assert whole["imu"] == {"gyro": list(w_B), "accel_body": list(f_B)}
    assert whole["velocity"] == list(v_NB_N)


def test_what_is_not_configured_is_not_sent() -> None:
    keys = {"timestamp", "imu/gyro", "imu/accel_body", "position", "quaternion", "velocity"}
    assert set(read(wire.line(*STATE, wire.extras([], None, False)))) == keys


@pytest.mark.parametrize("scale", [1e-12, 1e-5, 1.0, 1e5, 1e9])
def test_numbers_of_any_size_are_read_back(scale: float) -> None:
    vector = (scale / 3.0, -scale * math.pi, scale)
    state = read(wire.line(1, vector, vector, vector, (1.0, 0.0, 0.0, 0.0), vector, ""))
    assert all(state[key] == pytest.approx(vector, rel=1e-8) for key in ("imu/gyro", "position", "velocity"))


def test_time_keeps_its_ticks_for_days() -> None:
    tick_ns = 833_333
    day = 86_400 * 10**9
    stamps = [read(wire.line(day + n * tick_ns, *STATE[1:], ""))["timestamp"][0] for n in (0, 1)]
    assert stamps[1] - stamps[0] == pytest.approx(tick_ns * 1e-9, abs=1e-9)


@pytest.mark.parametrize(
    "text",
    [
        '{"timestamp": 1.0,"imu": {"gyro": [0, 0, 0],"accel_body": [0,0,0]},"position": [0,0,0],"quaternion": [1,0,0,0],"velocity": [0,0,0]}',
        '{"timestamp":1,"imu":{"gyro":[0,0,0],"accel_body":[0,0,0]},"position":[0,0,0],"velocity":[0,0,0]}',
        '{"timestamp":1,"imu":{"gyro":[0,0,nan],"accel_body":[0,0,0]},"position":[0,0,0],"quaternion":[1,0,0,0],"velocity":[0,0,0]}',
        '{"imu":{"gyro":[0,0,0],"accel_body":[0,0,0]},"position":[0,0,0],"quaternion":[1,0,0,0],"velocity":[0,0,0]}',
    ],
)
def test_the_reader_of_the_tests_is_as_strict_as_the_autopilots(text: str) -> None:
    with pytest.raises(Misread):
        read(f"\n{text}\n".encode())


def test_the_reader_of_the_tests_takes_the_first_place_of_a_name() -> None:
    text = '{"timestamp":1,"imu":{"gyro":[0,0,0],"accel_body":[0,0,0]},"position_enu":[7,8,9],"position":[1,2,3],'
    text += '"quaternion":[1,0,0,0],"velocity":[0,0,0]}'
    with pytest.raises(Misread):  # behind "position" it skips two characters, and stands in "_enu"
        read(f"\n{text}\n".encode())
