"""Pairing of samples by time, what lies between two of them, and the measure of each kind of field."""

from __future__ import annotations

import math

import pytest

from uwserver.recording.channels import Column
from uwserver.recording.differences import PATIENCE_NS, Pairing

DEPTH, HEADING = Column("depth", "m", "number"), Column("heading", "rad", "number")
PLACE, ATTITUDE = Column("p_NB", "m", "number", 3), Column("q_NB", "1", "number", 4)
MODE, COUNT = Column("mode", "1", "string"), Column("count", "1", "integer")
END = (math.inf, math.inf)


def paired(column: Column, one: list, other: list, *, holds: bool = False, asks: int = 0) -> Pairing:
    """`one` and `other`: times and values of a field."""
    pairing = Pairing((column,), holds, asks)
    for side, samples in enumerate((one, other)):
        for t_ns, value in samples:
            pairing.put(side, (t_ns, True, {column.name: value}))
    pairing.pair(END)
    return pairing


@pytest.mark.parametrize(
    ("column", "a", "b", "distance"),
    [
        (DEPTH, 1.0, 1.5, 0.5),
        (HEADING, 3.1, -3.1, math.tau - 6.2),
        (PLACE, [0.0, 0.0, 0.0], [3.0, 0.0, 4.0], 5.0),
        (PLACE, [None, 0.0, 0.0], [None, 0.0, 4.0], 4.0),
        (ATTITUDE, [1.0, 0.0, 0.0, 0.0], [math.cos(0.1), math.sin(0.1), 0.0, 0.0], 0.2),
        (ATTITUDE, [1.0, 0.0, 0.0, 0.0], [-math.cos(1e-9), 0.0, -math.sin(1e-9), 0.0], 2e-9),
        (COUNT, 3, 5, 2.0),
    ],
)
def test_each_kind_has_its_measure(column: Column, a: object, b: object, distance: float):
    found = paired(column, [(1, a), (2, a)], [(1, b), (2, a)]).fields[column.name]
    assert found.largest == pytest.approx(distance, rel=1e-9)
    assert found.rms == pytest.approx(distance / math.sqrt(2.0))
    assert (found.largest_ns, found.first_ns, found.count, found.unequal) == (1, 1, 2, 0)


@pytest.mark.parametrize(
    ("column", "a", "b"),
    [
        (MODE, "manual", "acro"),
        (DEPTH, None, 1.0),
        (PLACE, [0.0, 0.0, None], [0.0, 0.0, 0.0]),
        (PLACE, None, [1.0, 1.0, 1.0]),
    ],
)
def test_words_and_missing_values_are_the_same_or_not(column: Column, a: object, b: object):
    found = paired(column, [(1, a), (2, b)], [(1, b), (2, b)]).fields[column.name]
    assert (found.unequal, found.first_ns, found.is_same) == (1, 1, False)
    assert paired(column, [(1, a)], [(1, a)]).fields[column.name].is_same


def test_where_times_differ_the_other_is_interpolated():
    pairing = paired(DEPTH, [(5, 1.0), (15, 2.0), (25, 9.0)], [(0, 0.0), (10, 1.0), (20, 2.0)])
    assert (pairing.pairs, pairing.alone) == ([0, 2], 1)
    assert pairing.fields["depth"].largest == pytest.approx(0.5)
    assert pairing.fields["depth"].first_ns is None, "what lies between two samples is no difference of one time"


def test_angles_are_interpolated_the_short_way():
    assert paired(HEADING, [(5, math.pi)], [(0, 3.1), (10, -3.1)]).fields["heading"].largest == pytest.approx(
        0.0, abs=1e-12
    )
    q = [[math.cos(a / 2), 0.0, 0.0, math.sin(a / 2)] for a in (0.2, 0.4, 0.6)]
    assert paired(ATTITUDE, [(5, q[1])], [(0, q[0]), (10, [-x for x in q[2]])]).fields["q_NB"].largest < 1e-12
    assert paired(COUNT, [(5, 3)], [(0, 3), (10, 9)]).fields["count"].is_same, "whole numbers stand until the next"


def test_the_side_with_fewer_samples_asks():
    slow, fast = [(0, 0.0), (10, 1.0)], [(t, t / 10) for t in range(11)]
    pairing = paired(DEPTH, fast, slow, asks=1)
    assert (pairing.pairs, pairing.samples, pairing.fields["depth"].is_same) == ([2, 0], [11, 2], True)


def test_commands_stand_until_the_next_and_the_last_of_one_time_acts():
    pairing = paired(DEPTH, [(5, 1.0), (5, 2.0), (12, 3.0)], [(0, 2.0), (10, 3.0)], holds=True)
    assert (pairing.pairs, pairing.alone) == ([0, 2], 0)
    assert pairing.fields["depth"].is_same


def test_one_that_is_told_late_is_left_out():
    assert paired(DEPTH, [(2, 1.0), (1, 5.0), (3, 1.0)], [(2, 1.0), (3, 1.0)]).disordered == 1


def test_only_as_much_is_kept_as_pairing_needs():
    """Whether one side has no partner, or both go on for ever."""
    step = PATIENCE_NS // 100
    for sides in ((0,), (1,), (0, 1)):
        pairing, most = Pairing((DEPTH,), False, 0), 0
        for k in range(5000):
            for side in sides:
                pairing.put(side, (k * step, True, {"depth": 1.0}))
            pairing.pair((k * step, k * step))
            most = max(most, *map(len, pairing._waiting))
        assert most <= 110
    assert pairing.pairs[0] >= 4999


def test_whether_they_are_valid_counts():
    pairing = Pairing((DEPTH,), False, 0)
    pairing.put(0, (1, True, {"depth": 1.0}))
    pairing.put(1, (1, False, {"depth": 1.0}))
    pairing.pair(END)
    assert (pairing.valid.unequal, pairing.valid.first_ns) == (1, 1)
