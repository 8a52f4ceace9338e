"""Speckle and bins: what a receiver makes of the echoes in gates (compiled).

The scatterers of a gate have random phases: together they are one complex normal number, its phasor. The pulse sums the phasors of its gates, so
that amplitudes are Rayleigh and correlated below its resolution. Phasors are numbers of a counter, not of a memory: they depend on the sensor, the
gate and the pose alone, so that a sonar which does not move sees what it saw. Each block of gates looks along a direction of its own in the space
of poses, and as a pose moves along it by one unit, one set of phasors fades into the next.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.kernel.random import philox

BLOCK = 8
"""Gates whose phasors are made of one block of random words."""
DIRECTIONS = 64
"""In the space of poses, by turns."""
_SPECKLE, _NOISE = np.uint64(1), np.uint64(2)
"""Second word of the counter. That of all other numbers of a path is 0."""
_LOW, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
_EIGHT, _BYTE, _16 = np.uint64(8), np.uint64(0xFF), np.uint64(16)
_LEAST_INTENSITY = 1e-30
_PACE = 1.7
"""Units of fading along a random direction that leave a correlation of 1 / e after one unit of motion."""


def _amplitudes() -> FloatArray:
    """(256) amplitudes of a complex normal number: the means of equal parts of the exponential distribution of its intensity, whose mean is 1."""
    rest = 1.0 - np.arange(257) / 256.0
    above = np.zeros(257)
    above[:256] = rest[:256] * (1.0 - np.log(rest[:256]))
    result: FloatArray = np.sqrt(256.0 * -np.diff(above))
    return result


_AMPLITUDE = _amplitudes()
_TURN = np.exp(2j * np.pi * np.arange(256) / 256.0)
_COSINE, _SINE = _TURN.real.copy(), _TURN.imag.copy()


def _directions() -> FloatArray:
    """(DIRECTIONS, 7) random directions of the space of poses, times their pace, and an offset."""
    rng = np.random.Generator(np.random.Philox(key=7))
    result: FloatArray = np.concatenate(
        [_PACE * rng.standard_normal((DIRECTIONS, 6)), rng.random((DIRECTIONS, 1))], axis=1
    )
    return result


_DIRECTIONS = _directions()


def fading(p: Vec3, axis: FloatArray, length: float, angle: float) -> tuple[FloatArray, FloatArray]:
    """How far the phasors of a pose have faded from one set to the next.

    Args:
        p: of the transducer in N, m.
        axis: (3) of the beam, unit, in N.
        length: a motion (m) that leaves a correlation of 1 / e, half the aperture.
        angle: a turn of the beam (rad) that does, 0.8 beam widths.

    Returns:
        number of the set, (DIRECTIONS) whole, and the fraction of the way to the next, of each direction.
    """
    place = np.concatenate([np.array(p) / length, axis / angle, np.ones(1)])
    along = _DIRECTIONS @ place
    number = np.floor(along)
    return number.astype(np.int64), along - number


@compiled
def _phasor(word: np.uint64) -> tuple[float, float]:
    """A complex normal number of mean intensity 1, of the lowest 16 bits of a random word."""
    # An unsigned index needs no look whether it counts from the end.
    amplitude, turn = _AMPLITUDE[word & _BYTE], (word >> _EIGHT) & _BYTE
    return amplitude * _COSINE[turn], amplitude * _SINE[turn]


@compiled
def _add(words: tuple[np.uint64, np.uint64, np.uint64, np.uint64], factor: float, field: Array) -> None:
    """Add the phasors (BLOCK, 2) of four words, times a factor."""
    for j in range(4):
        word = words[j]
        a, b = _phasor(word)
        c, d = _phasor(word >> _16)
        field[2 * j, 0] += factor * a
        field[2 * j, 1] += factor * b
        field[2 * j + 1, 0] += factor * c
        field[2 * j + 1, 1] += factor * d


@entry
def scatter(energy: Array, key: int, number: int, noise: float, faded: Array, share: Array, field: Array) -> None:
    """The sound of each gate: echoes with the phasors of the pose, noise with those of the ping.

    Args:
        energy: (gates) mean intensity of the echoes, uPa^2.
        key: of the sensor's random numbers.
        number: of the ping.
        noise: mean intensity in a gate.
        faded, share: of `fading`.
        field: (gates, 2) receives real and imaginary part, uPa.
    """
    k, n = np.uint64(key), np.uint64(number)
    low, high = k & _LOW, k >> _HALF
    phasor, root = np.empty((BLOCK, 2)), math.sqrt(noise)
    for first in range(0, len(energy), BLOCK):
        count = min(BLOCK, len(energy) - first)
        block = first // BLOCK
        strongest = 0.0
        for i in range(count):
            strongest = max(strongest, energy[first + i])
        for i in range(BLOCK):
            phasor[i, 0] = phasor[i, 1] = 0.0
        if strongest > 0.0:
            way = block % DIRECTIONS
            turned = 0.5 * math.pi * share[way]
            for step in range(2):
                m = np.uint64(faded[way] + step)
                words = philox(np.uint64(block), _SPECKLE, m & _LOW, m >> _HALF, low, high)
                _add(words, math.sin(turned) if step else math.cos(turned), phasor)
            for i in range(count):
                amplitude = math.sqrt(energy[first + i])
                phasor[i, 0] *= amplitude
                phasor[i, 1] *= amplitude
        if root > 0.0:
            _add(philox(np.uint64(block), _NOISE, n & _LOW, n >> _HALF, low, high), root, phasor)
        for i in range(count):
            field[first + i, 0], field[first + i, 1] = phasor[i, 0], phasor[i, 1]


@entry
def detect(field: Array, window: float, per_bin: int, out: Array) -> None:
    """Bins of the matched filter's output: the peak of its samples in each, one a gate. The pulse sums the sound of as many gates as it is long.

    Args:
        field: (gates, 2) as of `scatter`.
        window, per_bin: of `Gates`.
        out: (bins) receives intensities, uPa^2.
    """
    core, last = int(window), len(field)
    # What is left of the window goes to both its ends, by energy.
    rest = math.sqrt(0.5 * (window - core))
    for k in range(len(out)):
        out[k] = 0.0
        for middle in range(k * per_bin, (k + 1) * per_bin):
            first = middle - core // 2
            real = imaginary = 0.0
            for j in range(max(first, 0), min(first + core, last)):
                real += field[j, 0]
                imaginary += field[j, 1]
            for j in (first - 1, first + core):
                if 0 <= j < last:
                    real += rest * field[j, 0]
                    imaginary += rest * field[j, 1]
            out[k] = max(out[k], real * real + imaginary * imaginary)


@entry
def detect_mean(energy: Array, window: float, per_bin: int, out: Array) -> None:
    """The same of mean intensities (gates), which the pulse sums as they are: without speckle."""
    core, last = int(window), len(energy)
    rest = 0.5 * (window - core)
    for k in range(len(out)):
        out[k] = 0.0
        for middle in range(k * per_bin, (k + 1) * per_bin):
            first = middle - core // 2
            total = 0.0
            for j in range(max(first, 0), min(first + core, last)):
                total += energy[j]
            for j in (first - 1, first + core):
                if 0 <= j < last:
                    total += rest * energy[j]
            out[k] = max(out[k], total)


@entry
def compress(
    intensity: Array, spacing: float, spreading: float, alpha: float, limit: float, offset: float, steps: float, full: float,
    counts: Array,
) -> None:  # fmt: skip
    """Counts on a logarithmic scale after time-varied gain.

    Args:
        intensity: (bins) uPa^2.
        spacing: of the bins, m.
        spreading, alpha, limit: time-varied gain of spreading lg r + 2 alpha r, at most the limit; alpha in dB/m, the others in dB.
        offset: added to the level, dB.
        steps: counts per dB.
        full: largest count.
        counts: (bins) receives whole numbers.
    """
    for k in range(len(intensity)):
        r = (k + 0.5) * spacing
        level = 10.0 * math.log10(max(intensity[k], _LEAST_INTENSITY)) + offset
        level += min(spreading * math.log10(r) + 2.0 * alpha * r, limit)
        counts[k] = int(np.rint(min(max(level * steps, 0.0), full)))
