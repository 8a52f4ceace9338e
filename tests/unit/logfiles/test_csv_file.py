"""Tables as text."""

import time

import numpy as np
import pytest

from uwserver.logfiles import LogError

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
    assert log.remarks == ("2 rows have no time that can be read, and are left out",)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a,b\n1,2\n", "dive.csv:1: no column of time"),
        ("t_s,b\n", "dive.csv:2: not one row"),
        ("t_s,b\nx,y\n", "not one row"),
        ("t" * 2_000_000, "no table"),
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
