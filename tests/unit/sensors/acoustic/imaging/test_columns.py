"""Columns over range, and beams made of them: each kernel against what it says, in float64."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from uwserver.sensors.acoustic.imaging import columns, speckle

KEY = np.uint64(12345)
STILL = speckle.fading((0.0, 0.0, 0.0), np.array((1.0, 0.0, 0.0)), 1.0, 1.0)


def scattered(energy: np.ndarray, pose: float = 0.0, key: np.uint64 = KEY) -> np.ndarray:
    faded, share = speckle.fading((pose, 0.0, 0.0), np.array((1.0, 0.0, 0.0)), 1.0, 1.0)
    sound = np.empty((2, *energy.shape), np.float32)
    columns.scatter(energy, key, faded, share, speckle.PHASORS, sound)
    return sound[0] + 1j * sound[1].astype(np.float64)


def test_speckle_is_exponential_and_its_columns_do_not_know_each_other() -> None:
    waves = scattered(np.full((64, 512), 2.0))
    intensity = np.abs(waves) ** 2 / 2.0
    assert intensity.mean() == pytest.approx(1.0, abs=0.02)
    assert stats.kstest(intensity.ravel()[::7], "expon").pvalue > 0.01
    across = np.mean(waves[1:] * waves[:-1].conj()) / 2.0
    along = np.mean(waves[:, 32:] * waves[:, :-32].conj()) / 2.0
    assert max(abs(across), abs(along)) < 0.03


def test_speckle_stays_while_the_sonar_does_and_fades_as_it_moves() -> None:
    energy = np.ones((64, 512))
    here = scattered(energy)
    assert np.array_equal(here, scattered(energy))
    alike = [abs(np.mean(here * scattered(energy, moved).conj())) for moved in (0.1, 0.5, 1.0, 4.0)]
    assert alike[0] > 0.95
    assert alike[0] > alike[1] > alike[2]
    assert alike[2] == pytest.approx(np.exp(-1.0), abs=0.15)
    assert alike[3] < 0.2
    assert np.mean(np.abs(scattered(energy, 0.5)) ** 2) == pytest.approx(1.0, abs=0.03)


def test_silent_gates_stay_silent() -> None:
    energy = np.zeros((3, 100))
    energy[1, 40] = 4.0
    waves = scattered(energy)
    assert np.count_nonzero(waves) == 1
    assert waves[1, 40] != 0.0


def test_beams_are_the_products_and_the_same_to_the_bit_in_any_company() -> None:
    rng = np.random.default_rng(1)
    pattern, waves = rng.normal(size=(5, 8)).astype(np.float32), rng.normal(size=(8, 33)).astype(np.float32)
    beams = np.empty((5, 33), np.float32)
    columns.form_beams(pattern, waves, beams)
    assert np.allclose(beams, pattern.astype(float) @ waves.astype(float), atol=1e-5)
    alone = np.empty((1, 33), np.float32)
    columns.form_beams(pattern[3:4], waves, alone)
    assert np.array_equal(alone[0], beams[3])


def test_noise_is_of_the_ping_alone() -> None:
    def noise(number: int) -> np.ndarray:
        sound = np.zeros((2, 40, 300), np.float32)
        columns.add_noise(KEY, np.uint64(number), 3.0, speckle.PHASORS, sound)
        return sound[0] + 1j * sound[1]

    one = noise(1)
    assert np.mean(np.abs(one) ** 2) == pytest.approx(3.0, rel=0.03)
    assert np.array_equal(one, noise(1))
    assert abs(np.mean(one * noise(2).conj())) < 0.1


@pytest.mark.parametrize(("core", "rest"), [(1, 0.0), (1, 0.5), (4, 0.25)])
def test_a_long_pulse_sums_its_neighbours(core: int, rest: float) -> None:
    line = np.random.default_rng(2).normal(size=50).astype(np.float32)
    sound = line.reshape(1, 1, 50).copy()
    columns.lengthen(sound, core, rest, np.empty(50, np.float32))
    for k in (0, 10, 30, 49):
        first = k - core // 2
        wanted = sum(float(line[j]) for j in range(first, first + core) if 0 <= j < 50)
        wanted += sum(rest * float(line[j]) for j in (first - 1, first + core) if 0 <= j < 50)
        assert sound[0, 0, k] == pytest.approx(wanted, abs=1e-5)


def test_counts_are_the_level_within_a_hundredth_of_a_decibel() -> None:
    intensity = np.geomspace(1e-6, 1e12, 4000).astype(np.float32).reshape(1000, 4)
    level, out = np.linspace(0.0, 30.0, 1000), np.empty((1000, 4), np.uint8)
    columns.counts(intensity, level, 100.0, columns.LOGARITHMS, out)  # a count is a hundredth of a dB here
    exact = 100.0 * (10.0 * np.log10(intensity.astype(float)) + level[:, None])
    inside = (exact > 2.0) & (exact < 253.0)
    assert inside.sum() > 10
    assert np.abs(out - exact)[inside].max() < 1.0
    assert (out[exact < -1.0] == 0).all()
    assert (out[exact > 256.0] == 255).all()
    columns.counts(
        np.zeros((2, 2), np.float32), np.zeros(2), 1.0, columns.LOGARITHMS, small := np.ones((2, 2), np.uint8)
    )
    assert not small.any()


def test_intensities_lie_by_range_and_beam_after_the_gain_of_each() -> None:
    sound = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    out = np.empty((2, 3), np.float32)
    columns.intensities(sound, np.array([1.0, 2.0, 0.0], np.float32), out)
    assert np.allclose(out, ((sound**2).sum(axis=0).T * [1.0, 2.0, 0.0])[:2])


def test_water_scatters_as_far_as_nothing_is_in_the_way() -> None:
    out = np.zeros((2, 10))
    emitted, distance, bodies = (
        np.array([1.0, 1.0, 1.0, 1.0]),
        np.array([4.0, np.inf, np.inf, np.inf]),
        np.array([0, -1, -1, -1]),
    )
    columns.volume(emitted, distance, bodies, 1e-3, 0.0, 1.0, 0.0, out)
    r = np.arange(10) + 0.5
    assert np.allclose(out[1], 2e-3 / r**2)
    assert np.allclose(out[0], np.where(r < 4.0, 2e-3, 1e-3) / r**2)


def test_behind_the_echoes_of_a_column_nothing_is_left() -> None:
    """Sums of slopes that cancel leave a little of rounding, which is no echo; a faint echo behind it is one."""
    seconds = np.zeros((1, 103))
    for start, slope in ((3.3, 0.1), (3.7, 0.7), (4.1, 1e3 / 6.0)):
        for edge, sign in ((start, 1.0), (start + 2.6, -1.0)):
            seconds[0, int(edge)] += sign * slope * (1.0 - edge % 1.0)
            seconds[0, int(edge) + 1] += sign * slope * (edge % 1.0)
    assert seconds[0].cumsum()[50] > 0.0
    seconds[0, 60], seconds[0, 62] = 1e-6, -1e-6
    out = np.zeros((1, 100))
    columns.energies(seconds, 0.0, 1.0, 0.0, out)
    assert np.flatnonzero(out).tolist() == [3, 4, 5, 6, 60, 61]
    assert out[0, 60] == pytest.approx(1e-6 / 60.5**5, rel=1e-6)
