"""The mapping that is found for a log without being told."""

import math

import numpy as np
import pytest
from logs_made import MadeLog
from logs_rig import telemetry, tlog
from pymavlink.dialects.v20 import ardupilotmega as m

from uwserver.logfiles.mapping import mapping_text, parse_mapping
from uwserver.logfiles.ports import port_samples
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.rules import mapping_of

S = 1_000_000_000


def found(log):
    mapping = mapping_of(log)
    assert parse_mapping(mapping_text(mapping)) == mapping
    return mapping, pose_tracks(log, mapping)


def test_telemetry(opened):
    log = opened(tlog(telemetry() + telemetry(system=7)), "x.tlog")
    mapping, tracks = found(log)
    assert list(tracks) == ["vehicle_1", "vehicle_1_odometry", "vehicle_7", "vehicle_7_odometry"]
    pose = tracks["vehicle_7"].track
    assert pose.p_NB[50] == pytest.approx([5.0, -2.5, 2.5], abs=1e-5)
    assert pose.v_N[50] == pytest.approx([1.0, -0.5, 0.1], abs=1e-6)
    sample = next(d for d in port_samples(log, mapping, {"vehicle_7/attitude"}) if d.t_ns >= 5 * S)
    assert sample.value["heading"] == pytest.approx(1.5, abs=1e-6)


def test_outputs_of_an_autopilot_move_what_follows_its_log(opened):
    data = [
        (k * S, "XKF1[0]", {"PN": 1.0 * k, "PE": 2.0, "PD": 3.0, "VN": 1.0, "VE": 0.0, "VD": 0.0}) for k in range(3)
    ]
    data += [(k * S + 5, "RCOU", {"C1": 1500 + k, "C2": 1100}) for k in range(3)]
    data.sort(key=lambda entry: entry[0])
    mapping, tracks = found(MadeLog("bin", data, {"RCOU": ("RCOU", ("C1", "C2"))}))
    motion = tracks["filter"].track.motion
    assert mapping.tracks["filter"].actuators.outputs == {"1": "C1", "2": "C2"}
    assert (motion.names, motion.kinds) == (("1", "2"), ("pulse", "pulse"))
    assert motion.t_ns.tolist() == [5, S + 5, 2 * S + 5]
    assert motion.values == pytest.approx(np.array([[1.5e-3, 1.1e-3], [1.501e-3, 1.1e-3], [1.502e-3, 1.1e-3]]))

    frames = telemetry(2.0)
    mav = m.MAVLink(None, srcSystem=1, srcComponent=1)
    message = m.MAVLink_servo_output_raw_message(0, 0, *(1500 + 10 * k for k in range(8)))
    frames.append((frames[0][0] + 50, bytes(message.pack(mav))))
    frames.sort(key=lambda frame: frame[0])
    _, tracks = found(opened(tlog(frames), "x.tlog"))
    motion = tracks["vehicle_1"].track.motion
    assert motion.names[:3] == ("1", "2", "3")
    assert motion.values[0, :8] == pytest.approx([1.5e-3 + 1e-5 * k for k in range(8)])


def test_a_filter_and_the_truth_of_ardupilot():
    data = []
    for k in range(20):
        data.append((k * S, "XKF1[0]", {"PN": 1.0 * k, "PE": 2.0, "PD": 3.0, "VN": 1.0, "VE": 0.0, "VD": 0.0}))
        data.append((k * S, "XKF1[1]", {"PN": -100.0, "PE": 2.0, "PD": 3.0, "VN": 1.0, "VE": 0.0, "VD": 0.0}))
        data.append((k * S, "ATT", {"Roll": 0.0, "Pitch": 90.0 / 9, "Yaw": 90.0}))
        data.append((k * S, "SIM", {"Roll": 0.0, "Pitch": 0.0, "Yaw": 180.0, "Lat": 60.0, "Lng": 10.0, "Alt": -4.0}))
    _, tracks = found(MadeLog("bin", data, {"ATT": ("ATT", ("Roll", "Pitch", "Yaw"))}))
    assert tracks["filter"].track.p_NB[10].tolist() == [10.0, 2.0, 3.0]
    assert abs(tracks["truth"].track.q_NB[0, 3]) == pytest.approx(1.0)
    assert tracks["truth"].track.p_NB[0].tolist() == [0.0, 0.0, 4.0]


def test_moos(opened):
    lines = [
        f"{k * 0.1:.2f} NAV_{n} pSim {v}"
        for k in range(50)
        for n, v in (("X", k), ("Y", 2 * k), ("DEPTH", 3), ("HEADING", 90))
    ]
    lines += [f"{k} NODE_REPORT pShare NAME=ben,X={k},Y=1,DEP=2,HDG=270" for k in range(5)]
    lines.sort(key=lambda line: float(line.split()[0]))
    mapping, tracks = found(opened("\n".join(lines).encode(), "x.alog"))
    assert list(tracks) == ["nav", "report_ben"]
    assert tracks["nav"].track.p_NB[10].tolist() == [20.0, 10.0, 3.0]
    assert tracks["nav"].track.q_NB[10, 0] == pytest.approx(math.sqrt(0.5))
    assert tracks["report_ben"].track.p_NB[3].tolist() == [1.0, 3.0, 2.0]
    assert mapping.ports["vehicle/heading"].topic == "NAV_HEADING"


@pytest.mark.parametrize("schema", ["nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "foxglove.PoseInFrame"])
def test_ros(schema):
    pose = {"position": {"x": 1.0, "y": 2.0, "z": -3.0}, "orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}}
    twist = {"twist": {"twist": {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}}}}
    value = {"pose": {"pose": pose}, **twist} if schema.endswith("Odometry") else {"pose": pose}
    _, tracks = found(MadeLog("mcap", [(k * S, "/rov/pose", value) for k in range(3)], {"/rov/pose": (schema, ())}))
    track = tracks["rov_pose"].track
    assert track.p_NB[0].tolist() == [2.0, 1.0, 3.0]
    assert abs(track.q_NB[0, 3]) == pytest.approx(math.sqrt(0.5))  # x of ENU is east
    assert (track.v_N is not None) == schema.endswith("Odometry")
    if track.v_N is not None:
        assert track.v_N[0] == pytest.approx([0.0, 1.0, 0.0])


def test_px4_and_tables():
    px4 = [
        (k * S, "vehicle_local_position", {"x": 1.0, "y": 2.0, "z": 3.0, "vx": 0.0, "vy": 0.0, "vz": 0.0})
        for k in range(3)
    ]
    px4 += [(k * S, "vehicle_attitude", {"q": [1.0, 0.0, 0.0, 0.0]}) for k in range(3)]
    assert found(MadeLog("ulg", px4))[1]["filter"].track.p_NB[0].tolist() == [1.0, 2.0, 3.0]
    fields = (("north_m", "m"), ("East", ""), ("depth_cm", "cm"), ("heading", ""))
    row = {"north_m": 1.0, "East": 2.0, "depth_cm": 300.0, "heading": 180.0}
    track = found(MadeLog("csv", [(k * S, "dive", row) for k in range(3)], {"dive": ("", fields)}))[1]["dive"].track
    assert track.p_NB[0].tolist() == [1.0, 2.0, 3.0]
    assert abs(track.q_NB[0, 3]) == pytest.approx(1.0)


def test_our_own_truth_and_estimate():
    truth = {"value": {"p_NB": [1.0, 2.0, 3.0], "q_NB": [1.0, 0.0, 0.0, 0.0]}}
    state = {
        "value": {"p_N": [1.0, 2.0, 4.0], "v_N": [0.0, 0.0, 1.0], "q_NB": [1.0, 0.0, 0.0, 0.0], "position_valid": True}
    }
    fields = ("value.p_N", "value.v_N", "value.q_NB")
    log = MadeLog(
        "uwserver",
        [(0, "rov/truth/pose", truth), (0, "rov/autopilot/state", state)],
        {"rov/autopilot/state": ("", fields)},
    )
    _, tracks = found(log)
    assert tracks["rov"].track.p_NB[0].tolist() == [1.0, 2.0, 3.0]
    assert tracks["rov_autopilot_state"].track.p_NB[0].tolist() == [1.0, 2.0, 4.0]


def test_where_nothing_fits_nothing_is_found():
    mapping, _ = found(MadeLog("mcap", [(0, "/x", {"a": 1})]))
    assert (mapping.tracks, mapping.ports) == ({}, {})
