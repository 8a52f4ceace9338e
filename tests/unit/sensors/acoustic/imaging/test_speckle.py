"""Speckle and bins: Rayleigh amplitudes, correlated below the resolution, frozen in a pose; peaks; counts of a logarithmic scale."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.sensors.acoustic.imaging.speckle import (
    DIRECTIONS,
    PHASORS,
    compress,
    detect,
    detect_mean,
    fading,
    scatter,
)

COUNT = 40_000
EVEN = np.ones(COUNT)
STILL = np.zeros(DIRECTIONS, np.int64), np.zeros(DIRECTIONS)
AXIS = np.array([1.0, 0.0, 0.0])


def field(
    energy: FloatArray = EVEN, key: int = 1, number: int = 0, noise: float = 0.0, pose: Any = STILL
) -> FloatArray:
    out = np.empty((len(energy), 2))
    scatter(energy, np.uint64(key), number, noise, *pose, PHASORS, out)
    return out


def samples(made: FloatArray, window: int) -> FloatArray:
    """Complex output of the matched filter, one sample a gate."""
    return np.convolve(made[:, 0] + 1j * made[:, 1], np.ones(window), "valid")


def seen(p: tuple[float, float, float] = (0.0, 0.0, 0.0), turn: float = 0.0, window: int = 2) -> FloatArray:
    """Intensities of even ground from a pose; lengths and angles in units of what leaves a correlation of 1 / e."""
    axis = np.array([math.cos(0.1 * turn), math.sin(0.1 * turn), 0.0])
    made = samples(field(pose=fading(p, axis, 1.0, 0.1)), window)
    return np.abs(made[::window]) ** 2


# -- speckle --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", [2, 5])
@pytest.mark.parametrize("pose", [STILL, fading((3.3, -1.7, 9.1), AXIS, 0.02, 0.04)])
def test_amplitudes_are_rayleigh(window: int, pose: Any) -> None:
    """Mean of the intensity as given, contrast 1, and the distribution, over samples that share no gate."""
    intensity = np.abs(samples(field(pose=pose), window)[::window]) ** 2 / window
    assert intensity.mean() == pytest.approx(1.0, abs=0.03)
    assert intensity.std() / intensity.mean() == pytest.approx(1.0, abs=0.03)
    assert stats.kstest(np.sqrt(intensity), stats.rayleigh(scale=math.sqrt(0.5)).cdf).pvalue > 0.01


@pytest.mark.parametrize("window", [2, 4])
def test_samples_are_correlated_below_the_resolution_and_not_beyond(window: int) -> None:
    """The field falls linearly with the part of the pulse that two samples share: intensity with its square."""
    z = samples(field(), window)
    for apart in range(2 * window):
        shared = max(0.0, 1.0 - apart / window)
        found = abs(np.vdot(z[: len(z) - apart], z[apart:])) / np.vdot(z, z).real
        assert found == pytest.approx(shared, abs=0.03)


def test_speckle_is_frozen_in_a_pose_and_noise_is_not() -> None:
    pose = fading((1.0, 2.0, 3.0), AXIS, 0.02, 0.04)
    assert np.array_equal(field(number=1, pose=pose), field(number=2, pose=pose))
    first, second = field(np.zeros(COUNT), number=1, noise=1.0), field(np.zeros(COUNT), number=2, noise=1.0)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02
    assert (first**2).sum(axis=1).mean() == pytest.approx(1.0, abs=0.03)


def test_motion_ages_it() -> None:
    """Intensities of a pose keep more than 0.9 of their correlation over a tenth of the unit, lose more than half over one, and nearly all over
    ten; on the way back they return."""
    first = seen()
    for move in (lambda u: seen((u, 0.0, 0.0)), lambda u: seen((0.0, 0.6 * u, -0.8 * u)), lambda u: seen(turn=u)):
        near, unit, far = (np.corrcoef(first, move(u))[0, 1] for u in (0.1, 1.0, 10.0))
        assert near > 0.9
        assert 0.1 < unit < 0.5
        assert abs(far) < 0.15
        assert np.array_equal(move(0.0), first)


def test_it_is_a_number_of_the_sensor_alone() -> None:
    assert np.array_equal(field(key=5), field(key=5))
    assert abs(np.corrcoef(field(key=5).ravel(), field(key=6).ravel())[0, 1]) < 0.02
    # One gate does not ask how many there are, nor how strong the others.
    strong = EVEN.copy()
    strong[8:] = 100.0
    assert np.array_equal(field(strong)[:8], field()[:8])
    assert np.array_equal(field(EVEN[:100]), field()[:100])


# -- bins -----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [0.0, 0.3, 0.5, 0.999])
@pytest.mark.parametrize(("window", "per_bin"), [(2.0, 1), (2.3, 1), (2.9, 10), (5.5, 1)])
def test_what_is_thin_keeps_its_level_in_bins_of_any_length(window: float, per_bin: int, place: float) -> None:
    """Wherever it stands between two gates."""
    energy = np.zeros(400)
    energy[200:202] = 1.0 - place, place
    bins = np.empty(380 // per_bin)
    detect_mean(energy, window, per_bin, bins)
    assert bins.max() == pytest.approx(1.0)
    assert int(bins.argmax()) == pytest.approx((200.5 + place) / per_bin, abs=1 + window / per_bin)


def test_even_ground_has_the_energy_of_a_pulse_in_every_bin() -> None:
    for window, per_bin in ((2.0, 1), (2.6, 4), (7.1, 1)):
        bins = np.empty(300 // per_bin)
        detect_mean(np.full(400, 0.5), window, per_bin, bins)
        assert bins[8:] == pytest.approx(0.5 * window)


def test_a_bin_is_the_peak_of_its_samples() -> None:
    made, found = field(EVEN[:1000]), np.empty((90, 2))
    detect(made, 2.0, 10, found)
    bins = np.square(found).sum(axis=1)
    # The sample of gates k - 1 and k has its middle between them.
    intensity = np.abs(np.concatenate([[0.0], samples(made, 2)])) ** 2
    assert bins[1:] == pytest.approx([intensity[10 * k : 10 * k + 10].max() for k in range(1, 90)])
    # Its phase is that of the sample.
    sums = np.concatenate([[0.0], samples(made, 2)])
    peaks = [10 * k + int(intensity[10 * k : 10 * k + 10].argmax()) for k in range(1, 90)]
    assert found[1:, 0] + 1j * found[1:, 1] == pytest.approx(sums[peaks])


def test_a_pulse_of_no_whole_number_of_gates_brings_its_energy() -> None:
    """Speckle over many samples, against the mean of the same ground."""
    for window in (2.5, 3.9):
        found, mean = np.empty((COUNT - 10, 2)), np.empty(COUNT - 10)
        detect(field(), window, 1, found)
        detect_mean(EVEN, window, 1, mean)
        assert np.square(found).sum(axis=1).mean() == pytest.approx(mean[10:].mean(), rel=0.03)


# -- counts ---------------------------------------------------------------------------------------------------------------------------


def counts_of(level_db: Any, **changes: float) -> list[int]:
    """Counts of levels in dB, of bins 1 m long without any gain unless it is given; 2 counts a dB."""
    numbers = {
        "spacing": 1.0,
        "spreading": 0.0,
        "alpha": 0.0,
        "limit": 200.0,
        "offset": 0.0,
        "steps": 2.0,
        "full": 255.0,
    } | changes
    levels = 10.0 ** (0.1 * np.array(level_db, float))
    out = np.empty(len(levels), np.int64)
    compress(levels, *numbers.values(), out)
    return out.tolist()


def test_counts_are_steps_a_decibel_between_nothing_and_full() -> None:
    assert counts_of([-10.0, 0.0, 10.0, 50.2, 500.0]) == [0, 0, 20, 100, 255]
    assert counts_of([-10.0, 0.0, 10.0], offset=15.0) == [10, 30, 50]


def test_silence_is_no_error() -> None:
    out = np.empty(2, np.int64)
    compress(np.zeros(2), 1.0, 30.0, 0.1, 60.0, 100.0, 1.0, 255.0, out)
    assert out.tolist() == [0, 0]


def test_gain_makes_up_for_spreading_and_absorption_up_to_its_limit() -> None:
    r = np.arange(100) + 0.5
    levels = 100.0 - 30.0 * np.log10(r) - 2.0 * 0.2 * r
    assert set(counts_of(levels, spreading=30.0, alpha=0.2)) == {200}
    limited = counts_of(levels, spreading=30.0, alpha=0.2, limit=40.0)
    assert limited[0] == 200
    assert limited[-1] < 150
