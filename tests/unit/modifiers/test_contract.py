"""What holds for every modifier: missing values, field names, and that it can be saved and continued."""

from __future__ import annotations

import copy

import msgspec
import numpy as np
import pytest

from uwserver.modifiers import (
    Bias,
    ClockDrift,
    Delay,
    Drift,
    Dropout,
    GaussMarkov,
    Measurement,
    Misalignment,
    ModifierConfig,
    Outlier,
    Quantise,
    RandomWalk,
    Reorder,
    Saturate,
    Scale,
    Stream,
    WhiteNoise,
)

ONE_OF_EACH = [
    WhiteNoise(field="x", sigma=0.1, density=0.01),
    GaussMarkov(field="x", sigma=0.1, tau_s=0.5),
    RandomWalk(field="x", density=0.1),
    Bias(field="x", value=0.3, sigma=0.1),
    Quantise(field="x", step=0.25),
    Delay(latency_s=0.02, jitter_s=0.01),
    Dropout(probability=0.5),
    Drift(field="x", rate=0.1, rate_sigma=0.1, density=0.1),
    Scale(field="x", factor=1.1, sigma=0.1),
    Misalignment(fields=("x",), rpy_deg=(10.0, 20.0, 30.0), sigma_deg=5.0),
    Outlier(field="x", probability=0.5, sigma=3.0),
    Saturate(field="x", minimum=0.15, maximum=0.25),
    Reorder(probability=0.5, behind=2),
    ClockDrift(offset_s=0.1, offset_sigma_s=0.1, drift=1e-3, drift_sigma=1e-3, walk_sqrts=1e-3),
]
OF_A_FIELD = [config for config in ONE_OF_EACH if hasattr(config, "field")]
DRAWN = [config for config in ONE_OF_EACH if not isinstance(config, (Quantise, Saturate))]
"""A converter does not draw."""
ADDED = [config for config in OF_A_FIELD if not isinstance(config, (Quantise, Saturate, Scale))]
"""What adds an error to each value, whatever the value is."""
DT_NS = 10_000_000


def kind(config):
    return type(config).__struct_config__.tag


def run(modifier, n, value=(0.1, 0.2, 0.3), start=0):
    outcome = []
    for k in range(start, start + n):
        reading = Measurement([7.0, value, True], True, t_ns=(k + 1) * DT_NS, number=k)
        modifier.apply(reading)
        outcome.append((tuple(reading.values), reading.valid, reading.delay_ns, reading.dropped, reading.stamp_ns))
    return outcome


def test_every_kind_is_tested():
    assert {type(config) for config in ONE_OF_EACH} == set(ModifierConfig.__args__)


@pytest.mark.parametrize("config", ONE_OF_EACH, ids=kind)
def test_same_seed_same_numbers_other_seed_or_path_others(bench, config):
    first = run(bench(config, seed=1), 40)
    assert run(bench(config, seed=1), 40) == first
    if config in DRAWN:
        assert run(bench(config, seed=2), 40) != first
        assert run(bench(config, path="rov/imu/noise2"), 40) != first
        assert run(bench(config, path="rov2/imu/noise"), 40) != first


@pytest.mark.parametrize("config", ONE_OF_EACH, ids=kind)
def test_memory_is_all_that_it_remembers(bench, config):
    """A snapshot holds it, and the number of readings; so a modifier of another run of this scenario goes on bit for bit."""
    modifier = bench(config)
    run(modifier, 25)
    memory = copy.deepcopy(modifier.memory)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(memory), type=type(memory)) == memory
    expected = run(modifier, 25, start=25)
    for other in (modifier, bench(config)):
        other.memory = copy.copy(memory)
        assert run(other, 25, start=25) == expected


@pytest.mark.parametrize("config", ONE_OF_EACH, ids=kind)
def test_a_record_outside_its_limits_is_refused(bench, config):
    modifier = bench(config)
    if len(modifier.numbers):
        with pytest.raises(ValueError, match="Expected"):
            modifier.record(np.full(len(modifier.numbers), 1e30))


@pytest.mark.parametrize("config", OF_A_FIELD, ids=kind)
def test_missing_values_stay_missing(bench, config):
    modifier = bench(config)
    for missing in ((None,) * 3, None):
        reading = Measurement([7.0, missing, True], False)
        modifier.apply(reading)
        assert reading.values == [7.0, (None,) * 3, True]
        assert not reading.valid
    read = [values[1] for values, *_ in run(modifier, 20, (1.1, None, 2.2))]
    assert all(value[1] is None for value in read)
    assert any(value[0] != 1.1 for value in read)
    assert any(value[2] != 2.2 for value in read)


@pytest.mark.parametrize("config", OF_A_FIELD, ids=kind)
def test_a_missing_value_does_not_shift_the_numbers_after_it(bench, config):
    with_gap, whole = bench(config), bench(config)
    run(with_gap, 3, value=(None,) * 3)
    run(whole, 3)
    assert run(with_gap, 20, start=3) == run(whole, 20, start=3)


@pytest.mark.parametrize("config", OF_A_FIELD, ids=kind)
def test_one_component_of_one_field_is_changed_alone(bench, config):
    modifier = bench(config, shape=())
    read = [values for values, *_ in run(modifier, 20, 0.1)]
    assert all(values[0] == 7.0 and isinstance(values[1], float) for values in read)
    assert any(values[1] != 0.1 for values in read)


@pytest.mark.parametrize("config", OF_A_FIELD, ids=kind)
@pytest.mark.parametrize("name", ["y", "ok", ""])
def test_an_unknown_field_is_refused_with_those_that_are_there(bench, config, name):
    changed = type(config)(**{key: getattr(config, key) for key in config.__struct_fields__} | {"field": name})
    with pytest.raises(ValueError, match=f'no field "{name}" to modify here, there are: before, x$'):
        bench(changed)


@pytest.mark.parametrize("config", ADDED, ids=kind)
def test_errors_do_not_depend_on_the_value(bench, config):
    low = np.array([values[1] for values, *_ in run(bench(config), 10, (0.0,) * 3)])
    high = np.array([values[1] for values, *_ in run(bench(config), 10, (1000.0,) * 3)])
    assert high - low == pytest.approx(np.full((10, 3), 1000.0))


def test_what_one_in_python_draws_once_a_run_is_drawn_at_no_reading():
    """Or its constant error would be its noise of the first reading."""
    stream = Stream((), 0.01, 7)
    once = stream.rng.standard_normal(3).tolist()
    assert Stream((), 0.01, 7).rng.standard_normal(3).tolist() == once
    for number in range(3):
        stream.draws.seek(number)
        assert not set(stream.rng.standard_normal(3).tolist()) & set(once)


def test_what_one_in_python_draws_at_a_reading_is_that_of_the_reading_alone():
    one, other = Stream((), 0.01, 7), Stream((), 0.01, 7)
    for number in range(5):
        one.draws.seek(number)
        one.rng.uniform(size=number)
        one.rng.integers(10)  # leaves half a word over
    for stream in (one, other):
        stream.draws.seek(5)
    assert one.rng.integers(1 << 30, size=3).tolist() == other.rng.integers(1 << 30, size=3).tolist()
    assert one.rng.standard_normal(3).tolist() == other.rng.standard_normal(3).tolist()
