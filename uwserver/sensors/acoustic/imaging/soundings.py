"""Ranges of single beams (compiled): beams of the few columns that they hear well, and where in each the echo of a bottom stands."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.deferred import compiled, entry
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
NOTHING_FOUND, BY_AMPLITUDE, BY_PHASE = 0, 1, 2
"""How a range was found."""
_LEAST_GATES = 5
"""Through so few phases no line is laid."""
_COARSE = 0.3
"""rad: what a phase may be wrong besides what few of them show."""
_LEAST_LOOK = 8.0
"""Gates to both sides of the middle of an echo, in which phases are looked at first."""
_SURE = 0.25
"""rad: a phase that is as sure at its zero tells more than an amplitude, whose error is 0.4 rad of the ramp, however sure that seems where speckle
has left one bright part of an echo."""
_FARTHEST = 4.0
"""Half lengths of an echo from its middle, within which the zero of the phase is looked for: speckle may hide the better part of it."""
_RAMP = 1.0
"""rad: phases up to there are as good as a line over range."""
_SETTLED = 0.01
"""Gates."""


def bands(pattern: Plane) -> IntArray:
    """(beams, 2) first column that each beam hears, and the one after the last: those of at least -40 dB, and all between."""
    heard = np.abs(pattern) >= _FAINT
    first, last = heard.argmax(axis=1), pattern.shape[1] - heard[:, ::-1].argmax(axis=1)
    result: IntArray = np.stack((first, last), axis=1).astype(np.int64)
    return result


def looks(place: FloatArray, half: FloatArray, bins: int) -> IntArray:
    """(beams, 2) first gate in which phases of an echo are looked at, and the one after the last: none where there is no echo.

    Args:
        place, half: (beams) of `find`.
        bins: gates that count.
    """
    about, width = np.nan_to_num(place), _FARTHEST * np.maximum(half, _LEAST_LOOK)
    low, high = np.maximum(np.floor(about - width), 0.0), np.minimum(np.ceil(about + width), bins)
    result: IntArray = np.stack((low, high), axis=1).astype(np.int64)
    result[np.isnan(place)] = 0
    return result


@entry
def form_bands(pattern: Array, bands: Array, columns: Array, spans: Array, start: int, beams: Array) -> None:
    """What the beams hear of their columns.

    Args:
        pattern: (b, c) float32.
        bands: (b, 2) of `bands`.
        columns: (c, g) float32 of each column; most gates of a bottom's echo are silent, and are passed over.
        spans: (b, 2) first gate that counts of each beam, and the one after the last.
        start: the first gate of the result.
        beams: (b, n) float32 receives the sums, 0 of gates that do not count.
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
        for k in range(len(out)):
            out[k] = np.float32(0.0)
        for m in range(bands[b, 0], bands[b, 1]):
            factor, line = pattern[b, m], columns[m]
            first, end = max(extent[m, 0], spans[b, 0]), min(extent[m, 1], spans[b, 1])
            for k in range(end - first):
                out[first - start + k] += factor * line[first + k]


@entry
def find(
    sound: Array, bins: int, least: float, loss: float, first: bool, place: Array, level: Array, hits: Array, half: Array
) -> None:  # fmt: skip
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
        half: (beams) gates from its middle to its ends.
    """
    planes, beams, _ = sound.shape
    power = np.empty(bins)
    for b in range(beams):
        place[b], level[b], hits[b], half[b] = math.nan, 0.0, 0, 0.0
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
        middle, width, before = at + 0.5, _FIRST_HALF, (-1, -1)
        for _ in range(_ROUNDS):
            low, high = max(int(middle - width), 0), min(math.ceil(middle + width), bins)
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
            middle, width = middle + shift, max(_GROWTH * deviation, _LEAST_HALF)
            half[b] = width


@compiled
def _ramp(
    power: Array, phase: Array, first: int, about: float, middle: float, half: float
) -> tuple[float, float, float, float]:
    """The line through the phases of a window, weighted by power: all its power (0 where there is no line), where it is zero (gates from `about`),
    its slope (rad per gate) and the variance of that place, told by what the phases leave of the line.

    Args:
        power, phase: (n) of the gates from `first` on; power 0 of those that do not count.
        first: number of their first gate.
        about: gates from the start.
        middle, half: of the window, gates from `about`.
    """
    count, total, moment, tilt = 0, 0.0, 0.0, 0.0
    for k in range(len(power)):
        x = first + k + 0.5 - about
        if power[k] > 0.0 and abs(x - middle) <= half and abs(phase[k]) < 0.5 * math.pi:
            count += 1
            total += power[k]
            moment += power[k] * x
            tilt += power[k] * phase[k]
    if count < _LEAST_GATES:
        return 0.0, 0.0, 0.0, 0.0
    centre, mean, square, product = moment / total, tilt / total, 0.0, 0.0
    for k in range(len(power)):
        x = first + k + 0.5 - about
        if power[k] > 0.0 and abs(x - middle) <= half and abs(phase[k]) < 0.5 * math.pi:
            square += power[k] * (x - centre) * (x - centre)
            product += power[k] * (x - centre) * (phase[k] - mean)
    if square == 0.0 or product == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    slope, left = product / square, 0.0
    for k in range(len(power)):
        x = first + k + 0.5 - about
        if power[k] > 0.0 and abs(x - middle) <= half and abs(phase[k]) < 0.5 * math.pi:
            off = power[k] * (phase[k] - mean - slope * (x - centre))
            left += off * off + power[k] * power[k] * _COARSE * _COARSE
    zero = centre - mean / slope
    lever = 1.0 + (zero - centre) * (zero - centre) * total / square
    return total, zero, slope, lever * left / (total * total * slope * slope)


@entry
def cross(
    sound: Array, apart: Array, spans: Array, start: int, least: float, half: Array, place: Array, method: Array
) -> None:
    """Where the phase between both halves of the array is zero: there the echo comes from the axis of the beam. In outer beams, whose echoes are
    long, that is told far better than the middle of the echo; it counts where what is left of the phases says so.

    Args:
        sound: (2, beams, gates) float32 of both halves together, real and imaginary part.
        apart: (2, beams, some gates) of their difference (`array.difference`), from the gate `start` on.
        spans: (beams, 2) of `looks`.
        least: of `find`.
        half, place: (beams) as `find` leaves them; places where the phase counts are changed.
        method: (beams) uint8 receives NOTHING_FOUND, BY_AMPLITUDE or BY_PHASE.
    """
    power, phase = np.empty(sound.shape[2]), np.empty(sound.shape[2])
    for b in range(len(place)):
        method[b] = NOTHING_FOUND
        if math.isnan(place[b]):
            continue
        method[b] = BY_AMPLITUDE
        about, width = place[b], max(half[b], _LEAST_LOOK)
        low, high = spans[b, 0], spans[b, 1]
        total = amplitudes = 0.0
        for k in range(low, high):
            real, imaginary = float(sound[0, b, k]), float(sound[1, b, k])
            other, further = float(apart[0, b, k - start]), float(apart[1, b, k - start])
            both = real * real + imaginary * imaginary
            power[k - low] = both if both >= least else 0.0
            if power[k - low] == 0.0:
                continue
            quadrature = 2.0 * (real * other + imaginary * further)
            phase[k - low] = math.atan2(quadrature, both - other * other - further * further)
            x = k + 0.5 - about
            if abs(x) <= half[b]:
                total += both
                amplitudes += both * both * x * x
        zero, reach, found = 0.0, width, False
        for _ in range(_ROUNDS):
            strength, middle, slope, variance = _ramp(power[: high - low], phase[: high - low], low, about, zero, reach)
            if strength == 0.0 or abs(middle) > _FARTHEST * width:
                found = False
                break
            found = variance * total * total < amplitudes or variance * slope * slope < _SURE * _SURE
            if abs(middle - zero) < _SETTLED and found:
                zero = middle
                break
            zero, reach = middle, min(max(_RAMP / abs(slope), _LEAST_GATES), _FARTHEST * width)
        if found and low <= about + zero < high:
            place[b], method[b] = about + zero, BY_PHASE
