"""Telemetry logs, against pymavlink's own reader. Also of uwserver.logfiles.readers.indexed."""

import math
import struct

import numpy as np
import pytest
from logs_rig import START_US, m, telemetry, tlog
from pymavlink import mavutil

from uwserver.logfiles import LogError, open_log


def written(tmp_path, data):
    file = tmp_path / "dive.tlog"
    file.write_bytes(data)
    return file


def by_mavutil(file):
    link = mavutil.mavlink_connection(str(file), dialect="ardupilotmega")
    found = []
    while (message := link.recv_msg()) is not None:
        if message.get_type() == "BAD_DATA" or message.get_type().startswith("UNKNOWN"):
            continue
        value = message.to_dict()
        value.pop("mavpackettype")
        name = f"{message.get_srcSystem()}/{message.get_srcComponent()}/{message.get_type()}"
        found.append((round(message._timestamp * 1e6), name, value))
    link.close()
    return found


@pytest.mark.parametrize("version1", [False, True])
def test_every_message_is_that_of_mavutil(tmp_path, version1):
    file = written(tmp_path, tlog(telemetry(version1=version1) + telemetry(system=7, version1=version1)))
    log = open_log(file)
    theirs = by_mavutil(file)
    ours = [(round((log.epoch_ns + d.t_ns) / 1000), d.topic, d.value) for d in log.read()]
    assert len(ours) == len(theirs) > 400
    assert ours == theirs
    assert {"1/1/ATTITUDE", "7/1/ATTITUDE"} <= set(log.topics)
    assert log.remarks == ()


def test_signed_frames_and_frames_of_unknown_messages(tmp_path):
    mav = m.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = b"k" * 32, True, 1
    frames = [(START_US + k, bytes(m.MAVLink_system_time_message(k, k).pack(mav))) for k in range(20)]
    strange = b"\xfd\x02\0\0\0\x01\x01\x11\x22\x33" + b"ab" + b"\0\0"
    frames[10:10] = [(START_US + 9, strange)]
    log = open_log(written(tmp_path, tlog(frames)))
    assert log.topics["1/1/SYSTEM_TIME"].count == 20
    assert log.remarks == ("1 frames were skipped: their message numbers are in no known dialect (3351057)",)


def test_fields_tell_type_and_unit(tmp_path):
    log = open_log(written(tmp_path, tlog(telemetry(1.0))))
    fields = {f.name: f for f in log.topics["1/1/ODOMETRY"].fields}
    assert (fields["q"].type, fields["x"].type, fields["x"].unit) == ("float[4]", "float", "m")
    assert {f.name: f.type for f in log.topics["1/1/PARAM_VALUE"].fields}["param_id"] == "char[16]"


def test_damaged_frames_are_left_out_and_told(tmp_path):
    frames = telemetry(5.0)
    data = bytearray(tlog(frames))
    whole = open_log(written(tmp_path, bytes(data)))
    n = sum(t.count for t in whole.topics.values())
    data[len(data) // 2] ^= 0xFF  # in some frame
    log = open_log(written(tmp_path, bytes(data[:40]) + b"\xfd\xfe noise \xfd" + bytes(data[40:])))
    left = sum(t.count for t in log.topics.values())
    assert n - 4 <= left < n
    assert "bytes are no frame" in log.remarks[0]


def test_truncation_anywhere_loses_the_last_frame_alone(tmp_path):
    data = tlog(telemetry(0.5))
    whole = list(open_log(written(tmp_path, data)).read())
    for cut in range(60, len(data), 7):
        log = open_log(written(tmp_path, data[:cut]))
        some = list(log.read())
        assert some == whole[: len(some)]
        log.close()


def test_flipped_bits_never_crash(tmp_path):
    data = tlog(telemetry(0.5))
    rng = np.random.default_rng(3)
    for _ in range(150):
        hurt = bytearray(data)
        for at in rng.integers(0, len(data), 6):
            hurt[at] ^= 1 << int(rng.integers(0, 8))
        try:
            log = open_log(written(tmp_path, bytes(hurt)))
        except LogError:
            continue
        times = [d.t_ns for d in log.read()]
        assert times == sorted(times)


def test_only_what_is_wanted_is_read(tmp_path):
    log = open_log(written(tmp_path, tlog(telemetry(10.0))))
    got = list(log.read({"1/1/ATTITUDE", "no such"}, start_ns=2_000_000_000, end_ns=3_000_000_000))
    assert {d.topic for d in got} == {"1/1/ATTITUDE"}
    assert [d.value["time_boot_ms"] for d in got] == list(range(2000, 3000, 100))
    assert math.isclose(got[0].value["roll"], 0.2, rel_tol=1e-6)


def test_a_file_that_only_looks_like_one(tmp_path):
    with pytest.raises(LogError, match="no MAVLink frame"):
        open_log(written(tmp_path, struct.pack(">Q", START_US) + b"\xfe" * 300))
