"""Logs of PX4, made by hand: header, definitions, data."""

import math
import struct

import numpy as np
import pytest
from pyulog import ULog

from uwserver.logfiles import LogError
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.rules import mapping_of

S = 1_000_000_000


def message(kind, content):
    return struct.pack("<HB", len(content), ord(kind)) + content


def px4(count=50):
    raw = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 5_000_000)
    formats = [
        "vehicle_local_position:uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;",
        "vehicle_attitude:uint64_t timestamp;float[4] q;",
        "vehicle_gps_position:uint64_t timestamp;uint64_t time_utc_usec;",
    ]
    raw += b"".join(message("F", text.encode()) for text in formats)
    names = ["vehicle_local_position", "vehicle_attitude", "vehicle_gps_position", "vehicle_attitude"]
    raw += b"".join(message("A", struct.pack("<BH", int(k == 3), k) + name.encode()) for k, name in enumerate(names))
    for k in range(count):
        t = 5_000_000 + k * 100_000
        raw += message("D", struct.pack("<HQ6f", 0, t, k, 2.0, 3.0, 10.0, 0.0, 0.0))
        raw += message("D", struct.pack("<HQ4f", 1, t, 1.0, 0.0, 0.0, 0.0))
        raw += message("D", struct.pack("<HQ4f", 3, t, 0.0, 0.0, 0.0, 1.0))
    raw += message("D", struct.pack("<HQQ", 2, 6_000_000, 1_760_000_001_000_000))
    return raw + message("O", struct.pack("<H", 120))


def test_topics_fields_and_time(opened):
    log = opened(px4(), "flight.ulg")
    assert set(log.topics) == {
        "vehicle_local_position",
        "vehicle_attitude",
        "vehicle_gps_position",
        "vehicle_attitude[1]",
    }
    assert (log.kind, log.end_ns, log.epoch_ns) == ("ulg", 4_900_000_000, 1_760_000_000 * S)
    assert {f.name: f.type for f in log.topics["vehicle_attitude"].fields} == {"timestamp": "uint64", "q": "float32[4]"}
    datum = next(log.read({"vehicle_attitude[1]"}, start_ns=S))
    assert datum.value == {"timestamp": 6_000_000, "q": [0.0, 0.0, 0.0, 1.0]}
    assert log.remarks == ("1 dropouts of 0.120 s in all: the logger could not keep up",)


@pytest.mark.parametrize(
    ("topic", "field", "kind", "full"),
    [("actuator_motors", "control", "part", 1.0), ("actuator_outputs", "output", "pulse", 1.9e-3)],
)
def test_its_motors_turn_what_follows_it(opened, topic, field, kind, full):
    form = message("F", f"{topic}:uint64_t timestamp;float[4] {field};".encode())
    subscribed = message("A", struct.pack("<BH", 0, 9) + topic.encode())
    high = full * 1e6 if kind == "pulse" else full
    said = message("D", struct.pack("<HQ4f", 9, 5_100_000, high, 0.0, math.nan, 0.0))
    raw = px4()
    log = opened(raw[:16] + form + raw[16:] + subscribed + said, "flight.ulg")
    motion = pose_tracks(log, mapping_of(log))["filter"].track.motion
    assert (motion.names, motion.kinds) == (("1", "2", "3", "4"), (kind,) * 4)
    assert motion.values[0] == pytest.approx([full, 0.0, math.nan, 0.0], nan_ok=True)


def test_its_track(opened):
    log = opened(px4(), "flight.ulg")
    track = pose_tracks(log, mapping_of(log))["filter"].track
    assert track.p_NB[7].tolist() == [7.0, 2.0, 3.0]
    assert track.q_NB[7].tolist() == [1.0, 0.0, 0.0, 0.0]


def test_damaged_files_never_crash_and_print_nothing(opened, capsys):
    raw = px4(10)
    rng = np.random.default_rng(6)
    for k in range(150):
        hurt = bytearray(raw[: len(raw) - 3 * k] if k % 3 == 0 else raw)
        for at in rng.integers(16, len(hurt), 4):
            hurt[at] = int(rng.integers(0, 256))
        try:
            times = [d.t_ns for d in opened(bytes(hurt), "flight.ulg").read()]
        except LogError:
            continue
        assert times == sorted(times)
    assert capsys.readouterr().out == ""


def test_without_data(opened):
    with pytest.raises(LogError):
        opened(px4()[:40], "flight.ulg")


def test_what_does_not_fit_memory_is_refused(opened):
    with pytest.raises(LogError, match="kept in memory"):
        opened(px4(), "flight.ulg", record_bytes=100)


@pytest.mark.parametrize(
    "formats",
    [
        ["x:uint64_t timestamp;y[100] a;", "y:z[100] a;", "z:w[100] a;", "w:uint8_t[3] b;"],
        ["x:uint64_t timestamp;y[60000] a;", "y:z[60000] a;", "z:"],
        ["x:uint64_t timestamp;y a;", "y:x[2] a;"],
    ],
)
def test_arrays_of_types_of_arrays_are_counted_before_they_are_made(opened, formats, monkeypatch):
    raw = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    raw += b"".join(message("F", text.encode()) for text in formats)
    raw += message("A", struct.pack("<BH", 0, 0) + b"x") + message("D", struct.pack("<H", 0) + bytes(64)) * 2
    made = []
    monkeypatch.setattr(ULog._MessageAddLogged, "_parse_nested_type", lambda self, *a: made.append(a))
    with pytest.raises(LogError, match="more than 131072 columns"):
        opened(raw, "flight.ulg")
    assert not made
