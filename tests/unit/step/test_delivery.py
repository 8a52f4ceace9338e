"""Samples on their way, in compiled code: delivered when they are due, in their order, to who wants them."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest
from sensing_rig import Rig, slot_of, stream

from uwserver.modifiers import Delay, Dropout, Reorder
from uwserver.ports.decimation import Decimation, Decimations
from uwserver.step.streams import COUNTS, ENTRY, LISTENED, NEVER, READ


@pytest.mark.parametrize("seed", range(5))
def test_whatever_is_on_its_way_comes_in_the_order_of_its_time_and_then_of_its_sending(seed: int) -> None:
    """A reference in plain Python: a sorted list. Samples are added and taken in turn, beyond the room there is at first."""
    rng = np.random.default_rng(seed)
    jitter = Delay(latency_s=5e-8, jitter_s=3e-8).build(stream())
    jitter.stream.key = seed
    rig = Rig(
        slot_of(jitter, path="a"), *(slot_of(path=f"b{k}", latency_ns=int(rng.integers(0, 90))) for k in range(20))
    )
    expected: list[tuple[int, int]] = []
    before, delivered = 0, 0
    for n in range(1, 60):
        samples = rig.samples(n)
        arrived = [s.t_sent_ns for s in samples if s.t_ns < 10 * n]
        due = sorted(entry for entry in expected if entry[0] <= 10 * n)
        assert arrived == [t for t, _ in due]
        delivered += len(samples)
        order, entries, _ = rig.sensor_arrays.in_flight()
        expected = list(zip(entries["t_sent_ns"].tolist(), entries["order"].tolist(), strict=True))
        assert expected == sorted(expected)
        assert len({*entries["slot"].tolist()}) == len(entries), "two samples in one place"
        assert rig.sensor_arrays.next_ns == min((t for t, _ in expected), default=NEVER)
        assert order >= before
        before = order
    assert delivered + len(expected) == 59 * 21
    assert len(expected) > 64, "more than there was room for at first"


def test_what_is_heard_alone_is_delivered_and_not_read() -> None:
    rig = Rig(*(slot_of(path=path, latency_ns=-3) for path in "abc"))
    rig.sensing.subscribe(("c",))
    rig.sensing.set_listeners((), ("b",))
    assert [s.port for s in rig.samples(1)] == ["c"]
    a, b, c = (rig.sensing.numbers[path] for path in "abc")
    assert rig.sensor_arrays.streams.rows["use"][[a, b, c]].tolist() == [0, LISTENED, READ]
    assert rig.sensor_arrays._delivered["stream"][:2].tolist() == [b, c]
    assert rig.sensor_arrays._delivered_values[:2, 0].tolist() == [1.0, 1.0]
    assert rig.sensor_arrays.logged == 1
    assert rig.sensor_arrays.streams.rows["seq"][a] == 0
    assert rig.slots["a"].number == 1


def test_a_reading_that_is_dropped_is_not_sent() -> None:
    dropped = Dropout(probability=1.0).build(stream())
    slot = slot_of(dropped, latency_ns=-3)
    rig = Rig(slot)
    assert (rig.tick(1), slot.held, slot.number) == ([], None, 1)
    assert not rig.sensor_arrays.streams.rows["newest"][slot.stream_numbers[0]]


def test_without_anybody_due_only_what_is_on_its_way_is_delivered() -> None:
    slot = slot_of(latency_ns=22)
    rig = Rig(slot)
    rig.tick(1)
    slot.active = False
    rig.sensing.schedule()
    assert [len(rig.tick(n)) for n in (2, 3, 4, 5)] == [0, 0, 1, 0]
    assert rig.sensor_arrays.next_ns == NEVER
    assert (ENTRY.itemsize, COUNTS.itemsize) == (56, 64)


@pytest.mark.parametrize("rate_hz", [1.0, 7.0, 10.0, 99.9, 1e9 / 3])
def test_compiled_code_counts_intervals_as_who_reads_does(rate_hz: float) -> None:
    """To the last bit, also near the ends of intervals, with times far from the start, in their order."""
    rng = np.random.default_rng(int(rate_hz))
    start = int(rng.integers(0, 2**50))
    edges = (rng.integers(0, 2**50, 4000) * rate_hz // 1e9 * 1e9 / rate_hz).astype(np.int64)
    times = np.unique(start + edges + rng.integers(-1002, 1003, len(edges)))
    decimation = Decimation(rate_hz, start)
    rig = Rig(slot_of(path="a", latency_ns=-3), rate_hz=Fraction(10**9))
    (k,) = rig.slots["a"].stream_numbers
    rig.sensing.subscribe(("a",), {"a": (decimation,)})
    newest, expected, taken = -(2**62), [], []
    for t_ns in times.tolist():
        if decimation.interval(t_ns) > newest:
            newest = decimation.interval(t_ns)
            expected.append(t_ns)
        taken += [sample.t_ns for sample in rig.samples(t_ns)]
    assert 100 < len(expected) <= len(times)
    assert taken == expected
    assert rig.sensor_arrays.streams.rows["seq"][k] == len(times) - 1, "each was delivered"


def test_one_sample_for_all_whose_intervals_begin_with_it() -> None:
    rig = Rig(slot_of(path="a", latency_ns=-3), slot_of(path="b", latency_ns=-3))
    rig.sensing.subscribe(("a", "b"), {"a": (Decimation(1e7, 10), Decimation(2.5e7, 10))})
    told = [(s.port, s.t_ns) for n in range(1, 22) for s in rig.samples(n)]
    assert [t for port, t in told if port == "a"] == [10, 50, 90, 110, 130, 170, 210]
    assert len([t for port, t in told if port == "b"]) == 21


def test_all_are_chosen_of_a_stream_whose_order_is_not_that_of_time() -> None:
    """From the first on that is older than the one before it."""

    def told(decimations: Decimations) -> list[int]:
        rig = Rig(slot_of(Reorder(probability=0.1, behind=2).build(stream()), path="a"))
        rig.sensing.subscribe(("a",), decimations)
        return [sample.t_ns for n in range(1, 300) for sample in rig.samples(n)]

    times = told({})
    late = next(k for k, (one, other) in enumerate(itertools.pairwise(times)) if other < one) + 1
    assert 2 < late < 150
    assert told({"a": (Decimation(1e5, 0),)}) == [times[0], *times[late:]]


def test_what_is_enough_holds_until_the_time_is_set_or_sensors_come() -> None:
    rig = Rig(slot_of(path="a", latency_ns=-3))
    counts = rig.sensor_arrays.streams.rows["decimation_count"]
    for forget in (rig.sensing.forget_newest, rig.sensing.sensors_changed):
        rig.sensing.subscribe(("a",), {"a": (Decimation(10.0, 0), Decimation(1.0, 0)), "gone": (Decimation(1.0, 0),)})
        assert counts.sum() == 2
        forget()
        rig.sensing.set_listeners((), ())
        assert counts.sum() == 0
    rig.sensing.subscribe(("a",), {"a": (Decimation(10.0, 0),)})
    rig.sensing.set_listeners(("a",), ())
    assert counts.sum() == 0, "a part of the world hears each one"
