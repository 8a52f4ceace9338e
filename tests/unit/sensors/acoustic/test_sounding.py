"""From echoes to ranges: noise of a receiver, thresholds above it, quality."""

from __future__ import annotations

import numpy as np
import pytest

from uwserver.sensors.acoustic.imaging import speckle
from uwserver.sensors.acoustic.receiver import Array, Noise, Pulse, blanked, listen, ranges, sound_out

PULSE = Pulse(200.0, 1e-4, 3e4, 40.0)
RANGES = ranges(50.0, 500, 1500.0, 1.0, PULSE)
GATES = RANGES.gates.total


PLAIN = np.eye(64, dtype=np.float32)
EACH = Array(PLAIN, PLAIN, np.stack((np.arange(64), np.arange(1, 65)), axis=1))
"""64 beams, each of one column."""


def noise(number: int = 1) -> Noise:
    return Noise(7, number, *speckle.fading((0.0, 0.0, 0.0), np.array((1.0, 0.0, 0.0)), 1.0, 1.0))


def test_noise_is_that_of_the_band_and_the_beam() -> None:
    """Spectral level times bandwidth over directivity, in the resolution of the pulse."""
    heard = listen(np.zeros((64, GATES)), RANGES, noise(), 10.0, EACH)[0][:, :, 20:-20]
    # A bin of 0.1 m is coarser than the pulse: the receiver filters to 7.5 kHz.
    assert np.mean(heard[0] ** 2 + heard[1] ** 2) == pytest.approx(1e4 * 7.5e3 / 10.0, rel=0.05)


def test_noise_alone_is_hardly_ever_an_echo_and_an_echo_is_one() -> None:
    energy = np.zeros((64, GATES))
    energy[:32, 200:203] = 1e3 * RANGES.noise
    heard, _ = listen(energy, RANGES, noise(), 10.0, EACH)
    found = sound_out(heard, 500, RANGES, 10.0, 0.01, 14.0)
    assert found.place[:32] == pytest.approx(201.5, abs=2.0)
    assert found.quality[:32].min() > 0.9
    assert (found.hits[32:] > 0).sum() <= 1
    assert not found.quality[32:][found.hits[32:] == 0].any()


def test_without_noise_the_mean_is_heard_by_power() -> None:
    energy = np.zeros((4, GATES))
    energy[1, 100] = 8.0
    pattern = np.array([[0.0, 0.5, 0.0, 0.0]], np.float32)
    heard, _ = listen(energy, RANGES, None, 1.0, Array(pattern, pattern**2, np.array([[1, 2]])))
    assert heard.shape == (1, 1, GATES)
    assert heard.max() == pytest.approx(2.0)


def test_what_is_nearer_is_silenced_and_nothing_else() -> None:
    sound = np.ones((2, 3, 100), np.float32)
    blanked(sound, 1.0, 0.1)
    assert not sound[:, :, :10].any()
    assert sound[:, :, 10:].all()
    blanked(sound, 1e9, 0.1)
    assert not sound.any()


def test_sum_and_difference_have_the_same_noise_apart_and_the_same_echo() -> None:
    """The noise of both is as loud and independent; an echo off the axis stands in both with its pattern and its speckle."""
    pattern, apart, bands = (np.ones((40, 1), np.float32), np.full((40, 1), -0.5, np.float32), np.array([[0, 1]] * 40))
    energy = np.zeros((1, GATES))
    energy[0, 100:103] = 1e6 * RANGES.noise
    array = Array(pattern, pattern**2, bands, apart)
    both, difference = listen(energy, RANGES, noise(), 10.0, array)
    assert difference is not None
    other, start = difference(np.array([[0, GATES]] * 40))
    assert (start, other.shape) == (0, both.shape)
    assert np.array_equal(both, listen(energy, RANGES, noise(), 10.0, array)[0])
    quiet = slice(200, GATES - 20)
    powers = [np.mean(sound[0, :, quiet] ** 2 + sound[1, :, quiet] ** 2) for sound in (both, other)]
    assert powers == pytest.approx([1e4 * 7.5e3 / 10.0] * 2, rel=0.06)
    assert abs(np.mean(both[:, :, quiet] * other[:, :, quiet])) < 0.03 * powers[0]
    assert other[:, :, 101] == pytest.approx(
        -0.5 * both[:, :, 101], rel=0.05, abs=0.02 * float(np.abs(both[:, :, 101]).max())
    )
    assert listen(energy, RANGES, noise(), 10.0, array._replace(apart=None))[1] is None
    some, start = difference(np.array([[0, 0]] + [[90, 110]] * 39))
    assert start < 90 < 110 < start + some.shape[2] < start + 30
    echo = slice(101 - start, 102 - start)
    assert some[:, 1:, echo] == pytest.approx(other[:, 1:, 101:102], abs=0.02 * float(np.abs(both[:, :, 101]).max()))
    assert difference(np.zeros((40, 2), np.int64))[0].shape == (2, 40, 0)
