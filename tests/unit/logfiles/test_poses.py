"""Tracks in NED, FRD and SI, whatever a log has."""

import math

import numpy as np
import pytest
from logs_made import MadeLog

from uwserver.frames import attitude_enu_flu, quat_from_rpy
from uwserver.logfiles import LogError
from uwserver.logfiles.mapping import parse_mapping
from uwserver.logfiles.poses import pose_tracks

S = 1_000_000_000


def track(log, text):
    return pose_tracks(log, parse_mapping('format = "uwserver-log-mapping-1"\n[tracks.x]\n' + text))["x"]


def close(q, expected):
    return abs(abs(float(np.dot(q, expected))) - 1.0) < 1e-12


def test_enu_and_flu_become_ned_and_frd():
    """A robot of ROS that heads east, nose up, 3 m east, 4 m north, 5 m below, forward at 2 m/s."""
    q_NB = quat_from_rpy(0.1, 0.2, math.pi / 2)
    w, x, y, z = attitude_enu_flu(q_NB)
    datum = {
        "p": {"x": 3.0, "y": 4.0, "z": -5.0},
        "q": {"w": w, "x": x, "y": y, "z": z},
        "v": {"x": 2.0, "y": 1.0, "z": 0.5},
    }
    log = MadeLog("mcap", [(k * S, "/odom", datum) for k in range(3)])
    found = track(
        log,
        'position = { topic = "/odom", east = "p.x", north = "p.y", up = "p.z" }\n'
        'attitude = { topic = "/odom", axes = "ENU/FLU", unit = "1", w = "q.w", x = "q.x", y = "q.y", z = "q.z" }\n'
        'velocity = { topic = "/odom", forward = "v.x", left = "v.y", up = "v.z" }\n',
    ).track
    assert found.p_NB[0].tolist() == [4.0, 3.0, 5.0]
    assert close(found.q_NB[0], q_NB)
    flat = track(log, 'position = { topic = "/odom", east = "p.x", north = "p.y", up = "p.z" }').track
    assert flat.v_N is None
    # By hand: nose at 0.2 above the horizon towards east, left is north.
    level = MadeLog(
        "mcap",
        [(0, "/o", {**datum, "q": dict(zip("wxyz", attitude_enu_flu(quat_from_rpy(0, 0, math.pi / 2)), strict=True))})],
    )
    level = track(
        level,
        'position = { topic = "/o", east = "p.x", north = "p.y", up = "p.z" }\n'
        'attitude = { topic = "/o", axes = "ENU/FLU", unit = "1", w = "q.w", x = "q.x", y = "q.y", z = "q.z" }\n'
        'velocity = { topic = "/o", forward = "v.x", left = "v.y", up = "v.z" }\n',
    ).track
    assert level.v_N[0] == pytest.approx([1.0, 2.0, -0.5])


def test_each_value_may_have_a_topic_and_a_time_of_its_own():
    """As in MOOS: north, east and heading never come together; a heading that passes north turns on the shorter way."""
    data = []
    for k in range(11):
        data += [(k * S, "Y", {"value": 2.0 * k}), (k * S + S // 2, "X", {"value": 10.0 * k})]
        data.append((k * S + S // 4, "H", {"value": (355.0 + k) % 360.0}))
    found = track(
        MadeLog("alog", data),
        'position = { north = { field = "value", topic = "Y" }, east = { field = "value", topic = "X" } }\n'
        'attitude = { yaw = { field = "value", topic = "H", unit = "deg" } }\n',
    ).track
    assert found.t_ns.tolist() == [k * S for k in range(11)]
    assert found.p_NB[5].tolist() == [10.0, 45.0, 0.0]
    for k in range(1, 11):
        assert close(found.q_NB[k], quat_from_rpy(0.0, 0.0, math.radians(355.0 + k - 0.25)))


def test_angles_of_topics_of_their_own_turn_on_the_shorter_way():
    """A roll that passes 180 degrees, sampled between the headings."""
    data = []
    for k in range(11):
        data += [(k * S, "P", {"n": 0.0, "e": 0.0, "yaw": 10.0})]
        data.append((k * S + S // 2, "R", {"roll": (175.0 + k + 180.0) % 360.0 - 180.0}))
    found = track(
        MadeLog("csv", data),
        'position = { topic = "P", north = "n", east = "e" }\n'
        'attitude = { topic = "P", unit = "deg", yaw = "yaw", roll = { field = "roll", topic = "R" } }\n',
    ).track
    for k in range(1, 11):
        assert close(found.q_NB[k], quat_from_rpy(math.radians(175.0 + k - 0.5), 0.0, math.radians(10.0)))


def test_latitude_and_longitude_from_the_first_fix_or_an_origin():
    data = [
        (k * S, "G", {"lat": 0.0 if k < 2 else 60.0 + 1e-4 * k, "lon": 0.0 if k < 2 else 10.0, "alt": -k})
        for k in range(5)
    ]
    text = 'position = { topic = "G", latitude = "lat", longitude = "lon", up = "alt" }'
    found = track(MadeLog("csv", data), text)
    assert found.track.t_ns.tolist() == [2 * S, 3 * S, 4 * S]
    assert found.track.p_NB[0] == pytest.approx([0.0, 0.0, 2.0])
    assert found.track.p_NB[1, 0] == pytest.approx(11.14, abs=0.02)  # 1e-4 degrees of latitude at 60 degrees
    assert found.remarks[0] == "north and east are measured from its first fix"
    with_origin = track(MadeLog("csv", data), text + "\n[origin]\nlatitude_deg = 60.0\nlongitude_deg = 10.0")
    assert with_origin.track.p_NB[0, 0] == pytest.approx(22.28, abs=0.02)


def test_where_chooses_one_of_several():
    data = [(k * S, "F", {"C": k % 2, "n": float(k), "e": 0.0}) for k in range(10)]
    found = track(MadeLog("bin", data), 'position = { topic = "F", north = "n", east = "e", where = { C = 1 } }').track
    assert found.p_NB[:, 0].tolist() == [1.0, 3.0, 5.0, 7.0, 9.0]


def test_what_is_no_pose_is_left_out_and_told():
    q = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
    data = [(k * S, "P", {"n": float(k), "e": 0.0, **q}) for k in range(20)]
    data[3] = (3 * S, "P", {"n": math.nan, "e": 0.0, **q})
    data[4] = (4 * S, "P", {"n": "text", "e": 0.0, **q})
    data[5] = (5 * S, "P", {"e": 0.0, **q})
    data[6] = (6 * S, "P", {"n": 6.0, "e": 0.0, "w": 0.0, "x": 0.0, "y": 0.0, "z": 0.0})
    data[7] = (7 * S, "P", {"n": 10**400, "e": 0.0, **q})
    text = 'position = { topic = "P", north = "n", east = "e" }\nattitude = { topic = "P", unit = "1", w = "w", x = "x", y = "y", z = "z" }'
    found = track(MadeLog("csv", data), text)
    assert found.track.p_NB[:, 0].tolist() == [0.0, 1.0, 2.0, 6.0, *map(float, range(8, 20))]
    assert any("4 poses with numbers that are not finite" in r for r in found.remarks)


def test_poses_without_attitude_near_them_are_left_out():
    data = [(k * S, "P", {"n": float(k), "e": 0.0}) for k in range(20)]
    data += [(k * S, "A", {"yaw": 0.1}) for k in range(5, 10)]
    found = track(
        MadeLog("csv", data),
        'position = { topic = "P", north = "n", east = "e" }\nattitude = { topic = "A", yaw = "yaw" }',
    )
    assert found.track.t_ns.tolist() == [k * S for k in range(4, 11)]
    assert "13 positions without attitude" in found.remarks[0]


def test_a_track_without_data_is_refused_by_name():
    log = MadeLog("csv", [(0, "P", {"n": math.nan, "e": 1.0})])
    with pytest.raises(LogError, match='track "x": no pose is left'):
        track(log, 'position = { topic = "P", north = "n", east = "e" }')
    with pytest.raises(LogError, match='track "x": the log has no data of Q'):
        track(log, 'position = { topic = "Q", north = "n", east = "e" }')
    mapping = parse_mapping('[tracks.x]\nposition = { topic = "P", north = "n", east = "e" }')
    with pytest.raises(LogError, match='no track "y" in the mapping; there are: x'):
        pose_tracks(log, mapping, ["y"])
