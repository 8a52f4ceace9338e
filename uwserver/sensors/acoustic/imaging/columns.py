"""A fan of columns over range, and the beams that an array makes of it (compiled): energies, speckle, beams, noise, counts.

The sound of all columns is kept in float32, as real and imaginary planes (2, columns, gates), so that a processor works on eight gates at a time.
Sums run in a fixed order and in one thread, and are not contracted, so they have the same bits on every machine.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.kernel.random import philox
from uwserver.physics.rays.raycast import NOTHING
from uwserver.sensors.acoustic.imaging.echoes import DECIBEL
from uwserver.sensors.acoustic.imaging.speckle import DIRECTIONS, HALF, LOW, SIZE, add_phasors
from uwserver.sensors.voices import add_bursts

_SPECKLE, _NOISE = np.uint64(3), np.uint64(4)
"""Second word of the counter; `speckle` has others."""
_MANTISSA = 12
_LEAST_INTENSITY = np.float32(1e-30)


def _logarithms() -> npt.NDArray[np.float32]:
    """Return 10 lg of 1 to 2, in the middle of each of 2^12 steps."""
    count = 1 << _MANTISSA
    return (10.0 * np.log10(1.0 + (np.arange(count) + 0.5) / count)).astype(np.float32)


LOGARITHMS = _logarithms()
_OCTAVE = 10.0 * math.log10(2.0)
_REST = 1e-12
"""Part of the largest sum of a column that rounding may leave where its echoes end."""


@entry
def energies(seconds: Array, shift: float, per_metre: float, alpha: float, out: Array) -> None:
    """Add the mean intensity of all echoes in each gate, uPa^2.

    Args:
        seconds: (columns, gates + 3) as `echoes.deposit` leaves it.
        shift, per_metre: as for `echoes.deposit`.
        alpha: absorption, dB/m.
        out: (columns, gates) to which the intensities are added; what lies behind the last gate is lost.
    """
    columns, gates = out.shape
    factor = np.empty(gates)
    for k in range(gates):
        r = (k + 0.5 + shift) / per_metre
        factor[k] = math.exp(-2.0 * DECIBEL * alpha * r) / (r * r * r * r * r)
    for m in range(columns):
        total = largest = 0.0
        for k in range(gates):
            if seconds[m, k] != 0.0:
                total += seconds[m, k]
                largest = max(largest, total)
                if total < _REST * largest:
                    total = 0.0  # so that later steps skip these gates
            if total > 0.0:
                out[m, k] += total * factor[k]


@entry
def volume(
    emitted: Array, distance: Array, bodies: Array, strength: float, shift: float, per_metre: float, alpha: float, out: Array
) -> None:  # fmt: skip
    """Add what the water itself scatters back, from those parts of each column in which no solid stands before the gate.

    Args:
        emitted: (rows columns) of CELL: two-way pattern times solid angle and level.
        distance, bodies: what each ray hits, as `Hits`.
        strength: backscatter of a cubic metre of water, 1/m, linear.
        shift, per_metre, alpha, out: as for `energies`.
    """
    columns, gates = out.shape
    free = np.zeros((columns, gates + 1))
    for i in range(len(emitted)):
        end = gates
        if bodies[i] != NOTHING:
            end = min(max(int(distance[i] * per_metre - shift), 0), gates)
        free[i % columns, end] += emitted[i]
    factor = np.empty(gates)
    for k in range(gates):
        r = (k + 0.5 + shift) / per_metre
        factor[k] = strength * math.exp(-2.0 * DECIBEL * alpha * r) / (r * r * per_metre)
    for m in range(columns):
        total = free[m, gates]
        for k in range(gates - 1, -1, -1):
            out[m, k] += total * factor[k]
            total += free[m, k]


@entry
def scatter(energy: Array, key: int, faded: Array, share: Array, phasors: Array, sound: Array) -> None:
    """Make the sound of each column: echoes with the phasors of the pose, which fade as it moves (`speckle.fading`).

    Args:
        energy: (columns, gates) mean intensity of the echoes, uPa^2.
        key: key of the sensor's random numbers.
        faded, share: as `speckle.fading` returns them.
        phasors: `speckle.PHASORS`.
        sound: (2, columns, gates) receives real and imaginary part, uPa.
    """
    k = np.uint64(key)
    low, high = k & LOW, k >> HALF
    columns, gates = energy.shape
    for m in range(columns):
        for first in range(0, gates, SIZE):
            end, turn = min(first + SIZE, gates), first // SIZE
            counter, way = np.uint64(m) << np.uint64(16) | np.uint64(turn), (turn + 7 * m) % DIRECTIONS
            real, imaginary, silent = sound[0, m, first:end], sound[1, m, first:end], True
            for i in range(end - first):
                real[i] = imaginary[i] = np.float32(0.0)
            for i in range(end - first):
                if energy[m, first + i] != 0.0:
                    silent = False
                    break
            if silent:
                continue
            turned = 0.5 * math.pi * share[way]
            for step in range(2):
                factor = math.sin(turned) if step else math.cos(turned)
                if factor > 0.0:
                    n = np.uint64(faded[way] + step)
                    words = philox(counter, _SPECKLE, n & LOW, n >> HALF, low, high)
                    add_phasors(words, np.float32(factor), phasors, real, imaginary)
            for i in range(end - first):
                amplitude = np.float32(math.sqrt(energy[m, first + i]))
                real[i] *= amplitude
                imaginary[i] *= amplitude


@entry
def form_beams(pattern: Array, columns: Array, beams: Array) -> None:
    """Sum the columns that each beam hears.

    Args:
        pattern: (b, c) float32 amplitude or power of each column in each beam; c is a multiple of four.
        columns: (c, n) float32 of each column.
        beams: (b, n) float32 receives the sums.
    """
    count, n = beams.shape
    for b in range(count):
        out = beams[b]
        for k in range(n):
            out[k] = np.float32(0.0)
        for m in range(0, len(columns), 4):
            p0, p1, p2, p3 = pattern[b, m], pattern[b, m + 1], pattern[b, m + 2], pattern[b, m + 3]
            for k in range(n):
                out[k] += (p0 * columns[m, k] + p1 * columns[m + 1, k]) + (
                    p2 * columns[m + 2, k] + p3 * columns[m + 3, k]
                )


@compiled
def add_noise(key: int, number: int, noise: float, phasors: Array, sound: Array) -> None:
    """Add a receiver's noise to each beam.

    Args:
        key: key of the sensor's random numbers.
        number: number of the ping, drawn.
        noise: mean intensity in a gate, uPa^2.
        phasors: `speckle.PHASORS`.
        sound: (2, beams, gates).
    """
    k, n, root = np.uint64(key), np.uint64(number), np.float32(math.sqrt(noise))
    low, high = k & LOW, k >> HALF
    _, beams, gates = sound.shape
    for b in range(beams):
        for first in range(0, gates, SIZE):
            end = min(first + SIZE, gates)
            counter = np.uint64(b) << np.uint64(16) | np.uint64(first // SIZE)
            words = philox(counter, _NOISE, n & LOW, n >> HALF, low, high)
            add_phasors(words, root, phasors, sound[0, b, first:end], sound[1, b, first:end])


@compiled
def lengthen(sound: Array, core: int, rest: float, work: Array) -> None:
    """Lengthen the pulse to several gates: each sample becomes the sum of those around it.

    Args:
        sound: (planes, beams, gates), in place.
        core, rest: number of whole samples, and factor of one more sample at each end.
        work: (gates) work space.
    """
    part = np.float32(rest)
    planes, beams, gates = sound.shape
    before = core // 2
    for p in range(planes):
        for b in range(beams):
            line = sound[p, b]
            for k in range(gates):
                work[k] = line[k]
            for k in range(gates):
                first = k - before
                total = np.float32(0.0)
                for j in range(max(first, 0), min(first + core, gates)):
                    total += work[j]
                if first >= 1:
                    total += part * work[first - 1]
                if first + core < gates:
                    total += part * work[first + core]
                line[k] = total


@entry
def receive(
    noise: float, bursts: Array, key: int, number: int, window: float, phasors: Array, sound: Array
) -> None:  # fmt: skip
    """Add noise and the pings of other sonars to the sound that the beams hear, and lengthen the pulse to its resolution; all in place.

    Args:
        noise: mean intensity in a gate, uPa^2.
        bursts: (n, 4) pings of other sonars, see `sensors.voices`.
        key, number: those of the sensor's random numbers, and of the ping.
        window: gates in the resolution of the pulse.
        phasors: `speckle.PHASORS`.
        sound: (2, beams, gates) real and imaginary part, uPa; or (1, beams, gates) mean intensity, uPa^2, which gets neither noise nor pings.
    """
    is_mean = len(sound) == 1
    if not is_mean:
        add_noise(key, number, noise, phasors, sound)
        add_bursts(bursts, key, number, window, sound)
    if window > 1.0:
        rest = 0.5 * (window - int(window))
        work = np.empty(sound.shape[2], np.float32)
        lengthen(sound, int(window), rest if is_mean else math.sqrt(rest), work)


@entry
def intensities(sound: Array, gain: Array, out: Array) -> None:
    """Find the intensity of each bin and beam.

    Args:
        sound: (2, beams, gates >= bins) real and imaginary part, uPa.
        gain: (beams) gain of each beam's channel, by intensity.
        out: (bins, beams) float32 receives intensities, uPa^2.
    """
    bins, beams = out.shape
    for b in range(beams):
        g = gain[b]
        for k in range(bins):
            real, imaginary = sound[0, b, k], sound[1, b, k]
            out[k, b] = g * (real * real + imaginary * imaginary)


@entry
def counts(intensity: Array, level: Array, steps: float, logarithms: Array, out: Array) -> None:
    """Make 8-bit counts on a logarithmic scale.

    Args:
        intensity: (bins, beams) float32, uPa^2.
        level: (bins) what is added to the level, dB: time-varied gain and constants.
        steps: counts per dB.
        logarithms: LOGARITHMS.
        out: (bins, beams) uint8 receives them.
    """
    bins, beams = intensity.shape
    bits = intensity.view(np.int32)
    for k in range(bins):
        offset = np.float32(level[k] * steps)
        factor, octave = np.float32(steps), np.float32(_OCTAVE)
        for b in range(beams):
            if intensity[k, b] < _LEAST_INTENSITY:
                out[k, b] = 0
                continue
            # 10 lg from the bits of a float32: the exponent counts octaves, and the first bits of the mantissa look up the rest.
            word = bits[k, b]
            decibels = octave * np.float32((word >> 23) - 127) + logarithms[(word & 0x7FFFFF) >> (23 - _MANTISSA)]
            value = factor * decibels + offset + np.float32(0.5)
            out[k, b] = np.uint8(min(max(value, np.float32(0.0)), np.float32(255.0)))
