"""Tables as text."""

import time

import numpy as np
import pytest
from click.testing import CliRunner

from uwserver.cli.export import export
from uwserver.cli.log import log_command
from uwserver.logfiles import LogError, open_log
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.rules import mapping_of
from uwserver.logfiles.samples import port_samples
from uwserver.ports import Field, Port, Sample
from uwserver.recording.writer import RecordingWriter

TEXT = """t_s,north_m,"a, b",mode
0.0,1.0,2,"DIVE, deep"
0.1,1.1,,x
0.2,nan,4,y
"""


def test_rows_become_data(opened):
    log = opened(TEXT.encode(), "dive.csv")
    data = list(log.read())
    assert [d.t_ns for d in data] == [0, 100_000_000, 200_000_000]
    assert data[0].value == {"t_s": 0.0, "north_m": 1.0, "a, b": 2.0, "mode": "DIVE, deep"}
    assert "a, b" not in data[1].value
    assert {f.name: f.unit for f in log.topics["dive"].fields}["north_m"] == "m"
    assert log.epoch_ns is None


@pytest.mark.parametrize("separator", [";", "\t"])
def test_other_separators_byte_order_marks_and_comments(opened, separator):
    text = "\ufeff# made by hand\nutc;depth_m\n2026-01-01T00:00:00Z;3\n2026-01-01T00:00:01Z;4\n".replace(";", separator)
    log = (
        opened(text.replace("\n", "\r\n").encode(), "x.csv")
        if separator == "\t"
        else opened(text.encode()[3:], "x.csv")
    )
    assert [d.value["depth_m"] for d in log.read()] == [3.0, 4.0]
    assert log.epoch_ns == 1_767_225_600 * 10**9


def test_a_quoted_separator_before_the_time(opened):
    log = opened(b'note,t_s\n"a, b",1\n"c",2\n', "x.csv")
    assert [d.value for d in log.read()] == [{"note": "a, b", "t_s": 1.0}, {"note": "c", "t_s": 2.0}]


def test_rows_without_time_are_told(opened):
    log = opened((TEXT + "soon,1,2,z\nonly\n").encode(), "dive.csv")
    assert log.topics["dive"].count == 3
    assert log.remarks == ("2 rows were skipped: their time cannot be read",)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a,b\n1,2\n", "dive.csv:1: no time column"),
        ("t_s,b\n", "dive.csv:2: no row has a time"),
        ("t_s,b\nx,y\n", "no row has a time"),
        ("t" * 2_000_000, "not a table"),
    ],
)
def test_what_is_no_table_is_told_with_its_line(opened, text, told):
    with pytest.raises(LogError, match=told):
        opened(text.encode(), "dive.csv")


def test_hostile_bytes_never_crash(opened):
    rng = np.random.default_rng(8)
    raw = TEXT.encode() * 5
    for _ in range(200):
        hurt = bytearray(raw)
        for at in rng.integers(0, len(raw), 5):
            hurt[at] = int(rng.integers(1, 256))
        try:
            times = [d.t_ns for d in opened(bytes(hurt), "dive.csv").read()]
        except LogError:
            continue
        assert times == sorted(times)


def test_a_header_of_commas_costs_little(opened):
    """Each name was compared with all before it: an hour for a megabyte."""
    start = time.process_time()
    with pytest.raises(LogError, match="columns"):
        opened(b"t" + b"," * 900_000 + b"\n", "commas.csv")
    assert time.process_time() - start < 5.0


def test_names_that_stand_twice_are_told_apart(opened):
    log = opened(b"t_s,a,a,,a\n0,1,2,3,4\n", "twice.csv")
    assert [field.name for field in log.topics["twice"].fields] == ["t_s", "a", "a_3", "column_4", "a_5"]


def exported(tmp_path):
    """A folder as `uwserver export --to csv` writes it."""
    pose = Port(
        "rov/truth/pose", "sensor", "pose",
        (Field("p_NB", "m", "place", "N", (3,)), Field("q_NB", "1", "attitude", "NB", (4,))), "Pose.", 10.0,
    )  # fmt: skip
    imu = Port(
        "rov/imu",
        "sensor",
        "imu",
        (Field("f_S", "m/s^2", "force", "S", (3,)), Field("temperature", "degC", "heat")),
        "",
        5.0,
    )
    ports = {port.path: port for port in (pose, imu)}
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = RecordingWriter(file, {"format": "x"}, ports)
        for k in range(1, 21):
            t = k * 10**8
            writer.sample(Sample(pose.path, k, t, t, True, ((1.0 * k, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))), ports)
            writer.sample(Sample(imu.path, k, t, t, True, ((0.1, 0.2, -9.8), 11.5)), ports)
        writer.finish()
    result = CliRunner().invoke(export, [str(tmp_path / "run.mcap"), "--to", "csv", "-o", str(tmp_path / "tables")])
    assert result.exit_code == 0, result.output
    return tmp_path / "tables"


def test_our_own_export_comes_back_with_its_topics_times_poses_and_ports(tmp_path):
    log = open_log(exported(tmp_path))
    try:
        assert set(log.topics) == {"rov/truth/pose", "rov/imu"}
        assert (log.start_ns, log.end_ns) == (10**8, 20 * 10**8)
        mapping = mapping_of(log)
        track = pose_tracks(log, mapping)["rov_truth_pose"].track
        assert track.t_ns[4] == 5 * 10**8
        assert track.p_NB[4].tolist() == [5.0, 2.0, 3.0]
        sample = next(port_samples(log, mapping, {"rov/imu"}))
        assert sample.value == {"f_S": (0.1, 0.2, -9.8), "temperature": 11.5}
    finally:
        log.close()


def test_one_table_of_it_is_a_track_and_tells_its_units_once(tmp_path):
    file = exported(tmp_path) / "rov_truth_pose.csv"
    log = open_log(file)
    try:
        assert pose_tracks(log, mapping_of(log))["rov_truth_pose"].track.p_NB[4].tolist() == [5.0, 2.0, 3.0]
    finally:
        log.close()
    told = CliRunner().invoke(log_command, [str(file)]).output
    assert "p_NB.0 [m], p_NB.1 [m]" in told
    assert "[m] [m]" not in told


@pytest.mark.parametrize(
    ("about", "told"),
    [
        ('{"topics": 3}', "`uwserver export --to csv` did not write it"),
        ('{"topics": [{"topic": "a", "file": "../run.mcap"}]}', "is not the name of a file in this folder"),
        (
            '{"topics": [{"topic": "a", "file": "rov_imu.csv"}, {"topic": "a", "file": "rov_imu.csv"}]}',
            "have the same topic",
        ),
        (
            '{"topics": [{"topic": "a", "file": "rov_imu.csv"}, {"topic": "b", "file": "rov_imu.csv"}]}',
            "two topics name the table",
        ),
        ('{"topics": [{"topic": "a", "file": "gone.csv"}]}', "gone.csv"),
    ],
)
def test_a_folder_that_names_something_else_is_refused(tmp_path, about, told):
    folder = exported(tmp_path)
    (folder / "log.json").write_text(about)
    with pytest.raises(LogError, match=told):
        open_log(folder)
