"""Tables in text and Parquet files."""

from __future__ import annotations

import time
from datetime import datetime, timezone

import numpy as np
import pytest
from click.testing import CliRunner

from uwserver.cli.recordings.export import export
from uwserver.cli.recordings.log import log_command
from uwserver.logfiles import LogError, open_log
from uwserver.logfiles.ports import port_samples
from uwserver.logfiles.poses import pose_tracks
from uwserver.logfiles.readers.tables import field_of, stamp_of, time_column
from uwserver.logfiles.rules import mapping_of
from uwserver.ports import Field, Port, Sample
from uwserver.recording.writer import RecordingWriter


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("depth_m", "m"),
        ("yaw [deg]", "deg"),
        ("speed (kn)", "kn"),
        ("v_mps", "m/s"),
        ("north", ""),
        ("p [Pa]", "Pa"),
        ("u [what]", ""),
    ],
)
def test_units(name, unit):
    assert field_of(name, "number").unit == unit


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["x", "t_s"], (1, 10**9)),
        (["Time [ms]", "x"], (0, 10**6)),
        (["timestamp", "time"], (0, 0)),
    ],
)
def test_the_time(names, found):
    assert time_column("a.csv", [field_of(name, "") for name in names]) == found


def test_a_table_without_a_time_column_is_refused():
    with pytest.raises(LogError, match=r"a\.csv: no time column; .* the columns are: x, thyme"):
        time_column("a.csv", [field_of(name, "") for name in ("x", "thyme")])


@pytest.mark.parametrize(
    ("text", "factor", "ns"),
    [
        ("1.5", 10**9, 1_500_000_000), ("1760000000123456789", 0, 1_760_000_000_123_456_789), ("1760000000.5", 0, 1_760_000_000_500_000_000),
        ("1760000000123", 0, 1_760_000_000_123_000_000), ("2026-01-01T00:00:00Z", 0, 1_767_225_600 * 10**9), ("nan", 0, None),
        ("soon", 0, None), ("inf", 1, None), ("1e300", 1, None), ("9" * 400, 1, None),
    ],
)  # fmt: skip
def test_stamps(text, factor, ns):
    assert stamp_of(text, factor) == ns


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


def written(file, **columns):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(columns), file, row_group_size=7)
    return file


def test_rows_become_data_over_row_groups(tmp_path, read_log):
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema(
        [
            pa.field("t_ns", pa.int64()),
            pa.field("depth", pa.float64(), metadata={"unit": "m", "frame": "N"}),
            pa.field("q", pa.list_(pa.float64())),
        ]
    )
    times = [1_760_000_000_000_000_001 + k * 10**9 for k in range(20)]
    table = pa.table({"t_ns": times, "depth": [None, *range(1, 20)], "q": [[1.0, 2.0]] * 20}, schema=schema)
    pq.write_table(table, tmp_path / "a.parquet", row_group_size=7)
    log = read_log(tmp_path / "a.parquet")
    data = list(log.read(start_ns=7 * 10**9))
    assert [d.value["depth"] for d in data] == [float(k) for k in range(7, 20)]
    assert data[0].value["q"] == [1.0, 2.0]
    assert log.epoch_ns == times[0]
    assert "depth" not in next(log.read()).value
    field = log.topics["a"].fields[1]
    assert (field.unit, field.frame, field.type) == ("m", "N", "double")


def test_instants(tmp_path, read_log):
    stamps = [datetime(2026, 1, 1, 0, 0, k, tzinfo=timezone.utc) for k in range(3)]
    log = read_log(written(tmp_path / "a.parquet", time=stamps, x=[1, 2, 3]))
    assert (log.epoch_ns, log.end_ns) == (1_767_225_600 * 10**9, 2 * 10**9)


def test_what_is_no_log_is_told(tmp_path, read_log):
    with pytest.raises(LogError, match="no time column"):
        read_log(written(tmp_path / "a.parquet", x=[1, 2]))
    with pytest.raises(LogError, match="no row has a time"):
        read_log(written(tmp_path / "a.parquet", t_s=["x", None]))
    with pytest.raises(LogError, match="row group 0 has"):
        read_log(written(tmp_path / "a.parquet", t_s=[1.0] * 7), record_bytes=10)


def test_damaged_files_never_crash(tmp_path, read_log):
    raw = written(tmp_path / "a.parquet", t_s=list(range(50)), x=[1.5] * 50).read_bytes()
    rng = np.random.default_rng(9)
    for k in range(80):
        hurt = bytearray(raw[: len(raw) - k] if k % 4 == 0 else raw)
        for at in rng.integers(4, len(hurt), 3):
            hurt[at] = int(rng.integers(0, 256))
        (tmp_path / "b.parquet").write_bytes(hurt)
        try:
            times = [d.t_ns for d in read_log(tmp_path / "b.parquet").read()]
        except LogError:
            continue
        assert times == sorted(times)


def test_equal_rows_that_take_no_room_are_refused_before_they_are_unpacked(tmp_path, read_log):
    """A page tells its size as encoded: twenty million equal rows are some kilobytes of file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = tmp_path / "bomb.parquet"
    n = 3_000_000
    table = pa.table({"t_s": pa.array(np.zeros(n)), "x": pa.array(np.zeros(n))})
    pq.write_table(table, file, row_group_size=n)
    with pytest.raises(LogError, match="smaller row groups"):
        read_log(file, record_bytes=64 << 20)
