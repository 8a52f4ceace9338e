"""What each modifier adds, as numbers: spreads, correlations and rates, in bounds that a right modifier misses once in a million."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from uwserver.frames import multiply, quat_from_rpy, rotate
from uwserver.modifiers import (
    Bias,
    ClockDrift,
    Delay,
    Drift,
    Dropout,
    GaussMarkov,
    Measurement,
    Misalignment,
    Outlier,
    Quantise,
    RandomWalk,
    Reorder,
    Saturate,
    Scale,
    Stream,
    WhiteNoise,
)
from uwserver.physics.kernel.random import key_of
from uwserver.ports import Field

SEEDS = (1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow))
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

    def test_a_pause_counts(self, bench, seed):
        """Of a device that pings at its own pace, or was off, the error goes on with the time between two readings, not with their number."""
        modifier = bench(RandomWalk(field="x", density=0.5), shape=(RUNS,), dt=0.01, seed=seed)
        found = []
        for number, t_ns in enumerate((10_000_000, 4_010_000_000)):
            reading = Measurement([7.0, (0.0,) * RUNS, True], True, t_ns=t_ns, number=number)
            modifier.apply(reading)
            found.append(np.array(reading.values[1]))
        assert_sigma(found[0], 0.05)
        assert_sigma(found[1] - found[0], 1.0)


@pytest.mark.parametrize("seed", SEEDS)
class TestDrift:
    def test_it_is_straight_in_time(self, bench, errors, seed):
        found = errors(bench(Drift(field="x", rate=(0.1, 0.0, -0.2)), dt=0.04, seed=seed), 50)
        t = 0.04 * np.arange(1, 51)
        assert found == pytest.approx(np.outer(t, (0.1, 0.0, -0.2)), abs=1e-12)

    def test_a_rate_is_drawn_once(self, bench, errors, seed):
        found = errors(bench(Drift(field="x", rate=2.0, rate_sigma=0.3), shape=(RUNS,), dt=0.5, seed=seed), 4)
        rates = found / (0.5 * np.arange(1, 5))[:, None]
        assert rates[3] == pytest.approx(rates[0])
        assert_sigma(rates[0] - 2.0, 0.3)
        assert_normal(rates[0] - 2.0, 0.3)

    def test_the_walk_grows_with_the_root_of_time(self, bench, errors, seed):
        """Unit over sqrt(s): 0.5 m/sqrt(s) makes 1 m after 4 s, at every rate."""
        for n, dt in ((4, 1.0), (100, 0.04)):
            found = errors(bench(Drift(field="x", rate=1.0, density=0.5), shape=(RUNS,), dt=dt, seed=seed), n)
            assert_sigma(found[-1] - 4.0, 1.0)
            steps = np.diff(found, axis=0)
            assert_correlation(steps[0], steps[1], 0.0)

    def test_a_random_walk_is_a_drift_without_rate(self, bench, errors, seed):
        walk, drift = RandomWalk(field="x", density=0.5), Drift(field="x", density=0.5)
        assert np.array_equal(errors(bench(walk, seed=seed), 20), errors(bench(drift, seed=seed), 20))


def changed(modifier, *values, valid=True, t_ns=0, number=0):
    reading = Measurement(list(values), valid, t_ns=t_ns, number=number)
    modifier.apply(reading)
    return reading


class TestScale:
    def test_one_factor_for_all_or_one_a_component(self, bench):
        assert changed(bench(Scale(field="x", factor=1.5)), 7.0, (1.0, -2.0, 0.0), True).values[1] == (1.5, -3.0, 0.0)
        each = bench(Scale(field="x", factor=(1.0, 2.0, -1.0)))
        assert changed(each, 7.0, (1.0, -2.0, 3.0), True).values[1] == (1.0, -4.0, -3.0)
        assert changed(bench(Scale(field="before", factor=0.5)), 7.0, (1.0,) * 3, True).values[0] == 3.5

    def test_another_number_of_components_is_refused(self, bench):
        with pytest.raises(ValueError, match='"factor" needs one number or 3, one for each component of "x"'):
            bench(Scale(field="x", factor=(1.0, 2.0)))

    @pytest.mark.parametrize("seed", SEEDS)
    def test_an_error_of_the_factor_is_drawn_once(self, bench, seed):
        modifier = bench(Scale(field="x", factor=1.02, sigma=0.01), shape=(RUNS,), seed=seed)
        found = [np.array(changed(modifier, 7.0, (4.0,) * RUNS, True).values[1]) for _ in range(3)]
        assert np.array_equal(found[0], found[2])
        assert_sigma(found[0] / 4.0 - 1.02, 0.01)
        assert_normal(found[0] / 4.0 - 1.02, 0.01)


FIELDS = (
    Field("v_S", "m/s", "", "S", (3,)),
    Field("q_NS", "1", "", "NS", (4,)),
    Field("covariance_S", "1", "", "S", (3, 3)),
    Field("ranges", "m", "", "", (3,)),
)


def askew(seed=1, **keys):
    return Misalignment(**keys).build(Stream(FIELDS, 0.01, key_of(seed, "rov/x/askew")))


class TestMisalignment:
    ANGLES = (1.0, -2.0, 30.0)
    Q = quat_from_rpy(*np.radians(ANGLES))

    def test_a_vector_is_told_in_the_axes_of_the_device(self):
        """What lies along the device's own x axis is told as pure x."""
        along_x = rotate(self.Q, (2.0, 0.0, 0.0))
        found = changed(askew(fields=("v_S",), rpy_deg=self.ANGLES), along_x, None, None, None).values[0]
        assert found == pytest.approx((2.0, 0.0, 0.0), abs=1e-12)

    def test_a_level_turn_in_closed_form(self):
        found = changed(askew(fields=("v_S",), rpy_deg=(0.0, 0.0, 1.0)), (1.0, 0.0, 3.0), None, None, None).values[0]
        assert found == pytest.approx((math.cos(math.radians(1.0)), -math.sin(math.radians(1.0)), 3.0), abs=1e-12)

    def test_vector_and_rotation_turn_together(self):
        """R(q_told) v_told is what R(q) v was: the world is not turned, only the axes in which it is told."""
        q, v = quat_from_rpy(0.3, -0.5, 2.0), (1.0, 2.0, -3.0)
        modifier = askew(fields=("v_S", "q_NS"), rpy_deg=self.ANGLES, sigma_deg=5.0)
        values = changed(modifier, v, q, (1.0,) * 9, (1.0, 2.0, 3.0)).values
        assert rotate(values[1], values[0]) == pytest.approx(rotate(q, v), abs=1e-12)
        assert math.hypot(*values[1]) == pytest.approx(1.0, abs=1e-12)
        assert values[1] != pytest.approx(q, abs=0.01)
        assert values[2:] == [(1.0,) * 9, (1.0, 2.0, 3.0)]

    def test_a_rotation_in_closed_form(self):
        q = quat_from_rpy(0.3, -0.5, 2.0)
        found = changed(askew(fields=("q_NS",), rpy_deg=self.ANGLES), None, q, None, None).values[1]
        assert found == pytest.approx(multiply(q, self.Q), abs=1e-12)

    @pytest.mark.parametrize("name", ["covariance_S", "ranges", "v"])
    def test_what_cannot_turn_is_refused(self, name):
        with pytest.raises(ValueError, match=f'no vector or rotation "{name}" to turn here, there are: v_S, q_NS$'):
            askew(fields=("v_S", name))

    def test_missing_values_stay_missing(self):
        modifier = askew(fields=("v_S", "q_NS"), rpy_deg=self.ANGLES)
        missing = [(None,) * field.size for field in FIELDS]
        assert changed(modifier, *missing, valid=False).values == missing

    def test_angles_are_drawn_once_with_sigma(self):
        """Small angles: a vector along z comes out as (-pitch, roll), one along x as (., -yaw)."""
        drawn = []
        for seed in range(600):
            modifier = askew(seed, fields=("v_S",), sigma_deg=0.01)
            z = changed(modifier, (0.0, 0.0, 1.0), None, None, None).values[0]
            x = changed(modifier, (1.0, 0.0, 0.0), None, None, None).values[0]
            drawn.append((z[1], -z[0], -x[1]))
        for angle in np.array(drawn).T:
            assert_sigma(angle, math.radians(0.01))


@pytest.mark.parametrize("seed", SEEDS)
class TestOutlier:
    def test_how_often_and_how_far(self, bench, errors, seed):
        found = errors(bench(Outlier(field="x", probability=0.1, sigma=20.0), shape=(1,), seed=seed), 20_000)[:, 0]
        off = found[found != 0.0]
        assert stats.binomtest(off.size, found.size, 0.1).pvalue > RISK
        assert_sigma(off, 20.0)
        assert_correlation((found[:-1] != 0).astype(float), (found[1:] != 0).astype(float), 0.0)

    def test_one_sided(self, bench, errors, seed):
        modifier = bench(Outlier(field="x", probability=0.5, sigma=3.0, one_sided=True), shape=(1,), seed=seed)
        found = errors(modifier, 8000)[:, 0]
        assert found.min() == 0.0
        assert stats.kstest(found[found > 0.0] / 3.0, "halfnorm").pvalue > RISK

    def test_all_components_are_off_at_once(self, bench, errors, seed):
        found = errors(bench(Outlier(field="x", probability=0.3, sigma=1.0), seed=seed), 200) != 0.0
        assert {int(row.sum()) for row in found} == {0, 3}


class TestSaturate:
    def test_each_component_is_held(self, bench):
        modifier = bench(Saturate(field="x", minimum=-1.0, maximum=2.0))
        reading = changed(modifier, 7.0, (-1.5, 0.5, 2.5), True)
        assert (reading.values[1], reading.valid) == ((-1.0, 0.5, 2.0), True)
        assert changed(bench(Saturate(field="x", maximum=2.0)), 7.0, (-9.0, 2.0, 9.0), True).values[1] == (
            -9.0,
            2.0,
            2.0,
        )
        assert changed(bench(Saturate(field="before", minimum=8.0)), 7.0, (0.0,) * 3, True).values[0] == 8.0

    def test_what_was_held_may_be_invalid(self, bench):
        modifier = bench(Saturate(field="x", maximum=2.0, invalid=True))
        assert changed(modifier, 7.0, (1.0, None, 2.0), True).valid
        assert not changed(modifier, 7.0, (1.0, None, 2.1), True).valid

    @pytest.mark.parametrize(
        ("keys", "told"), [({}, "give minimum"), ({"minimum": 2.0, "maximum": 1.0}, "above maximum")]
    )
    def test_limits_that_make_no_sense_are_refused(self, keys, told):
        with pytest.raises(ValueError, match=told):
            Saturate(field="x", **keys)


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
    for number in range(n):
        reading = Measurement([0.0, (0.0,) * 3, True], True, number=number)
        modifier.apply(reading)
        found.append(reading.delay_ns)
    return np.array(found)


class TestDelay:
    def test_latency_is_exact_and_adds_up(self, bench):
        reading = Measurement([1.0, (2.0,) * 3, True], True, delay_ns=500)
        for latency in (0.02, 0.000_000_001):
            bench(Delay(latency_s=latency)).apply(reading)
        assert reading == Measurement([1.0, (2.0,) * 3, True], True, delay_ns=20_000_501)

    def test_without_jitter_all_are_late_alike(self, bench):
        assert set(delays(bench(Delay(latency_s=0.02)), 10)) == {20_000_000}

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
        readings = [Measurement([0.0, (0.0,) * 3, True], True, number=number) for number in range(n)]
        for reading in readings:
            modifier.apply(reading)
        return np.array([float(reading.dropped) for reading in readings])


class TestReorder:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_how_often(self, bench, seed):
        found = delays(bench(Reorder(probability=0.2, behind=3), dt=0.04, seed=seed), 10_000)
        assert set(found) == {0, 140_000_000}
        assert stats.binomtest(int(np.sum(found > 0)), found.size, 0.2).pvalue > RISK
        assert_correlation((found[:-1] > 0).astype(float), (found[1:] > 0).astype(float), 0.0)

    def test_exactly_so_many_overtake(self, bench):
        """If only the first is late, it comes behind the next three."""
        late = changed(bench(Reorder(probability=1.0, behind=3), dt=0.04), 0.0, (0.0,) * 3, True, t_ns=0).delay_ns
        assert sum(40_000_000 * k < late for k in range(1, 10)) == 3

    def test_a_device_of_its_own_pace(self, bench):
        modifier = bench(Reorder(probability=1.0), dt=0.01)
        found = [changed(modifier, 0.0, (0.0,) * 3, True, t_ns=t).delay_ns for t in (10_000_000, 210_000_000)]
        assert found == [15_000_000, 300_000_000]


class TestClockDrift:
    @staticmethod
    def stamps(modifier, n, dt_ns=100_000_000):
        readings = (changed(modifier, 0.0, (0.0,) * 3, True, t_ns=k * dt_ns, number=k - 1) for k in range(1, n + 1))
        return np.array([reading.stamp_ns for reading in readings])

    def test_offset_and_drift_in_closed_form(self, bench):
        found = self.stamps(bench(ClockDrift(offset_s=0.25, drift=2e-5), dt=0.1), 100)
        assert np.array_equal(found, 250_000_000 + 2000 * np.arange(1, 101))

    def test_delivery_and_values_stay(self, bench):
        reading = changed(bench(ClockDrift(offset_s=-1.0)), 7.0, (1.0,) * 3, True, t_ns=5)
        assert reading == Measurement([7.0, (1.0,) * 3, True], True, t_ns=5, stamp_ns=-1_000_000_000)

    def test_offset_and_drift_are_drawn_once(self, bench):
        drawn = []
        for seed in range(600):
            modifier = bench(ClockDrift(offset_sigma_s=0.5, drift_sigma=1e-4), dt=0.1, seed=seed)
            first, second = self.stamps(modifier, 2, 100_000_000_000) * 1e-9
            drawn.append((2 * first - second, (second - first) / 100.0))
        offset, drift = np.array(drawn).T
        assert_sigma(offset, 0.5)
        assert_sigma(drift, 1e-4)
        assert_correlation(offset, drift, 0.0)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_the_walk_grows_with_the_root_of_time(self, bench, seed):
        found = self.stamps(bench(ClockDrift(walk_sqrts=1e-3), dt=0.1, seed=seed), 8000) * 1e-9
        assert_sigma(np.diff(found), 1e-3 * math.sqrt(0.1))
