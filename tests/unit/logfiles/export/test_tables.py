"""Tables of topics, and the files that are written of them."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from logs_made import MadeLog

from uwserver.logfiles import open_log
from uwserver.logfiles.export.tables import file_names, topic_tables, write_csv, write_mat, write_netcdf, write_parquet
from uwserver.logfiles.log import LogField, Topic


def columns(values, fields=()):
    log = MadeLog("mcap", [(k, "a", value) for k, value in enumerate(values)], {"a": ("", fields)})
    (table,) = topic_tables(log)
    return {column.name: column for column in table.columns}


def test_columns_have_the_type_of_their_cells():
    one = {"value": {"i": 1, "f": 1.5, "b": True, "s": "x", "v": [1, 2], "m": {"n": 2}}}
    two = {"value": {"i": 2, "f": None, "b": False, "s": 1, "v": [3, None], "m": {}}}
    got = columns([one, two], (("value.f", "m"),))
    assert got["time_ns"].values.tolist() == [0, 1]
    assert got["i"].values.dtype == np.int64
    assert got["b"].values.dtype == np.bool_
    assert got["f"].unit == "m"
    assert np.isnan(got["f"].values[1])
    assert got["s"].values == ["x", "1"]
    assert got["v"].values[0].tolist() == [1.0, 2.0]
    assert np.isnan(got["v"].values[1, 1])
    assert got["m.n"].values[0] == 2.0


@pytest.mark.parametrize(
    ("cells", "texts"),
    [
        ([[1], [1, 2]], ["[1]", "[1,2]"]),
        ([["a"], ["b"]], ['["a"]', '["b"]']),
        ([b"\x00", None], ["AA==", ""]),
        ([{}, 1], ["{}", "1"]),
    ],
)
def test_what_is_no_array_is_text(cells, texts):
    assert columns([{"x": cell} for cell in cells])["x"].values == texts


def test_numbers_beyond_64_bits():
    assert columns([{"x": 1 << 70}, {"x": 10**400}])["x"].values.tolist()[0] == float(1 << 70)
    assert np.isnan(columns([{"x": 10**400}])["x"].values[0])


def test_a_field_called_like_the_time():
    assert set(columns([{"time_ns": 5}])) == {"time_ns", "time_ns_"}


def test_names_of_topics_become_no_paths():
    names = file_names(["../../etc/passwd", "/a/b", "a_b", "A:b", "", "\u00fc"])
    assert list(names.values()) == ["etc_passwd", "a_b", "a_b_2", "A_b_3", "topic", "topic_2"]


S = 10**9


@pytest.fixture
def log():
    made = MadeLog(
        "uwserver",
        [(k * S, "rov/dvl", {"valid": True, "value": {"v_S": [1.0, 2.0 * k, None], "mode": "x,y"}}) for k in range(3)],
    )
    fields = (LogField("value.v_S", "number[3]", "m/s", "S"), LogField("value.mode", "string", "1"))
    made.topics["rov/dvl"] = Topic("rov/dvl", "rov/dvl", fields, 3, 0, 2 * S)
    made.epoch_ns = 1_767_225_600 * S
    return made


def test_csv(log, tmp_path):
    write_csv(log, topic_tables(log), tmp_path / "out")
    with (tmp_path / "out" / "rov_dvl.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time_ns", "valid", "v_S.0 [m/s]", "v_S.1 [m/s]", "v_S.2 [m/s]", "mode"]
    assert rows[2] == ["1000000000", "True", "1.0", "2.0", "nan", "x,y"]
    about = json.loads((tmp_path / "out" / "log.json").read_text())
    assert about["epoch_utc"] == "2026-01-01T00:00:00.000Z"
    assert {"name": "v_S", "unit": "m/s", "frame": "S"} in about["topics"][0]["fields"]
    again = open_log(tmp_path / "out" / "rov_dvl.csv")
    assert [d.t_ns for d in again.read()] == [0, S, 2 * S]
    assert {f.name: f.unit for f in again.topics["rov_dvl"].fields}["v_S.0 [m/s]"] == "m/s"


def test_parquet(log, tmp_path):
    import pyarrow.parquet as pq

    write_parquet(log, topic_tables(log), tmp_path / "out")
    table = pq.read_table(tmp_path / "out" / "rov_dvl.parquet")
    assert table.schema.field("v_S").metadata == {b"unit": b"m/s", b"frame": b"S"}
    assert table.schema.metadata[b"topic"] == b"rov/dvl"
    assert table.column("v_S")[1].as_py()[:2] == [1.0, 2.0]
    assert table.column("time_ns").to_pylist() == [0, S, 2 * S]


def test_netcdf(log, tmp_path):
    import h5netcdf

    write_netcdf(log, topic_tables(log), tmp_path / "out.nc")
    with h5netcdf.File(tmp_path / "out.nc", "r") as file:
        group = file["rov_dvl"]
        assert group["v_S"].attrs["units"] == "m/s"
        assert group["v_S"].attrs["frame"] == "S"
        assert group["v_S"].shape == (3, 3)
        assert group["time"].attrs["units"] == "nanoseconds since 2026-01-01T00:00:00.000Z"
        assert group["time"][...].tolist() == [0, S, 2 * S]


def test_mat(log, tmp_path):
    from scipy.io import loadmat

    write_mat(log, topic_tables(log), tmp_path / "out.mat")
    whole = loadmat(tmp_path / "out.mat", simplify_cells=True)
    assert whole["rov_dvl"]["units"]["v_S"] == "m/s"
    assert whole["rov_dvl"]["frames"]["v_S"] == "S"
    assert np.array_equal(whole["rov_dvl"]["v_S"][:, 1], [0.0, 2.0, 4.0])
    assert list(whole["rov_dvl"]["mode"]) == ["x,y"] * 3
