"""Tables in the formats of others, read back by their own libraries."""

import csv
import json

import numpy as np
import pytest
from logs_made import MadeLog

from uwserver.logfiles import open_log
from uwserver.logfiles.export.table_files import write_csv, write_mat, write_netcdf, write_parquet
from uwserver.logfiles.export.tables import topic_tables
from uwserver.logfiles.log import LogField, Topic

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
