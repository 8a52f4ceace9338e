"""Sounding: from the echoes of narrow beams to ranges, with amplitude and quality."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.sensors.acoustic.imaging import columns, soundings, speckle
from uwserver.sensors.acoustic.imaging.swath import Plane
from uwserver.sensors.acoustic.receiver import Noise, Ranges, received
from uwserver.sensors.voices import END, FIRST

_OTHER = 1 << 63
"""Beside the numbers that are drawn for pings."""
_DECIBEL = 0.1 * math.log(10.0)


Methods = npt.NDArray[np.uint8]
Apart = Callable[[IntArray], tuple[Plane, int]]
"""The difference of both halves of an array, (2, beams, some gates), in `spans` of gates of each beam, (beams, 2); and the first of its gates."""


class Soundings(NamedTuple):
    """What was found in each beam.

    Attributes:
        place: gates from the start, NaN where there is no echo.
        level: mean intensity in the echo, uPa^2.
        hits: gates in it that are above the threshold.
        quality: part of the echo that is no noise, 0 to 1.
        method: uint8, of `soundings`: how the place was found.
    """

    place: FloatArray
    level: FloatArray
    hits: IntArray
    quality: FloatArray
    method: Methods


class Array(NamedTuple):
    """How beams hear columns.

    Attributes:
        pattern, power: (beams, columns) amplitude and power.
        bands: of `soundings.bands`.
        apart: (beams, columns) of `array.difference`; None of one that does not compare its halves.
    """

    pattern: Plane
    power: Plane
    bands: IntArray
    apart: Plane | None = None


def listen(energy: FloatArray, ranges: Ranges, noise: Noise | None, directivity: float, array: Array) -> Plane:
    """What narrow beams hear, without their far side lobes.

    Args:
        energy: (columns, gates) mean intensity of the echoes, uPa^2.
        ranges: of the ping.
        noise: None for the mean, without speckle.
        directivity: of a receiver, as a ratio.
        array: how the beams hear the columns.

    Returns:
        (2, beams, gates) real and imaginary part, uPa; without noise (1, beams, gates) intensity, uPa^2.
    """
    if noise is None:
        mean: Plane = energy.astype(np.float32)[None]
        heard = _beams(mean, array.power, array.bands)
        received(heard, ranges, None, directivity)
        return heard
    heard = _beams(_waves(energy, noise), array.pattern, array.bands)
    received(heard, ranges, noise, directivity)
    return heard


def listen_apart(
    energy: FloatArray, ranges: Ranges, noise: Noise, directivity: float, array: Array
) -> tuple[Plane, Apart | None]:
    """What narrow beams hear as of `listen`, and what makes the difference of both halves of the array, where it compares them."""
    waves = _waves(energy, noise)
    together = _beams(waves, array.pattern, array.bands)
    received(together, ranges, noise, directivity)
    if array.apart is None:
        return together, None
    pattern = array.apart

    def apart(spans: IntArray) -> tuple[Plane, int]:
        # A gate hears those about it, as long as the pulse is.
        more, seen = math.ceil(ranges.gates.window) + 1, spans[:, 1] > spans[:, 0]
        around = np.where(seen[:, None], np.clip(spans + np.array((-more, more)), 0, energy.shape[1]), 0)
        start, end = (int(around[seen, 0].min()), int(around[:, 1].max())) if seen.any() else (0, 0)
        heard = np.empty((2, len(spans), end - start), np.float32)
        for plane, wave in enumerate(waves):
            soundings.form_bands(pattern, array.bands, wave, around, start, heard[plane])
        # The noise of the halves is independent, and so is that of their sum and of their difference.
        bursts = noise.bursts.copy()
        bursts[:, [FIRST, END]] = np.maximum(bursts[:, [FIRST, END]] - start, 0.0)
        received(heard, ranges, noise._replace(number=noise.number | _OTHER, bursts=bursts), directivity)
        return heard, start

    return together, apart


def _waves(energy: FloatArray, noise: Noise) -> Plane:
    """(2, columns, gates) of each column with its speckle."""
    waves = np.empty((2, *energy.shape), np.float32)
    columns.scatter(energy, np.uint64(noise.key), noise.faded, noise.share, speckle.PHASORS, waves)
    return waves


def _beams(waves: Plane, pattern: Plane, bands: IntArray) -> Plane:
    sound = np.empty((len(waves), len(bands), waves.shape[2]), np.float32)
    whole = np.array(((0, waves.shape[2]),) * len(bands))
    for plane, wave in enumerate(waves):
        soundings.form_bands(pattern, bands, wave, whole, 0, sound[plane])
    return sound


def blanked(sound: Plane, least: float, gate: float) -> None:
    """Silence what comes from nearer than a device listens: `least` (m), of gates of so many metres."""
    sound[:, :, : math.ceil(least / gate - 0.5)] = 0.0


def thresholds(ranges: Ranges, directivity: float, alpha: float, threshold_db: float) -> tuple[float, float, float]:
    """Of a ping (see `sound_out`): mean noise in a gate, once the pulse is as long as it is, and what counts as an echo, uPa^2; and what of intensity
    is lost from gate to gate by absorption (as of exp)."""
    around = max(ranges.noise * ranges.gates.window / directivity, 1e-300)
    return around, around * 10.0 ** (0.1 * threshold_db), 2.0 * _DECIBEL * alpha / ranges.gates.per_metre


def sound_out(
    sound: Plane, bins: int, ranges: Ranges, directivity: float, alpha: float, threshold_db: float, apart: Apart | None = None
) -> Soundings:  # fmt: skip
    """Find the echo of each beam.

    Args:
        sound: of `listen`.
        bins: gates that count.
        ranges, directivity: of the ping.
        alpha: absorption, dB/m, for which weights make up: far parts of an echo are not less.
        threshold_db: above the mean noise, for a gate to count.
        apart: of `listen_apart`; without it phases tell nothing.
    """
    beams = sound.shape[1]
    around, least, loss = thresholds(ranges, directivity, alpha, threshold_db)
    place, level, hits, half = np.empty(beams), np.empty(beams), np.empty(beams, np.int64), np.empty(beams)
    soundings.find(sound, bins, least, loss, False, place, level, hits, half)
    method = np.where(hits > 0, soundings.BY_AMPLITUDE, soundings.NOTHING_FOUND).astype(np.uint8)
    if apart is not None:
        spans = soundings.looks(place, half, bins)
        difference, start = apart(spans)
        soundings.cross(sound, difference, spans, start, least, half, place, method)
    quality: FloatArray = np.where(hits > 0, level / (level + around), 0.0)
    return Soundings(place, level, hits, quality, method)
