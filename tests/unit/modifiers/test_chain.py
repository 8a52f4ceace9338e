"""Modifiers in a world: their order, one stream a path, gaps and delays of what is delivered."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.modifiers import Bias, Delay, Dropout, GaussMarkov, Quantise, WhiteNoise
from uwserver.physics.kernel.random import SAMPLE, draw_normals, key_of
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import ImuConfig, PressureConfig

NOISE = WhiteNoise(field="f_S", sigma=0.1)
WANDER = GaussMarkov(field="w_S", sigma=0.1, tau_s=1.0)


def world_of(sensors, seed=7):
    entry = VehicleEntry(model="bluerov2_heavy", position_ned_m=(0.0, 0.0, 5.0), sensors=sensors)
    return build(load(Scenario(schema=1, seed=seed, vehicles={"rov": entry}), adapters={}))


def imu(**modifiers):
    return ImuConfig(rate_hz=120, modifiers=modifiers)


def samples_of(world, port="rov/x", ticks=80):
    return [sample for sample in world.step(ticks) if sample.port == port]


def column(samples, k):
    return np.array([sample.value[k] for sample in samples])


def test_the_sample_is_the_ideal_value_plus_the_error_of_its_path():
    noisy = column(samples_of(world_of({"x": imu(noise=NOISE)})), 0)
    ideal = column(samples_of(world_of({"x": imu()})), 0)
    drawn = [0.1 * draw_normals(key_of(7, "rov/x/noise"), 3, number, SAMPLE) for number in range(len(noisy))]
    assert noisy - ideal == pytest.approx(np.array(drawn), abs=1e-12)


def test_a_further_modifier_does_not_change_the_numbers_of_another():
    alone = samples_of(world_of({"x": imu(noise=NOISE)}))
    both = samples_of(
        world_of({"x": imu(wander=WANDER, noise=NOISE, loss=Dropout(probability=0.0), link=Delay(latency_s=0.0))})
    )
    assert np.array_equal(column(alone, 0), column(both, 0))
    assert not np.array_equal(column(alone, 1), column(both, 1))


def test_a_further_sensor_or_vehicle_does_not_change_the_numbers_of_another():
    alone = samples_of(world_of({"x": imu(noise=NOISE)}))
    more = samples_of(world_of({"a": imu(noise=NOISE), "x": imu(noise=NOISE), "z": PressureConfig(rate_hz=60)}))
    assert alone == more


def test_same_seed_same_samples_other_seed_others():
    def values(seed):
        return [sample.value for sample in samples_of(world_of({"x": imu(noise=NOISE, wander=WANDER)}, seed))]

    assert values(7) == values(7)
    assert values(7) != values(8)


def test_sensors_and_modifiers_of_the_same_kind_are_independent():
    world = world_of({"x": imu(a=NOISE, b=NOISE), "y": imu(a=NOISE)})
    ideal = column(samples_of(world_of({"x": imu()}), ticks=2000), 0)
    samples = world.step(2000)
    x, y = (column([s for s in samples if s.port == f"rov/{name}"], 0) - ideal for name in "xy")
    assert abs(np.corrcoef(x[:, 0], y[:, 0])[0, 1]) < 5 / np.sqrt(
        len(x)
    )  # if one of x's two errors were y's, it would be 0.71
    a, b = (0.1 * draw_normals(key_of(7, f"rov/x/{name}"), 3, 0, SAMPLE) for name in "ab")
    assert x[:1] == pytest.approx(np.array([a + b]), abs=1e-12)


@pytest.mark.parametrize(
    ("one", "other"), [("rov/x/a", "rov/x/b"), ("rov/x/ab", "rov/x/a"), ("rov1/x/a", "rov/1x/a"), ("a", "a\x00")]
)
def test_streams_of_two_paths_share_nothing(one, other):
    a, b = (draw_normals(key_of(7, path), 4000) for path in (one, other))
    assert abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(4000)
    assert not np.intersect1d(a, b).size


def test_modifiers_act_in_the_order_of_the_file():
    step, bias = Quantise(field="f_S", step=0.5), Bias(field="f_S", value=0.1)
    last = column(samples_of(world_of({"x": imu(bias=bias, step=step)})), 0)
    first = column(samples_of(world_of({"x": imu(step=step, bias=bias)})), 0)
    assert np.array_equal(last % 0.5, np.zeros_like(last))
    assert first % 0.5 == pytest.approx(np.full_like(first, 0.1))


def test_what_is_lost_leaves_a_gap():
    samples = samples_of(world_of({"x": imu(loss=Dropout(probability=0.3))}), ticks=2000)
    seqs = [sample.seq for sample in samples]
    assert seqs == sorted(set(seqs))
    assert 600 < len(seqs) < 800  # 1000 measured
    assert max(np.diff(seqs)) > 1
    assert all(abs(sample.t_ns - (sample.seq + 1) * 1e9 / 120) <= 1 for sample in samples)


def test_a_loss_does_not_shift_the_errors_of_the_others():
    """The lost reading was made: what follows has the numbers that it would have had."""
    whole = samples_of(world_of({"x": imu(noise=NOISE, wander=WANDER)}))
    lossy = samples_of(world_of({"x": imu(loss=Dropout(probability=0.5), noise=NOISE, wander=WANDER)}))
    assert 5 < len(lossy) < 35
    assert all(sample == whole[sample.seq] for sample in lossy)


def test_a_delay_keeps_the_time_of_truth_and_adds_to_the_latency_of_the_sensor():
    sensor = ImuConfig(rate_hz=120, latency_s=0.01, modifiers={"link": Delay(latency_s=0.03)})
    world = world_of({"x": sensor})
    for _ in range(60):
        before = world.t_ns
        for sample in samples_of(world, ticks=1):
            assert sample.t_sent_ns - sample.t_ns == 40_000_000
            assert before < sample.t_sent_ns <= world.t_ns
            assert sample.t_ns == world.ticks.time_of(2 * (sample.seq + 1))


def test_jitter_delivers_each_sample_once_in_its_tick():
    world = world_of({"x": imu(link=Delay(latency_s=0.02, jitter_s=0.01))})
    seqs = []
    for _ in range(1000):
        before = world.t_ns
        for sample in samples_of(world, ticks=1):
            assert sample.t_ns <= sample.t_sent_ns
            assert before < sample.t_sent_ns <= world.t_ns
            seqs.append(sample.seq)
    assert len(set(seqs)) == len(seqs) >= 490
    assert seqs != sorted(seqs)  # at this jitter some overtake others
