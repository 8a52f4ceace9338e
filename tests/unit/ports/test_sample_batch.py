"""Rows become the samples that they stand for, as often as somebody looks."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest

from uwserver.modifiers.columns import columns_of
from uwserver.ports import Field, Sample
from uwserver.ports.crossing import TickOutput
from uwserver.ports.sample_batch import Origin, SampleBatch, SampleLog, Samples
from uwserver.step.streams import ENTRY

FORCE = columns_of((Field("f", "m/s^2", "Force.", shape=(3,)), Field("n", "1", "Number.", type="int")))
STATE = columns_of((Field("mode", "1", "Mode.", type="str"), Field("armed", "1", "Armed.", type="bool")))
SAMPLES = [
    Sample("rov/imu", 7, 100, 110, True, ((1.0, None, 3.0), 5)),
    Sample("rov/state", 2, 105, 110, False, ("manual", True)),
    Sample("rov/imu", 8, 104, 110, True, ((4.0, 5.0, 6.0), 1 << 60)),
]


def batch(log: SampleLog | None = None) -> SampleBatch:
    origins = {4: Origin("rov/imu", FORCE.width, FORCE.values), 9: Origin("rov/state", STATE.width, STATE.values)}
    return SampleBatch(origins, log or full(), 2, 5)


def full() -> SampleLog:
    """Two samples of before, and SAMPLES; there is room for more."""
    log = SampleLog(np.zeros(8, ENTRY), np.full(40, 77.0))
    log.entries[2:5] = [(110, 0, 4, 7, 100, 1, 8), (110, 0, 9, 2, 105, 0, 12), (110, 0, 4, 8, 104, 1, 13)]
    FORCE.pack(((1.0, math.nan, 3.0), 5), log.numbers[8:12])
    STATE.pack(("manual", True), log.numbers[12:13])
    FORCE.pack(((4.0, 5.0, 6.0), 1 << 60), log.numbers[13:17])
    log.loose[3] = ("manual",)
    return log


def ticks_of(log: SampleLog) -> tuple[SampleBatch, ...]:
    """One sample each."""
    origins = batch(log).origins
    return tuple(SampleBatch(origins, log, at, at + 1) for at in (2, 3, 4))


def test_rows_are_samples():
    rows = batch()
    assert list(rows) == list(rows) == SAMPLES
    assert len(rows) == 3
    assert rows.ports == ["rov/imu", "rov/state", "rov/imu"]
    assert [rows[0], rows[1], rows[-1]] == SAMPLES
    assert rows[1:] == SAMPLES[1:]
    assert rows[:-1] == SAMPLES[:-1]
    assert (rows.newest("rov/imu"), rows.newest("rov/state")) == (SAMPLES[2], SAMPLES[1])
    with pytest.raises(IndexError):
        rows[3]


def test_texts_are_those_of_the_origin_or_of_the_sample_itself():
    log, texts = full(), (("auto",), ("guided",))
    log.entries["order"][3] = 2
    origins = {4: batch().origins[4], 9: Origin("rov/state", STATE.width, STATE.values, texts)}
    rows = SampleBatch(origins, log, 2, 5)
    assert rows[1] == Sample("rov/state", 2, 105, 110, False, ("guided", True))
    assert [rows.loose(3, n, 9) for n in (0, 1, 2)] == [("manual",), ("auto",), ("guided",)]
    assert rows.loose(2, 0, 4) == ()


def test_those_that_follow_each_other_are_told_together():
    log = full()
    first, second, third = ticks_of(log)
    both = first.followed_by(second)
    assert both is not None
    assert list(both) == SAMPLES[:2]
    assert list(both.followed_by(third) or ()) == SAMPLES
    assert first.followed_by(third) is None, "one is missing"
    assert first.followed_by(SampleBatch(first.origins, full(), 3, 4)) is None, "of another log"
    assert first.followed_by(SampleBatch(dict(first.origins), log, 3, 4)) is None, "sensors came or went"


def test_several_ticks_come_apart_again():
    log = full()
    first, second, third = ticks_of(log)
    both = first.followed_by(second)
    assert both is not None
    late = second.followed_by(third)
    assert late is not None
    for some in (both.followed_by(third), first.followed_by(late)):
        assert some is not None
        assert [(tick.ticks, list(tick)) for tick in some.by_tick()] == [(1, [sample]) for sample in SAMPLES]
    assert [list(tick) for tick in both.by_tick()] == [[sample] for sample in SAMPLES[:2]]
    assert [list(tick) for tick in batch(log).by_tick()] == [SAMPLES]


def test_an_output_makes_them_once_and_before_the_others():
    output = TickOutput(1, 1, SAMPLES[2:], batch=SampleBatch({}, full(), 2, 2))
    output.batch = batch()
    samples = output.samples
    assert samples == [*SAMPLES, SAMPLES[2]]
    assert output.batch is None
    assert output.samples is samples


def test_dropped_samples_are_counted_and_gone():
    output = TickOutput(1, 1, SAMPLES[2:], batch=batch())
    assert output.drop_samples() == 4
    assert output.samples == []
    assert output.drop_samples() == 0


@pytest.fixture
def made(monkeypatch):
    """Receives how many samples are made each time some are."""
    counts, entries = [], SampleBatch.entries
    monkeypatch.setattr(SampleBatch, "entries", lambda self: counts.append(len(self)) or entries(self))
    return counts


def several() -> Samples:
    """Rows, then one that was made already."""
    samples = Samples()
    samples.add(batch())
    samples.add([])
    samples.add(SAMPLES[:1])
    return samples


def test_samples_of_steps_are_made_when_somebody_looks_and_once(made):
    samples, wanted = several(), [*SAMPLES, SAMPLES[0]]
    assert (len(samples), bool(samples), made) == (4, True, [])
    assert not Samples()
    assert [*samples] == wanted
    assert made == [3]
    assert samples[1] is samples[1]
    assert (samples[-1], samples[1:3]) == (wanted[-1], wanted[1:3])
    assert samples == wanted == samples == several()
    assert samples != wanted[:3]
    assert samples + [1] == [*wanted, 1]  # noqa: RUF005  # that it can be added
    assert [1] + samples == [1, *wanted]  # noqa: RUF005
    grown = [0]
    grown += samples
    assert grown == [0, *wanted]
    assert repr(samples) == repr(wanted)
    assert copy.copy(several()) == pickle.loads(pickle.dumps(samples)) == wanted
    samples.add(batch())
    assert [*samples] == [*wanted, *SAMPLES]


def test_those_of_few_ports_alone_are_made(made):
    samples = several()
    assert [*samples.of({"rov/state"})] == [SAMPLES[1]]
    assert made == [1]
    assert [*samples.of({"rov/imu"})] == [SAMPLES[0], SAMPLES[2], SAMPLES[0]]
    assert made == [1, 3], "all at once is quicker"
    assert [*samples.of({"rov/imu"})] == [SAMPLES[0], SAMPLES[2], SAMPLES[0]]
    assert [*samples] == [*SAMPLES, SAMPLES[0]]
    assert [*samples.of({"rov/imu"})] == [SAMPLES[0], SAMPLES[2], SAMPLES[0]]


def test_many_samples_are_counted_at_a_prompt():
    samples = Samples()
    samples.add([Sample(f"rov/{k % 2}", k, k * 10**9, k * 10**9, True, (1.0,)) for k in range(5)])
    assert repr(samples).startswith("[Sample(")
    samples.add([Sample("rov/imu", 9, 7_500_000_000, 7_500_000_000, True, (1.0,))])
    assert repr(samples) == "<6 samples of 3 sensors, measured from 0.000 to 7.500 s>"
