"""Tracks of external vehicles: read from recordings, put on the time of a run, and kept in a recording."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.writer import Writer

from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tracks import (
    BadTrack,
    Logged,
    in_simulation_time,
    pack,
    read_log,
    read_track,
    unpack,
)
from uwserver.world.external.motion import Motion
from uwserver.world.external.track import PoseTrack

S = 1_000_000_000


def recording(path: Path, *messages: tuple[float, object], topic: str = "rov/truth/pose", epoch: str = "") -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        if epoch:
            writer.add_metadata("uwserver", {"scenario": json.dumps({"scenario": {"world": {"epoch_utc": epoch}}})})
        schema = writer.register_schema(topic, "jsonschema", b"{}")
        channel = writer.register_channel(topic, "json", schema)
        for t, message in messages:
            data = message if isinstance(message, bytes) else json.dumps(message).encode()
            writer.add_message(channel, round(t * S), data, round(t * S))
        writer.finish()
    return path


def sample(p, q=(1.0, 0.0, 0.0, 0.0), valid=True, **more):
    return {"valid": valid, "value": {"p_NB": list(p), "q_NB": list(q), **more}}


def entry(**keys) -> VehicleEntry:
    return VehicleEntry(model="bluerov2", kind="external", log="a.mcap", track="rov/truth/pose", **keys)


def read_recording(path: Path, topic: str) -> Logged:
    return read_log(path, VehicleEntry(model="bluerov2", kind="external", log=path.name, track=topic), path.parent)


def test_poses_of_a_port_of_a_recording(tmp_path):
    path = recording(tmp_path / "a.mcap", (1.0, sample((1, 2, 3))), (1.5, sample((4, 5, 6))))
    logged = read_recording(path, "rov/truth/pose")
    assert np.diff(logged.track.t_ns).tolist() == [S // 2]
    assert logged.track.p_NB.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert logged.track.v_N is None
    assert logged.remarks == ()


def test_estimates_of_an_autopilot_bring_their_velocity(tmp_path):
    value = {"p_N": [0, 0, 1], "q_NB": [0, 0, 0, 1], "v_N": [0.5, 0, 0], "mode": "hold"}
    path = recording(tmp_path / "a.mcap", (0.0, {"valid": True, "value": value}), topic="rov/autopilot/state")
    assert read_recording(path, "rov/autopilot/state").track.v_N.tolist() == [[0.5, 0, 0]]


def test_a_velocity_in_the_body_is_turned(tmp_path):
    turned = sample((0, 0, 0), (0.0, 0.0, 0.0, 1.0), v_NB_B=[1.0, 2.0, 0.0])
    path = recording(tmp_path / "a.mcap", (0.0, turned))
    assert np.allclose(read_recording(path, "rov/truth/pose").track.v_N, [[-1, -2, 0]])


def test_what_holds_no_pose_is_left_out_and_told(tmp_path):
    rest = [
        (0.1, sample((9, 9, 9), valid=False)), (0.3, {"value": {"p_NB": [0, 0]}}), (0.4, [1]),
        (0.5, sample((9, 9, None))), (0.6, sample((9, 9, 9), (0, 0, 0, 0))), (0.65, sample((9e9, 9, 9))),
    ]  # fmt: skip
    path = recording(tmp_path / "a.mcap", (0.0, sample((1, 1, 1))), *rest, (0.7, sample((2, 2, 2))))
    logged = read_recording(path, "rov/truth/pose")
    assert logged.track.p_NB.tolist() == [[1, 1, 1], [2, 2, 2]]
    assert [remark.split('": ')[-1].split(" ")[0] for remark in logged.remarks] == ["4", "1", "1"]


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda path: None, "No such file"),
        (lambda path: path.mkdir(), "a.mcap"),
        (lambda path: path.write_bytes(b""), "a.mcap"),
        (lambda path: path.write_bytes(b"x" * 5000), "a.mcap"),
        (
            lambda path: recording(path, (0.0, sample((0, 0, 0))), topic="rov/truth/pos"),
            'no track "rov/truth/pose": there are',
        ),
        (lambda path: recording(path, (0.0, {"value": {}})), "a.mcap"),
        (lambda path: recording(path, (0.0, sample((0, 0, 0), (0, 0, 0, 0)))), "no pose is left"),
    ],
)
def test_a_log_without_poses_is_refused_by_name(tmp_path, make, text):
    make(tmp_path / "a.mcap")
    with pytest.raises(BadTrack) as refused:
        read_track(entry(), tmp_path)
    assert str(tmp_path / "a.mcap") in str(refused.value)
    assert text in str(refused.value)


def test_cut_recordings_are_refused_or_give_what_is_left(tmp_path):
    whole = recording(tmp_path / "w.mcap", *((k / 10, sample((k, 0, 0))) for k in range(40))).read_bytes()
    for length in range(0, len(whole), 61):
        (tmp_path / "a.mcap").write_bytes(whole[:length])
        try:
            track, _ = read_track(entry(), tmp_path)
        except BadTrack:
            continue
        assert 0 < len(track) <= 40


ALOG = """%% LOG FILE:       ./dive.alog
%% LOGSTART           1767225600.0
0.10 NAV_X uSim 0
0.10 NAV_Y uSim 0
0.10 NAV_DEPTH uSim 5
0.10 NAV_HEADING uSim 90
1.10 NAV_X uSim 2
1.10 NAV_Y uSim 1
1.10 NAV_DEPTH uSim 5
1.10 NAV_HEADING uSim 90
"""


def test_logs_of_others_are_read_by_the_rules_that_are_known(tmp_path):
    (tmp_path / "dive.alog").write_text(ALOG)
    moos = VehicleEntry(model="bluerov2", kind="external", log="dive.alog")
    track, _ = read_track(moos, tmp_path)
    assert track.p_NB[[0, -1]].tolist() == [[0, 0, 5], [1, 2, 5]]
    assert track.at(0).q_NB == pytest.approx((math.sqrt(0.5), 0, 0, math.sqrt(0.5)))
    with pytest.raises(BadTrack, match='no track "nav_x"'):
        read_track(msgspec.structs.replace(moos, track="nav_x"), tmp_path)


def test_a_mapping_says_which_fields_are_the_pose(tmp_path):
    (tmp_path / "dive.alog").write_text(ALOG)
    (tmp_path / "m.toml").write_text(
        """format = "uwserver-log-mapping-1"
[tracks.turned.position]
north = { topic = "NAV_X", field = "value" }
east = { topic = "NAV_Y", field = "value", scale = -1.0 }
depth = { topic = "NAV_DEPTH", field = "value" }
"""
    )
    mapped = VehicleEntry(model="bluerov2", kind="external", log="dive.alog", mapping="m.toml")
    track, remarks = read_track(mapped, tmp_path)
    assert track.p_NB[-1].tolist() == [2, -1, 5]
    assert any("heading north" in remark for remark in remarks)
    with pytest.raises(BadTrack, match=r"n\.toml"):
        read_track(msgspec.structs.replace(mapped, mapping="n.toml"), tmp_path)


def logged(epoch_ns=None) -> Logged:
    t = np.array([10, 11, 12]) * S
    return Logged(PoseTrack(t, np.zeros((3, 3)), np.tile([1.0, 0, 0, 0], (3, 1)), np.ones((3, 3))), epoch_ns, ())


@pytest.mark.parametrize(
    ("keys", "times"),
    [
        ({}, [0, 1, 2]),
        ({"start": 10.5}, [-0.5, 0.5, 1.5]),
        ({"start": 10.5, "offset_s": 2.0}, [1.5, 2.5, 3.5]),
        ({"speed": 2.0, "offset_s": 1.0}, [1.0, 1.5, 2.0]),
        ({"start": "2026-01-01T00:00:11Z"}, [-1, 0, 1]),
    ],
)
def test_the_time_of_a_run(keys, times):
    epoch = 1_767_225_600 * S  # 2026-01-01T00:00:00Z
    track = in_simulation_time(logged(epoch), entry(**keys))
    assert (track.t_ns / S).tolist() == times
    assert track.v_N[0, 0] == keys.get("speed", 1.0)


def test_utc_needs_a_log_that_knows_it():
    with pytest.raises(ValueError, match="does not know its UTC"):
        in_simulation_time(logged(), entry(start="2026-01-01T00:00:11Z"))


def test_a_log_that_ends_before_the_run_begins_is_refused():
    with pytest.raises(ValueError, match="1 s before the start of the run"):
        in_simulation_time(logged(), entry(start=13.0))


def test_a_recording_knows_its_utc(tmp_path):
    path = recording(tmp_path / "a.mcap", (1.0, sample((1, 2, 3))), epoch="1970-01-01T00:00:02Z")
    assert read_recording(path, "rov/truth/pose").epoch_ns == 2 * S


def test_packed_tracks_come_back_bit_for_bit():
    track = logged().track
    back = unpack(pack({"a": track, "b": PoseTrack(track.t_ns, track.p_NB, track.q_NB)}))
    assert [array.tobytes() for array in (back["a"].t_ns, back["a"].p_NB, back["a"].q_NB, back["a"].v_N)] == [
        array.tobytes() for array in (track.t_ns, track.p_NB, track.q_NB, track.v_N)
    ]
    assert back["b"].v_N is None


def test_what_its_actuators_give_comes_back_and_follows_the_clock_of_the_run():
    plain = logged().track
    motion = Motion(plain.t_ns, ("1", "rudder"), ("pulse", "angle"), np.arange(2.0 * len(plain)).reshape(-1, 2))
    track = replace(plain, motion=motion)
    back = unpack(pack({"a": track}))["a"].motion
    assert back is not None
    assert (back.names, back.kinds, back.values.tolist()) == (motion.names, motion.kinds, motion.values.tolist())
    moved = in_simulation_time(logged()._replace(track=track), entry(offset_s=5.0, speed=2.0)).motion
    assert moved is not None
    assert moved.t_ns[0] == 5 * 10**9
    assert moved.t_ns[1] - moved.t_ns[0] == pytest.approx((motion.t_ns[1] - motion.t_ns[0]) / 2, abs=1)


@pytest.mark.parametrize("text", ["", "x", "zzzz", pack({"a": logged().track})[:-9], pack({})[:4]])
def test_damaged_tracks_are_refused(text):
    with pytest.raises(ValueError, match="tracks of external vehicles cannot be read"):
        unpack(text)
