"""Ranges of single beams (compiled): beams of the few columns that they hear well, and where in each the echo of a bottom stands."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import Array, IntArray
from uwserver.physics.kernel.deferred import entry
from uwserver.sensors.acoustic.imaging.swath import Plane

_FAINT = 0.01
"""Amplitude below which a beam is taken to hear nothing: -40 dB."""
HEARD = 12
"""Columns that a beam hears, of a Hamming taper: those of its main lobe. Other tapers have more, whose echoes there are mostly silent."""
_FIRST_HALF = 4.0
"""Gates to both sides of the strongest one, in which an echo is looked for first."""
_GROWTH = 2.5
"""Standard deviations that a window is wide to both sides: one that is filled evenly grows by 1.44, and a beam's main lobe fits into its own."""
_ROUNDS = 16
_LEAST_HALF = 1.5


def bands(pattern: Plane) -> IntArray:
    """(beams, 2) first column that each beam hears, and the one after the last: those of at least -40 dB, and all between."""
    heard = np.abs(pattern) >= _FAINT
    first, last = heard.argmax(axis=1), pattern.shape[1] - heard[:, ::-1].argmax(axis=1)
    result: IntArray = np.stack((first, last), axis=1).astype(np.int64)
    return result


@entry
def form_bands(pattern: Array, bands: Array, columns: Array, beams: Array) -> None:
    """What the beams hear of their columns.

    Args:
        pattern: (b, c) float32.
        bands: (b, 2) of `bands`.
        columns: (c, n) float32 of each column; most gates of a bottom's echo are silent, and are passed over.
        beams: (b, n) float32 receives the sums.
    """
    count, n = columns.shape
    extent = np.empty((count, 2), np.int64)
    for m in range(count):
        low, high = 0, n
        while low < n and columns[m, low] == 0.0:
            low += 1
        while high > low and columns[m, high - 1] == 0.0:
            high -= 1
        extent[m, 0], extent[m, 1] = low, high
    for b in range(len(beams)):
        out = beams[b]
        for k in range(n):
            out[k] = np.float32(0.0)
        for m in range(bands[b, 0], bands[b, 1]):
            factor, line = pattern[b, m], columns[m]
            for k in range(extent[m, 0], extent[m, 1]):
                out[k] += factor * line[k]


@entry
def find(
    sound: Array, bins: int, least: float, loss: float, first: bool, place: Array, level: Array, hits: Array
) -> None:
    """Where the echo of each beam stands: the centre of its energy, in a window that grows about its strongest gate until it holds the echo.

    Args:
        sound: (planes, beams, gates) float32: real and imaginary part, or one plane of intensities.
        bins: gates that count.
        least: intensity of a gate that counts, uPa^2.
        loss: of intensity from gate to gate by absorption, 1 per gate (as of exp), for which the weights make up.
        first: whether the first echo counts, not the strongest.
        place: (beams) receives gates from the start, NaN for none.
        level: (beams) mean intensity in the window.
        hits: (beams) number of gates in it that count.
    """
    planes, beams, _ = sound.shape
    power = np.empty(bins)
    for b in range(beams):
        place[b], level[b], hits[b] = math.nan, 0.0, 0
        peak, at = 0.0, -1
        for k in range(bins):
            value = float(sound[0, b, k])
            if planes == 2:
                value = value * value + float(sound[1, b, k]) * float(sound[1, b, k])
            power[k] = value if value >= least else 0.0
        for k in range(bins):
            if power[k] > peak:
                peak, at = power[k], k
            elif first and at >= 0 and k > at + _FIRST_HALF:
                break
        if at < 0:
            continue
        middle, half, before = at + 0.5, _FIRST_HALF, (-1, -1)
        for _ in range(_ROUNDS):
            low, high = max(int(middle - half), 0), min(math.ceil(middle + half), bins)
            if (low, high) == before:  # the same window has the same centre
                break
            before = low, high
            total = moment = square = energy = 0.0
            count = 0
            for k in range(low, high):
                if power[k] > 0.0:
                    spread, away = (k + 0.5) / (at + 0.5), k + 0.5 - middle
                    weight = power[k] * math.exp(loss * (k - at)) * spread * spread
                    total += weight
                    moment += weight * away
                    square += weight * away * away
                    energy += power[k]
                    count += 1
            if count == 0:
                break
            shift = moment / total
            deviation = math.sqrt(max(square / total - shift * shift, 0.0))
            place[b], level[b], hits[b] = middle + shift, energy / (high - low), count
            middle, half = middle + shift, max(_GROWTH * deviation, _LEAST_HALF)
