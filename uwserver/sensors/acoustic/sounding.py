"""Sounding: from the echoes that narrow beams hear to ranges, with level and quality."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.sensors.acoustic.imaging import soundings
from uwserver.sensors.acoustic.imaging.echoes import DECIBEL
from uwserver.sensors.acoustic.imaging.swath import Plane
from uwserver.sensors.acoustic.receiver import Noise, Ranges, received, waves_of
from uwserver.sensors.voices import END, FIRST

_OTHER = 1 << 63
"""Bit that no number of a ping has: it tells the noise of the difference of both halves of the array from the noise of their sum."""

Methods = npt.NDArray[np.uint8]
Apart = Callable[[IntArray], tuple[Plane, int]]
"""Takes `spans` (beams, 2), the gates that count in each beam. Returns the difference of both halves of the array in these gates, (2, beams, some
gates), and the number of its first gate."""


class Soundings(NamedTuple):
    """What was found in each beam.

    Attributes:
        place: middle of the echo, gates from the start; NaN if there is no echo.
        level: mean intensity in the echo, uPa^2.
        hits: gates in it that are above the threshold.
        quality: part of the echo that is not noise, 0 to 1.
        method: uint8, how the place was found, see `soundings`.
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
        bands: as `soundings.bands` returns them.
        apart: (beams, columns) of `array.difference`; None for an array that does not compare its halves.
    """

    pattern: Plane
    power: Plane
    bands: IntArray
    apart: Plane | None = None


def listen(
    energy: FloatArray, ranges: Ranges, noise: Noise | None, directivity: float, array: Array
) -> tuple[Plane, Apart | None]:
    """Return what narrow beams hear, without their far side lobes, and the function that compares both halves of the array.

    Args:
        energy: (columns, gates) mean intensity of the echoes, uPa^2.
        ranges: of the ping.
        noise: None for the mean, without speckle.
        directivity: of a receiver, as a ratio.
        array: how the beams hear the columns.

    Returns:
        (2, beams, gates) real and imaginary part, uPa; without noise (1, beams, gates) intensity, uPa^2. And the function, None without noise or
        for an array that does not compare its halves.
    """
    waves, whole = waves_of(energy, noise), np.array(((0, energy.shape[1]),) * len(array.bands))
    together = _beams(waves, array.power if noise is None else array.pattern, array.bands, whole, 0, energy.shape[1])
    received(together, ranges, noise, directivity)
    if noise is None or array.apart is None:
        return together, None
    pattern, own = array.apart, noise

    def apart(spans: IntArray) -> tuple[Plane, int]:
        # As the pulse is several gates long, a gate hears those around it.
        more, seen = math.ceil(ranges.gates.window) + 1, spans[:, 1] > spans[:, 0]
        around = np.where(seen[:, None], np.clip(spans + np.array((-more, more)), 0, energy.shape[1]), 0)
        start, end = (int(around[seen, 0].min()), int(around[:, 1].max())) if seen.any() else (0, 0)
        heard = _beams(waves, pattern, array.bands, around, start, end)
        # The noise of both halves is independent, and therefore also the noise of their sum and of their difference.
        bursts = own.bursts.copy()
        bursts[:, [FIRST, END]] = np.maximum(bursts[:, [FIRST, END]] - start, 0.0)
        received(heard, ranges, own._replace(number=own.number | _OTHER, bursts=bursts), directivity)
        return heard, start

    return together, apart


def _beams(waves: Plane, pattern: Plane, bands: IntArray, spans: IntArray, start: int, end: int) -> Plane:
    """Return (planes, beams, end - start) sums of the columns in the spans (beams, 2) of gates; see `soundings.form_bands`."""
    sound = np.empty((len(waves), len(bands), end - start), np.float32)
    for plane, wave in enumerate(waves):
        soundings.form_bands(pattern, bands, wave, spans, start, sound[plane])
    return sound


def blanked(sound: Plane, least: float, gate: float) -> None:
    """Silence, in place, what comes from nearer than `least` (m); `gate`: length of a gate, m."""
    sound[:, :, : math.ceil(least / gate - 0.5)] = 0.0


def thresholds(ranges: Ranges, directivity: float, alpha: float, threshold_db: float) -> tuple[float, float, float]:
    """Return the levels against which echoes of a ping are measured. Arguments as of `sound_out`.

    Returns:
        Mean noise in a gate after the pulse has its full length, uPa^2; least intensity of an echo, uPa^2; and the exponent of the loss of
        intensity by absorption from gate to gate.
    """
    around = max(ranges.noise * ranges.gates.window / directivity, 1e-300)
    return around, around * 10.0 ** (0.1 * threshold_db), 2.0 * DECIBEL * alpha / ranges.gates.per_metre


def sound_out(
    sound: Plane, bins: int, ranges: Ranges, directivity: float, alpha: float, threshold_db: float, apart: Apart | None = None
) -> Soundings:  # fmt: skip
    """Find the echo of each beam.

    Args:
        sound: as `listen` returns it.
        bins: gates that count.
        ranges, directivity: of the ping.
        alpha: absorption, dB/m. Weights make up for it, so that the far part of an echo counts as much as the near part.
        threshold_db: level above the mean noise from which on a gate counts.
        apart: as `listen` returns it; without it phases are not used.
    """
    beams = sound.shape[1]
    around, least, loss = thresholds(ranges, directivity, alpha, threshold_db)
    place, level, hits, half = np.empty(beams), np.empty(beams), np.empty(beams, np.int64), np.empty(beams)
    soundings.find(sound, bins, least, loss, False, place, level, hits, half)
    method = np.where(hits > 0, soundings.BY_AMPLITUDE, soundings.NOTHING_FOUND).astype(np.uint8)
    if apart is not None:
        spans = soundings.phase_gates(place, half, bins)
        difference, start = apart(spans)
        soundings.cross(sound, difference, spans, start, least, half, place, method)
    quality: FloatArray = np.where(hits > 0, level / (level + around), 0.0)
    return Soundings(place, level, hits, quality, method)
