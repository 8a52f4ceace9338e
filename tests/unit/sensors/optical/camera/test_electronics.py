"""Electronics: the photon-transfer curve gives back what the chip was made with; noise, full well, gamma, metering."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.sensors.optical.camera import electronics
from uwserver.sensors.optical.camera.electronics import Chip

N = 200_000


def counts_of(electrons: float, gain: float = 0.35, read: float = 4.0, seed: int = 9, well: float = 1e9) -> np.ndarray:
    light = np.full((N, 3), electrons, np.float32)
    out = np.empty((N, 3), np.uint16)
    electronics.expose(light, np.ones(3), 0.0, well, read, gain, np.uint64(seed), electronics.normal_table(), out)
    return out.astype(np.float64)


def test_photon_transfer_gives_back_gain_and_read_noise_within_3_percent() -> None:
    """Variance over mean is a line: its slope is the gain (DN/e), its start the read noise (EMVA 1288, 6.6)."""
    gain, read = 0.35, 12.0
    levels = np.linspace(200.0, 9000.0, 12)
    stacks = [counts_of(e, gain, read, seed=int(e)) for e in levels]
    mean = np.array([s.mean() for s in stacks])
    variance = np.array([s.var() for s in stacks]) - 1.0 / 12.0  # of rounding to whole counts
    slope, start = np.polyfit(mean, variance, 1)
    assert slope == pytest.approx(gain, rel=0.03)
    # Of the mean 1/2 a count is that of rounding.
    dark = counts_of(400.0, gain, read, seed=77)
    found = (dark.var() - 1.0 / 12.0) / gain**2 - 400.0
    assert np.sqrt(found) == pytest.approx(read, rel=0.03)
    assert abs(start) < 120.0


def test_noise_is_white_over_pixels_and_colours() -> None:
    noise = counts_of(3000.0) - counts_of(3000.0).mean()
    scale = noise.var()
    assert abs((noise[1:, 0] * noise[:-1, 0]).mean()) < 0.01 * scale
    assert abs((noise[:, 0] * noise[:, 1]).mean()) < 0.01 * scale
    other = counts_of(3000.0, seed=10) - counts_of(3000.0).mean()
    assert abs((noise * other).mean()) < 0.01 * scale


def test_without_a_seed_there_is_no_noise_and_a_well_is_full() -> None:
    assert set(np.unique(counts_of(1000.0, seed=0))) == {350.0}
    assert counts_of(1000.0, seed=0, well=500.0).max() == 175.0
    assert counts_of(1e6, seed=0).max() == 4095.0


def test_mono_adds_the_colours() -> None:
    light, out = np.full((4, 3), 100.0, np.float32), np.empty(4, np.uint16)
    electronics.expose_mono(
        light, np.array((1.0, 2.0, 3.0)), 5.0, 1e9, 0.0, 1.0, np.uint64(0), electronics.normal_table(), out
    )
    assert out.tolist() == [605] * 4


def test_electrons_grow_with_time_and_area_and_fall_with_the_stop() -> None:
    chip = Chip(2.0, 2.0, (0.4, 0.5, 0.5), 1e4, 2.0, 0.0, 0.4)
    assert chip.electrons(0.02) == pytest.approx(2.0 * chip.electrons(0.01))
    assert chip._replace(pixel_um=4.0).electrons(0.01) == pytest.approx(4.0 * chip.electrons(0.01))
    assert chip._replace(f_number=4.0).electrons(0.01) == pytest.approx(0.25 * chip.electrons(0.01))
    # 100 lux/sr (a white card in 314 lux), 4.1e3 photons/(lux s um2), pi/16, 4 um2, 10 ms, QE 0.5
    assert chip.electrons(0.01)[1] * 100.0 == pytest.approx(4.1e3 * np.pi / 16.0 * 4.0 * 0.01 * 0.5 * 100.0)


def test_gamma_and_metering() -> None:
    table = electronics.gamma_table()
    assert (table[0], table[4095]) == (0, 255)
    assert table[round(0.2140 * 4095)] == pytest.approx(127, abs=1)  # sRGB of middle grey
    picture = np.zeros((80, 80, 3), np.uint8)
    picture[:, :, 1] = 188  # half of full scale
    assert electronics.metered(picture) == pytest.approx(0.5, abs=0.01)
    assert electronics.metered(picture[:, :, 1]) == pytest.approx(0.5, abs=0.01)
    out = np.empty((1, 3), np.uint8)
    electronics.develop(np.array([[4095, 1000, 100]], np.uint16), table, np.array((2.0, 1.0, 1.0)), out)
    assert out.tolist() == [[255, int(table[1000]), int(table[100])]]
