"""Tables of Parquet, written by pyarrow."""

from datetime import datetime, timezone

import numpy as np
import pytest

from uwserver.logfiles import LogError


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
