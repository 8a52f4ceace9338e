"""What each modifier adds, as numbers: spreads, correlations and rates, in bounds that a right modifier misses once in a million."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from uwserver.modifiers import Bias, Delay, Dropout, GaussMarkov, Measurement, Quantise, RandomWalk, WhiteNoise

SEEDS = (1, 2, 3)
RISK = 1e-6
RUNS = 4000


def assert_sigma(samples: np.ndarray, sigma: float) -> None:
    """Independent normal samples of mean zero: chi-squared bounds of their variance, normal bounds of their mean."""
    n = samples.size
    low, high = stats.chi2.ppf([RISK / 2, 1 - RISK / 2], n) / n
    assert low < np.mean(samples**2) / sigma**2 < high
    assert abs(samples.mean()) < stats.norm.ppf(1 - RISK / 2) * sigma / math.sqrt(n)


def assert_correlation(a: np.ndarray, b: np.ndarray, expected: float) -> None:
    """Fisher's z of the correlation of independent pairs."""
    found = np.corrcoef(a, b)[0, 1]
    bound = stats.norm.ppf(1 - RISK / 2) / math.sqrt(a.size - 3)
    assert abs(math.atanh(found) - math.atanh(expected)) < bound, f"{found} instead of {expected}"


def assert_normal(samples: np.ndarray, sigma: float) -> None:
    assert stats.kstest(samples.ravel() / sigma, "norm").pvalue > RISK


@pytest.mark.parametrize("seed", SEEDS)
class TestWhiteNoise:
    def test_sigma(self, bench, errors, seed):
        found = errors(bench(WhiteNoise(field="x", sigma=0.2), seed=seed), 8000)
        for axis in found.T:
            assert_sigma(axis, 0.2)
        assert_normal(found, 0.2)

    def test_samples_and_components_are_independent(self, bench, errors, seed):
        found = errors(bench(WhiteNoise(field="x", sigma=0.2), seed=seed), 8000)
        for lag in (1, 2, 10):
            assert_correlation(found[:-lag, 0], found[lag:, 0], 0.0)
        assert_correlation(found[:, 0], found[:, 1], 0.0)
        assert_correlation(found[:, 1], found[:, 2], 0.0)

    @pytest.mark.parametrize("rate", [10.0, 100.0, 250.0])
    def test_density_grows_with_the_root_of_the_rate(self, bench, errors, seed, rate):
        found = errors(bench(WhiteNoise(field="x", density=0.003), dt=1 / rate, seed=seed), 3000)
        assert_sigma(found, 0.003 * math.sqrt(rate))

    def test_sigma_and_density_add_in_variance(self, bench, errors, seed):
        found = errors(bench(WhiteNoise(field="x", sigma=0.03, density=0.004), dt=0.01, seed=seed), 3000)
        assert_sigma(found, 0.05)

    def test_a_changed_rate_is_followed(self, bench, errors, seed):
        modifier = bench(WhiteNoise(field="x", density=0.01), dt=0.01, seed=seed)
        assert_sigma(errors(modifier, 2000), 0.1)
        modifier.stream.dt = 0.0004
        assert_sigma(errors(modifier, 2000), 0.5)


@pytest.mark.parametrize("seed", SEEDS)
class TestGaussMarkov:
    SIGMA, TAU = 0.3, 0.2

    def ensemble(self, bench, errors, seed, n=30, dt=0.01):
        return errors(
            bench(GaussMarkov(field="x", sigma=self.SIGMA, tau_s=self.TAU), shape=(RUNS,), dt=dt, seed=seed), n
        )

    def test_it_is_stationary_from_the_first_sample_on(self, bench, errors, seed):
        found = self.ensemble(bench, errors, seed)
        for k in (0, 1, 5, 29):
            assert_sigma(found[k], self.SIGMA)
        assert_normal(found[0], self.SIGMA)

    @pytest.mark.parametrize("dt", [0.002, 0.01, 0.1])
    def test_autocorrelation_decays_with_tau(self, bench, errors, seed, dt):
        found = self.ensemble(bench, errors, seed, dt=dt, n=12)
        for lag in (1, 5, 11):
            assert_correlation(found[0], found[lag], math.exp(-lag * dt / self.TAU))

    def test_a_changed_rate_keeps_sigma_and_tau(self, bench, errors, seed):
        modifier = bench(GaussMarkov(field="x", sigma=self.SIGMA, tau_s=self.TAU), shape=(RUNS,), dt=0.01, seed=seed)
        errors(modifier, 3)
        modifier.stream.dt = 0.1
        found = errors(modifier, 5)
        assert_sigma(found[-1], self.SIGMA)
        assert_correlation(found[0], found[1], math.exp(-0.5))

    def test_without_time_to_forget_it_is_white(self, bench, errors, seed):
        found = errors(bench(GaussMarkov(field="x", sigma=1.0, tau_s=1e-6), shape=(RUNS,), seed=seed), 2)
        assert_correlation(found[0], found[1], 0.0)


@pytest.mark.parametrize("seed", SEEDS)
class TestRandomWalk:
    def test_variance_grows_with_time(self, bench, errors, seed):
        found = errors(bench(RandomWalk(field="x", density=0.5), shape=(RUNS,), dt=0.04, seed=seed), 100)
        for k in (0, 9, 99):
            assert_sigma(found[k], 0.5 * math.sqrt((k + 1) * 0.04))

    def test_steps_are_independent(self, bench, errors, seed):
        steps = np.diff(errors(bench(RandomWalk(field="x", density=0.5), shape=(RUNS,), dt=0.04, seed=seed), 4), axis=0)
        assert_sigma(steps, 0.1)
        assert_correlation(steps[0], steps[1], 0.0)

    def test_the_same_time_gives_the_same_variance_at_every_rate(self, bench, errors, seed):
        for n, dt in ((10, 0.1), (50, 0.02)):
            found = errors(bench(RandomWalk(field="x", density=2.0), shape=(RUNS,), dt=dt, seed=seed), n)
            assert_sigma(found[-1], 2.0)


class TestBias:
    def test_one_number_for_all(self, bench, errors):
        assert np.array_equal(errors(bench(Bias(field="x", value=0.5)), 3), np.full((3, 3), 0.5))

    def test_one_number_a_component(self, bench, errors):
        assert np.array_equal(errors(bench(Bias(field="x", value=(1.0, -2.0, 0.0))), 2), [[1, -2, 0], [1, -2, 0]])

    def test_a_scalar_field(self, bench):
        modifier = bench(Bias(field="before", value=0.5))
        reading = Measurement([1.0, (0.0,) * 3, True], True)
        modifier.apply(reading)
        assert reading.values == [1.5, (0.0,) * 3, True]

    @pytest.mark.parametrize("value", [(), (1.0,), (1.0, 2.0), (1.0,) * 4])
    def test_another_number_of_components_is_refused(self, bench, value):
        with pytest.raises(ValueError, match='"value" needs one number or 3, one for each component of "x"'):
            bench(Bias(field="x", value=value))

    @pytest.mark.parametrize("seed", SEEDS)
    def test_turn_on_error_is_drawn_once(self, bench, errors, seed):
        found = errors(bench(Bias(field="x", value=5.0, sigma=0.25), shape=(RUNS,), seed=seed), 4)
        assert np.array_equal(found[0], found[3])
        assert_sigma(found[0] - 5.0, 0.25)
        assert_normal(found[0] - 5.0, 0.25)


class TestQuantise:
    @pytest.mark.parametrize(
        ("step", "value", "expected"),
        [
            (0.5, 0.7, 0.5),
            (0.5, 0.8, 1.0),
            (0.5, -0.8, -1.0),
            (20.0, 101_337.0, 101_340.0),
            (1.0, 0.4, 0.0),
            (1.0, -0.4, 0.0),
            (2.0, 3.1, 4.0),
        ],
    )
    def test_nearest_multiple(self, bench, step, value, expected):
        modifier = bench(Quantise(field="x", step=step))
        reading = Measurement([0.0, (value,) * 3, True], True)
        modifier.apply(reading)
        assert reading.values[1] == (expected,) * 3

    def test_error_is_uniform_over_a_step(self, bench):
        values = np.random.default_rng(4).uniform(-50, 50, 20_000)
        reading = Measurement([0.0, tuple(values), True], True)
        bench(Quantise(field="x", step=0.3), shape=(20_000,)).apply(reading)
        error = np.array(reading.values[1]) - values
        assert np.abs(error).max() <= 0.15 + 1e-12
        assert stats.kstest(error, "uniform", args=(-0.15, 0.3)).pvalue > RISK
        steps = np.array(reading.values[1]) / 0.3
        assert np.abs(steps - np.round(steps)).max() < 1e-9


def delays(modifier, n):
    found = []
    for _ in range(n):
        reading = Measurement([0.0, (0.0,) * 3, True], True)
        modifier.apply(reading)
        found.append(reading.delay_ns)
    return np.array(found)


class TestDelay:
    def test_latency_is_exact_and_adds_up(self, bench):
        reading = Measurement([1.0, (2.0,) * 3, True], True, delay_ns=500)
        for latency in (0.02, 0.000_000_001):
            bench(Delay(latency_s=latency)).apply(reading)
        assert reading == Measurement([1.0, (2.0,) * 3, True], True, delay_ns=20_000_501)

    def test_without_jitter_nothing_is_drawn(self, bench):
        modifier = bench(Delay(latency_s=0.02))
        before = modifier.stream.rng.bit_generator.state
        delays(modifier, 10)
        assert modifier.stream.rng.bit_generator.state == before

    @pytest.mark.parametrize("seed", SEEDS)
    def test_jitter(self, bench, seed):
        found = delays(bench(Delay(latency_s=0.05, jitter_s=0.004), seed=seed), 8000)
        assert found.dtype.kind == "i"
        assert_sigma(found * 1e-9 - 0.05, 0.004)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_never_before_it_measured(self, bench, seed):
        found = delays(bench(Delay(latency_s=0.002, jitter_s=0.004), seed=seed), 8000)
        assert found.min() == 0
        at_once = stats.binomtest(int(np.sum(found == 0)), found.size, stats.norm.cdf(-0.5))
        assert at_once.pvalue > RISK


class TestDropout:
    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.parametrize("probability", [0.01, 0.2, 0.9])
    def test_rate(self, bench, seed, probability):
        lost = self.losses(bench(Dropout(probability=probability), seed=seed), 10_000)
        assert stats.binomtest(int(lost.sum()), lost.size, probability).pvalue > RISK

    @pytest.mark.parametrize("seed", SEEDS)
    def test_losses_are_independent(self, bench, seed):
        lost = self.losses(bench(Dropout(probability=0.3), seed=seed), 10_000)
        assert_correlation(lost[:-1], lost[1:], 0.0)

    @pytest.mark.parametrize("probability", [0.0, 1.0])
    def test_never_and_always(self, bench, probability):
        assert set(self.losses(bench(Dropout(probability=probability)), 1000)) == {probability}

    def test_what_was_lost_stays_lost(self, bench):
        reading = Measurement([0.0, (0.0,) * 3, True], True, dropped=True)
        bench(Dropout(probability=0.0)).apply(reading)
        assert reading.dropped

    @staticmethod
    def losses(modifier, n):
        readings = [Measurement([0.0, (0.0,) * 3, True], True) for _ in range(n)]
        for reading in readings:
            modifier.apply(reading)
        return np.array([float(reading.dropped) for reading in readings])
