"""Ports without a message of MAVLink and ROS are left out; what is written can be read again."""

from __future__ import annotations

import numpy as np
import pytest
from logs_made import MadeLog

from uwserver.frames import quat_from_rpy
from uwserver.logfiles.export.middleware import left_out, write_alog, write_rosbag2, write_tlog
from uwserver.logfiles.mapping import Mapping, PortMapping, parse_mapping
from uwserver.logfiles.ports import port_samples
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.rules import mapping_of


def ports(**fields: tuple[str, ...]) -> Mapping:
    return Mapping(ports={name: PortMapping("t", {field: field for field in each}) for name, each in fields.items()})


def test_a_port_whose_samples_were_never_valid_is_told_apart_from_one_that_has_no_message():
    mapping = ports(altimeter=("range",), sonar=("range", "head_angle"), imu=("f_S", "w_S"), half=("latitude",))
    assert left_out(mapping, {"imu"}) == [
        "left out, because no message fits: sonar, half",
        "left out, because no sample was valid: altimeter",
    ]


def test_nothing_is_told_where_all_were_written():
    assert left_out(ports(imu=("f_S", "w_S")), {"imu"}) == []


S = 10**9
MAPPING = parse_mapping("""
[tracks.rov]
position = { topic = "pose", north = "p.0", east = "p.1", down = "p.2" }
attitude = { topic = "pose", unit = "1", w = "q.0", x = "q.1", y = "q.2", z = "q.3" }
velocity = { topic = "pose", north = "v.0", east = "v.1", down = "v.2" }
[tracks.auv]
position = { topic = "pose", north = "p.1", east = "p.0", down = "p.2" }
[ports."rov/imu"]
topic = "imu"
fields.f_S = ["f.0", "f.1", "f.2"]
fields.w_S = ["w.0", "w.1", "w.2"]
[ports."rov/gps"]
topic = "gps"
fields.latitude = { field = "lat", unit = "deg" }
fields.longitude = { field = "lon", unit = "deg" }
[ports."rov/pressure"]
topic = "p"
fields.pressure = "p"
[ports."rov/altimeter"]
topic = "p"
fields.range = "r"
[ports."rov/strange"]
topic = "p"
fields.x = "p"
""")


@pytest.fixture
def log():
    data = []
    for k in range(40):
        q = quat_from_rpy(0.1, -0.2, 0.2 * k)
        data.append((k * S // 10, "pose", {"p": [1.0 * k, 2.0, 3.0 + 0.1 * k], "q": list(q), "v": [0.5, 0.0, 1.0]}))
        data.append((k * S // 10, "imu", {"f": [0.1, 0.2, -9.8], "w": [0.01, 0.02, 0.03]}))
        data.append((k * S // 10, "gps", {"lat": 60.0, "lon": 10.5}))
        data.append((k * S // 10, "p", {"p": 150_000.0, "r": 12.5}))
    made = MadeLog("csv", data)
    made.epoch_ns = 1_767_225_600 * S
    return made


def compare(one, two, velocity=True):
    assert np.array_equal(one.t_ns, two.t_ns)
    assert one.p_NB == pytest.approx(two.p_NB, abs=1e-5)
    assert np.abs((one.q_NB * two.q_NB).sum(axis=1)) == pytest.approx(1.0, abs=1e-6)
    if velocity:
        assert one.v_N == pytest.approx(two.v_N, abs=1e-6)


def test_moos(log, opened, tmp_path):
    tracks = pose_tracks(log, MAPPING)
    write_alog(log, MAPPING, tracks, tmp_path / "a.alog")
    again = opened((tmp_path / "a.alog").read_bytes(), "b.alog")
    assert again.epoch_ns == log.epoch_ns
    found = pose_tracks(again, mapping_of(again))
    compare(found["nav"].track, tracks["rov"].track, velocity=False)
    compare(found["auv"].track, tracks["auv"].track, velocity=False)
    assert next(again.read({"ROV_IMU_F_S_2"})).value["value"] == -9.8


def test_mavlink(log, opened, tmp_path):
    tracks = pose_tracks(log, MAPPING)
    assert write_tlog(log, MAPPING, tracks, tmp_path / "a.tlog") == ["left out, because no message fits: rov/strange"]
    again = opened((tmp_path / "a.tlog").read_bytes(), "b.tlog")
    assert again.remarks == ()
    found = pose_tracks(again, mapping_of(again))
    compare(found["vehicle_1"].track, tracks["rov"].track)
    compare(found["vehicle_2"].track, tracks["auv"].track, velocity=False)
    sample = {d.topic: d.value for d in port_samples(again, mapping_of(again))}
    assert sample["vehicle_1/pressure"]["pressure"] == pytest.approx(150_000.0)
    assert sample["vehicle_1/imu2"]["f_S"] == pytest.approx((0.1, 0.2, -9.8), abs=0.01)
    assert sample["vehicle_1/gps"]["latitude"] == pytest.approx(1.0471975512)
    assert sample["vehicle_1/altimeter"]["range"] == pytest.approx(12.5)


def test_ros_2(log, read_log, tmp_path):
    tracks = pose_tracks(log, MAPPING)
    assert write_rosbag2(log, MAPPING, tracks, tmp_path / "bag") == ["left out, because no message fits: rov/strange"]
    again = read_log(tmp_path / "bag")
    assert again.epoch_ns == log.epoch_ns
    found = pose_tracks(again, mapping_of(again))
    compare(found["rov_odometry"].track, tracks["rov"].track)
    sample = {d.topic: d.value for d in port_samples(again, mapping_of(again))}
    assert sample["rov/imu"]["f_S"] == pytest.approx((0.1, 0.2, -9.8))
    assert sample["rov/gps"]["longitude"] == pytest.approx(0.18325957146)
    raw = next(again.read({"/rov/imu"})).value
    assert raw["linear_acceleration"] == pytest.approx({"x": 0.1, "y": -0.2, "z": 9.8})
    with pytest.raises(FileExistsError):
        write_rosbag2(log, MAPPING, tracks, tmp_path / "bag")
