"""Ranges of single beams (compiled): beams formed of the few columns that they hear well, and the place of the bottom's echo in each."""

from __future__ import annotations

import math

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.sensors.acoustic.imaging.fan import Plane

_FAINT = 0.01
"""Amplitude below which a beam is taken to hear nothing: -40 dB."""
HEARD = 12
"""Columns that a beam with a Hamming taper hears: those in its main lobe. With other tapers there are more, but most of them are silent."""
_FIRST_HALF = 4.0
"""First half width of the window around the strongest gate, gates."""
_GROWTH = 2.5
"""Half width of the next window in standard deviations. An evenly filled window grows by 1.44; one around a main lobe keeps its size."""
_ROUNDS = 16
_LEAST_HALF = 1.5
NOTHING_FOUND, BY_AMPLITUDE, BY_PHASE = 0, 1, 2
"""Methods by which a range is found."""
_LEAST_GATES = 5
"""Least number of phases to fit a line to."""
_COARSE = 0.3
"""Error of a phase beyond the scatter that a few of them show, rad."""
_LEAST_PHASE_HALF = 8.0
"""First half width of the window in which phases are used, gates."""
_SURE = 0.25
"""Largest standard deviation of the phase at its zero, rad, with which the phase is surely better than the amplitude. The amplitude has an error of
0.4 rad of the ramp, even where it seems surer because speckle has left a single bright part of the echo."""
_FARTHEST = 4.0
"""The zero of the phase is searched within so many half lengths of the echo from its middle, as speckle may hide most of the echo."""
_RAMP = 1.0
"""Phases up to here, rad, are close to a line over range."""
_SETTLED = 0.01
"""Change of the zero at which the search ends, gates."""


def bands(pattern: Plane) -> IntArray:
    """Return (beams, 2) the first column that each beam hears and the one after the last: those of at least -40 dB, and all between them."""
    heard = np.abs(pattern) >= _FAINT
    first, last = heard.argmax(axis=1), pattern.shape[1] - heard[:, ::-1].argmax(axis=1)
    result: IntArray = np.stack((first, last), axis=1).astype(np.int64)
    return result


def phase_gates(place: FloatArray, half: FloatArray, bins: int) -> IntArray:
    """Return (beams, 2) the first gate whose phase is used and the one after the last; both are 0 without an echo.

    Args:
        place, half: (beams) as `find` writes them.
        bins: gates that count.
    """
    about, width = np.nan_to_num(place), _FARTHEST * np.maximum(half, _LEAST_PHASE_HALF)
    low, high = np.maximum(np.floor(about - width), 0.0), np.minimum(np.ceil(about + width), bins)
    result: IntArray = np.stack((low, high), axis=1).astype(np.int64)
    result[np.isnan(place)] = 0
    return result


@entry
def form_bands(pattern: Array, bands: Array, columns: Array, spans: Array, start: int, beams: Array) -> None:
    """Sum the columns that each beam hears.

    Args:
        pattern: (b, c) float32.
        bands: (b, 2) columns of each beam, as `bands` returns them.
        columns: (c, g) float32 sound of each column; silent gates before and behind its echoes are skipped.
        spans: (b, 2) the first gate that counts in each beam and the one after the last.
        start: the first gate of the result.
        beams: (b, n) float32 receives the sums; 0 in gates that do not count.
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
    """Find the place of each beam's echo: the centre of its energy, in a window that grows around the strongest gate until it holds the echo.

    Args:
        sound: (planes, beams, gates) float32: real and imaginary part, or one plane of intensities.
        bins: gates that count.
        least: least intensity of a gate that counts, uPa^2.
        loss: exponent of the loss of intensity by absorption, 1 per gate; the weights make up for it.
        first: take the first echo instead of the strongest.
        place: (beams) receives gates from the start; NaN for no echo.
        level: (beams) receives the mean intensity in the window, uPa^2.
        hits: (beams) receives the number of gates in it that count.
        half: (beams) receives its half width, gates.
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
    """Fit a line to the phases in a window, weighted by power.

    Args:
        power, phase: (n) of the gates from `first` on; power is 0 for gates that do not count.
        first: number of their first gate.
        about: origin of the places below, gates from the start.
        middle, half: middle of the window (gates from `about`) and its half width.

    Returns:
        Total power (0 if no line fits); place of the line's zero, gates from `about`; slope, rad per gate; and variance of the place, as the
        residuals of the phases show it.
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
    """Find where the phase between both halves of the array is zero: there the echo comes from the axis of the beam.

    In outer beams, whose echoes are long, this place is far more precise than the middle of the echo. It is used where the residuals of the phases
    say that it is better.

    Args:
        sound: (2, beams, gates) float32 of both halves together, real and imaginary part.
        apart: (2, beams, some gates) of their difference (`array.difference`), from gate `start` on.
        spans: (beams, 2) as `phase_gates` returns them.
        least: as for `find`.
        half, place: (beams) as `find` writes them; places where the phase is used are changed.
        method: (beams) uint8 receives NOTHING_FOUND, BY_AMPLITUDE or BY_PHASE.
    """
    power, phase = np.empty(sound.shape[2]), np.empty(sound.shape[2])
    for b in range(len(place)):
        method[b] = NOTHING_FOUND
        if math.isnan(place[b]):
            continue
        method[b] = BY_AMPLITUDE
        about, width = place[b], max(half[b], _LEAST_PHASE_HALF)
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
