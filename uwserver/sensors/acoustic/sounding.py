"""Sounding: from the echoes of narrow beams to ranges, with amplitude and quality."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.sensors.acoustic.cross_talk import add_bursts
from uwserver.sensors.acoustic.imaging import columns, soundings, speckle
from uwserver.sensors.acoustic.imaging.swath import Plane
from uwserver.sensors.acoustic.receiver import Noise, Ranges

_DECIBEL = 0.1 * math.log(10.0)


class Soundings(NamedTuple):
    """What was found in each beam.

    Attributes:
        place: gates from the start, NaN where there is no echo.
        level: mean intensity in the echo, uPa^2.
        hits: gates in it that are above the threshold.
        quality: part of the echo that is no noise, 0 to 1.
    """

    place: FloatArray
    level: FloatArray
    hits: IntArray
    quality: FloatArray


class Array(NamedTuple):
    """How beams hear columns.

    Attributes:
        pattern, power: (beams, columns) amplitude and power.
        bands: of `soundings.bands`.
    """

    pattern: Plane
    power: Plane
    bands: IntArray


def listen(energy: FloatArray, ranges: Ranges, noise: Noise | None, directivity: float, array: Array | None) -> Plane:
    """What narrow beams hear, without their far side lobes.

    Args:
        energy: (columns, gates) mean intensity of the echoes, uPa^2.
        ranges: of the ping.
        noise: None for the mean, without speckle.
        directivity: of a receiver, as a ratio.
        array: None where each column is a beam.

    Returns:
        (2, beams, gates) real and imaginary part, uPa; without noise (1, beams, gates) intensity, uPa^2.
    """
    if noise is None:
        heard = energy.astype(np.float32)[None]
    else:
        heard = np.empty((2, *energy.shape), np.float32)
        columns.scatter(energy, np.uint64(noise.key), noise.faded, noise.share, speckle.PHASORS, heard)
    if array is not None:
        sound = np.empty((len(heard), len(array.bands), energy.shape[1]), np.float32)
        for plane, wave in enumerate(heard):
            soundings.form_bands(array.power if noise is None else array.pattern, array.bands, wave, sound[plane])
        heard = sound
    if noise is not None:
        inside = ranges.noise / directivity
        columns.add_noise(np.uint64(noise.key), np.uint64(noise.number), inside, speckle.PHASORS, heard)
        add_bursts(noise.bursts, noise.key, noise.number, ranges.gates.window, heard)
    window = ranges.gates.window
    if window > 1.0:
        rest = 0.5 * (window - int(window))
        work = np.empty(energy.shape[1], np.float32)
        columns.lengthen(heard, int(window), rest if noise is None else math.sqrt(rest), work)
    return heard


def blanked(sound: Plane, least: float, gate: float) -> None:
    """Silence what comes from nearer than a device listens: `least` (m), of gates of so many metres."""
    sound[:, :, : math.ceil(least / gate - 0.5)] = 0.0


def sound_out(
    sound: Plane, bins: int, ranges: Ranges, directivity: float, alpha: float, threshold_db: float, first: bool = False
) -> Soundings:  # fmt: skip
    """Find the echo of each beam.

    Args:
        sound: of `listen`.
        bins: gates that count.
        ranges, directivity: of the ping.
        alpha: absorption, dB/m, for which weights make up: far parts of an echo are not less.
        threshold_db: above the mean noise, for a gate to count.
        first: whether the first echo counts, not the strongest.
    """
    beams = sound.shape[1]
    around = max(ranges.noise * ranges.gates.window / directivity, 1e-300)
    place, level, hits = np.empty(beams), np.empty(beams), np.empty(beams, np.int64)
    least, loss = around * 10.0 ** (0.1 * threshold_db), 2.0 * _DECIBEL * alpha / ranges.gates.per_metre
    soundings.find(sound, bins, least, loss, first, place, level, hits)
    quality: FloatArray = np.where(hits > 0, level / (level + around), 0.0)
    return Soundings(place, level, hits, quality)
