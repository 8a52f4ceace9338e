"""Tables of topics."""

import numpy as np
import pytest
from logs_made import MadeLog

from uwserver.logfiles.export.tables import file_names, topic_tables


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
