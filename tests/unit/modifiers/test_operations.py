"""A modifier of compiled code as an operation on rows: which numbers it changes, what it remembers, and where that lies."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from uwserver.frames import conjugate, quat_from_rpy, rotate
from uwserver.modifiers import (
    Bias,
    ClockDrift,
    Delay,
    GaussMarkov,
    Measurement,
    Misalignment,
    Saturate,
    Stream,
    WhiteNoise,
)
from uwserver.modifiers.noise import WHITE, Correlated
from uwserver.modifiers.operations import READING, rounded_ns, since
from uwserver.physics.kernel.random import SAMPLE, draw_normals, key_of
from uwserver.ports import Field
from uwserver.units import rad

FIELDS = (
    Field("name", "1", "a text", type="str"),
    Field("n", "1", "a whole number", type="int"),
    Field("depth", "m", "a scalar"),
    Field("v_S", "m/s", "a vector", "S", (3,)),
    Field("w_S", "rad/s", "another", "S", (3,)),
    Field("ok", "1", "a flag", type="bool"),
)
VALUES = ("a text", 1 << 60, 2.0, (0.1, -0.2, 0.3), (1.0, 2.0, 3.0), True)
KEY = key_of(3, "rov/x/noise")


def built(config):
    return config.build(Stream(FIELDS, 0.01, KEY))


def applied(modifier, number=0, **given):
    reading = Measurement(list(VALUES), True, t_ns=(number + 1) * 10_000_000, number=number, **given)
    modifier.apply(reading)
    return reading


def test_it_changes_the_components_of_its_field_and_nothing_else():
    noise = built(WhiteNoise(field="v_S", sigma=0.5))
    assert noise.rows["code"].tolist() == [WHITE]
    assert (noise.rows["first"][0], noise.rows["count"][0]) == (2, 3)  # the text has no place
    for number in (0, 5, 1 << 33):
        reading = applied(noise, number)
        error = 0.5 * draw_normals(KEY, 3, number, SAMPLE)
        assert reading.values[3] == tuple((np.array(VALUES[3]) + error).tolist())
        assert [v for k, v in enumerate(reading.values) if k != 3] == [v for k, v in enumerate(VALUES) if k != 3]


def test_what_is_told_beside_the_values_is_kept_as_it_was():
    reading = applied(built(Bias(field="depth", value=1.0)), delay_ns=5, stamp_ns=-7, since_ns=3)
    assert (reading.delay_ns, reading.stamp_ns, reading.since_ns, reading.dropped) == (5, -7, 3, False)
    invalid = Measurement(list(VALUES), False)
    built(Saturate(field="depth", maximum=1.0)).apply(invalid)
    assert invalid.valid is False
    assert applied(built(Delay(latency_s=0.02)), delay_ns=5).delay_ns == 20_000_005


def test_memory_is_a_record_of_what_lies_among_the_numbers():
    wander = built(GaussMarkov(field="v_S", sigma=0.5, tau_s=1.0))
    assert isinstance(wander.memory, Correlated)
    assert wander.memory == Correlated(error=tuple((0.5 * draw_normals(KEY, 3)).tolist()))
    reading = applied(wander)
    assert wander.memory.last == 0.01
    assert reading.values[3] == tuple(v + e for v, e in zip(VALUES[3], wander.memory.error, strict=True))
    wander.memory = Correlated(last=2.0, error=(1.0, 2.0, 3.0))
    assert wander.numbers.tolist() == [2.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize("numbers", [[-2.0, 0.0, 0.0, 0.0], [0.0, np.nan, 0.0, 0.0], [0.0, 0.0, 1e10, 0.0]])
def test_numbers_beyond_the_limits_are_no_memory(numbers):
    """They may come from a file."""
    with pytest.raises(msgspec.ValidationError):
        built(GaussMarkov(field="v_S", sigma=0.5, tau_s=1.0)).record(np.array(numbers))


def test_a_memory_of_another_length_is_refused():
    with pytest.raises(ValueError, match='"error" has 2 numbers, here it needs 3'):
        built(GaussMarkov(field="v_S", sigma=0.5, tau_s=1.0)).valid(Correlated(error=(1.0, 2.0)))


def test_several_fields_share_one_memory():
    turn = built(Misalignment(fields=("v_S", "w_S"), rpy_deg=(10.0, 20.0, 30.0)))
    assert turn.rows["first"].tolist() == [2, 5]
    assert turn.rows["memory"].tolist() == [0, 0]
    assert turn.memory.q == pytest.approx(quat_from_rpy(rad(10.0), rad(20.0), rad(30.0)))
    reading = applied(turn)
    for k in (3, 4):
        assert reading.values[k] == pytest.approx(rotate(conjugate(turn.memory.q), VALUES[k]), abs=1e-12)


def test_a_modifier_of_no_field_changes_only_what_is_told_beside_the_values():
    reading = applied(built(ClockDrift(offset_s=0.5)))
    assert tuple(reading.values) == VALUES
    assert reading.stamp_ns == 500_000_000


def test_time_since_a_reading_is_that_of_the_measurement():
    header = np.zeros(1, READING)
    header["t_ns"] = 3_000_000_000
    reading = Measurement([], True, t_ns=3_000_000_000)
    for last in (-1.0, 0.0, 2.5, 4.0):
        assert since.py_func(header[0].view(np.recarray), last, 0.25) == reading.since(last, 0.25)


@pytest.mark.parametrize(("seconds", "ns"), [(0.0, 0), (1.5e-9, 2), (-1.4e-9, -1), (9e9, 9 * 10**18)])
def test_times_are_rounded_to_whole_nanoseconds(seconds, ns):
    assert rounded_ns(seconds) == ns
