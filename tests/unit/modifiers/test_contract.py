"""What holds for every modifier: missing values, field names, and that it can be saved and continued."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from uwserver.modifiers import (
    Bias,
    Delay,
    Dropout,
    GaussMarkov,
    Measurement,
    ModifierConfig,
    Quantise,
    RandomWalk,
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
]
OF_A_FIELD = [config for config in ONE_OF_EACH if hasattr(config, "field")]


def kind(config):
    return type(config).__struct_config__.tag


def run(modifier, n, value=(0.1, 0.2, 0.3)):
    outcome = []
    for _ in range(n):
        reading = Measurement([7.0, value, True], True)
        modifier.apply(reading)
        outcome.append((tuple(reading.values), reading.valid, reading.delay_ns, reading.dropped))
    return outcome


def test_every_kind_is_tested():
    assert {type(config) for config in ONE_OF_EACH} == set(ModifierConfig.__args__)


@pytest.mark.parametrize("config", ONE_OF_EACH, ids=kind)
def test_same_seed_same_numbers_other_seed_or_path_others(bench, config):
    first = run(bench(config, seed=1), 40)
    assert run(bench(config, seed=1), 40) == first
    if config != ONE_OF_EACH[4]:  # a converter does not draw
        assert run(bench(config, seed=2), 40) != first
        assert run(bench(config, path="rov/imu/noise2"), 40) != first
        assert run(bench(config, path="rov2/imu/noise"), 40) != first


@pytest.mark.parametrize("config", ONE_OF_EACH, ids=kind)
def test_memory_and_stream_are_all_that_it_remembers(bench, config):
    """A snapshot holds these two; so a modifier of another run that gets them goes on bit for bit."""
    modifier = bench(config)
    run(modifier, 25)
    memory, stream = copy.deepcopy(modifier.memory), copy.deepcopy(modifier.stream.rng.bit_generator.state)
    assert json.loads(json.dumps(memory)) == memory  # plain numbers, so that it can be saved
    expected = run(modifier, 25)
    for other in (modifier, bench(config, seed=99)):
        other.memory = list(memory)
        other.stream.rng.bit_generator.state = stream
        assert run(other, 25) == expected


@pytest.mark.parametrize("config", OF_A_FIELD, ids=kind)
def test_missing_values_stay_missing(bench, config):
    modifier = bench(config)
    for missing in ((None,) * 3, None):
        reading = Measurement([7.0, missing, True], False)
        modifier.apply(reading)
        assert reading.values == [7.0, missing, True]
        assert not reading.valid
    reading = Measurement([7.0, (1.1, None, 2.2), True], True)
    modifier.apply(reading)
    assert reading.values[1][1] is None
    assert reading.values[1][0] != 1.1
    assert reading.values[1][2] != 2.2


@pytest.mark.parametrize("config", OF_A_FIELD, ids=kind)
def test_a_missing_value_does_not_shift_the_numbers_after_it(bench, config):
    with_gap, whole = bench(config), bench(config)
    run(with_gap, 3, value=(None,) * 3)
    run(whole, 3)
    assert run(with_gap, 5) == run(whole, 5)


@pytest.mark.parametrize("config", OF_A_FIELD, ids=kind)
def test_one_component_of_one_field_is_changed_alone(bench, config):
    modifier = bench(config, shape=())
    reading = Measurement([7.0, 0.1, True], True)
    modifier.apply(reading)
    assert reading.values[0] == 7.0
    assert isinstance(reading.values[1], float)
    assert reading.values[1] != 0.1


@pytest.mark.parametrize("config", OF_A_FIELD, ids=kind)
@pytest.mark.parametrize("name", ["y", "ok", ""])
def test_an_unknown_field_is_refused_with_those_that_are_there(bench, config, name):
    changed = type(config)(**{key: getattr(config, key) for key in config.__struct_fields__} | {"field": name})
    with pytest.raises(ValueError, match=f'no field "{name}" to modify here, there are: before, x$'):
        bench(changed)


@pytest.mark.parametrize("config", [c for c in OF_A_FIELD if kind(c) != "quantise"], ids=kind)
def test_errors_do_not_depend_on_the_value(bench, config):
    low = np.array([values[1] for values, *_ in run(bench(config), 10, (0.0,) * 3)])
    high = np.array([values[1] for values, *_ in run(bench(config), 10, (1000.0,) * 3)])
    assert high - low == pytest.approx(np.full((10, 3), 1000.0))
