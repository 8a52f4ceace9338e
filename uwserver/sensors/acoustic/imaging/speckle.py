"""Speckle and bins: what a receiver makes of the echoes in gates (compiled).

The scatterers of a gate have random phases: together they are one complex normal number, its phasor. The pulse sums the phasors of its gates, so
that amplitudes are Rayleigh and correlated below its resolution. Phasors are numbers of a counter, not of a memory: they depend on the sensor, the
gate and the pose alone, so that a sonar which does not move sees what it saw. Each block of gates looks along a direction of its own in the space
of poses, and as a pose moves along it by one unit, one set of phasors fades into the next.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from uwserver.frames import Vec3
from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.kernel.random import philox

BLOCK = 8
"""Gates whose phasors are made of one random word: it says where in a table of normal numbers they stand."""
_BLOCKS = 4
"""Of as many words as the generator gives at a time."""
DIRECTIONS = 64
"""In the space of poses, by turns."""
_SPECKLE, _NOISE = np.uint64(1), np.uint64(2)
"""Second word of the counter. That of all other numbers of a path is 0."""
_LOW, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
_PLACES = 1 << 15
_PLACE = np.uint64(_PLACES - 1)
_LEAST_INTENSITY = 1e-30
_PACE = 1.7
"""Units of fading along a random direction that leave a correlation of 1 / e after one unit of motion."""


def _phasors() -> npt.NDArray[np.float32]:
    """(_PLACES + BLOCK, 2) complex normal numbers of mean intensity 1, as real and imaginary part. Their spectrum is made flat, so that sums of
    neighbours have their mean intensity too; and they go round."""
    a, b = np.random.Generator(np.random.Philox(key=11)).standard_normal((2, _PLACES))
    spectrum = np.fft.fft(a + 1j * b)
    made = np.fft.ifft(spectrum / np.abs(spectrum)) * np.sqrt(_PLACES)
    made = np.concatenate([made, made[:BLOCK]])
    return np.stack([made.real, made.imag], axis=1).astype(np.float32)


PHASORS = _phasors()
"""Of all sensors: which ones a gate has is a number of the sensor."""


def _directions() -> FloatArray:
    """(DIRECTIONS, 7) random directions of the space of poses, times their pace, and an offset."""
    rng = np.random.Generator(np.random.Philox(key=7))
    result: FloatArray = np.concatenate(
        [_PACE * rng.standard_normal((DIRECTIONS, 6)), rng.random((DIRECTIONS, 1))], axis=1
    )
    return result


WAYS = _directions()
"""Along which poses move from set to set."""


@entry
def fade(
    p: Vec3, axis: Vec3, length: float, angle: float, ways: Array, faded: Array, share: Array
) -> None:  # fmt: skip
    """`fading`, into arrays (DIRECTIONS) of whole numbers and of floats; `ways`: WAYS."""
    for k in range(len(ways)):
        along = ways[k, 6]
        for j in range(3):
            along += ways[k, j] * (p[j] / length) + ways[k, 3 + j] * (axis[j] / angle)
        whole = math.floor(along)
        faded[k], share[k] = whole, along - whole


def fading(p: Vec3, axis: FloatArray, length: float, angle: float) -> tuple[IntArray, FloatArray]:
    """How far the phasors of a pose have faded from one set to the next.

    Args:
        p: of the transducer in N, m.
        axis: (3) of the beam, unit, in N.
        length: a motion (m) that leaves a correlation of 1 / e, half the aperture.
        angle: a turn of the beam (rad) that does, 0.8 beam widths.

    Returns:
        number of the set, (DIRECTIONS) whole, and the fraction of the way to the next, of each direction.
    """
    faded, share = np.empty(DIRECTIONS, np.int64), np.empty(DIRECTIONS)
    x, y, z = (float(part) for part in p)
    fade((x, y, z), tuple(axis.tolist()), float(length), float(angle), WAYS, faded, share)
    return faded, share


@compiled
def _add(words: tuple[np.uint64, np.uint64, np.uint64, np.uint64], factor: float, phasors: Array, field: Array) -> None:
    """Add the phasors of all blocks of four words, times a factor, to the gates (n, 2)."""
    for block in range(_BLOCKS):
        place, first = words[block] & _PLACE, block * BLOCK
        for i in range(min(BLOCK, len(field) - first)):
            # An unsigned index needs no look whether it counts from the end.
            at = place + np.uint64(i)
            field[first + i, 0] += factor * phasors[at, 0]
            field[first + i, 1] += factor * phasors[at, 1]


@compiled
def scatter(
    energy: Array, key: int, number: int, noise: float, faded: Array, share: Array, phasors: Array, field: Array
) -> None:  # fmt: skip
    """The sound of each gate: echoes with the phasors of the pose, noise with those of the ping.

    Args:
        energy: (gates) mean intensity of the echoes, uPa^2.
        key: of the sensor's random numbers.
        number: of the ping.
        noise: mean intensity in a gate.
        faded, share: of `fading`.
        phasors: PHASORS.
        field: (gates, 2) receives real and imaginary part, uPa.
    """
    k, n = np.uint64(key), np.uint64(number)
    low, high = k & _LOW, k >> _HALF
    size, root = _BLOCKS * BLOCK, math.sqrt(noise)
    for first in range(0, len(energy), size):
        end, turn = min(first + size, len(energy)), first // size
        counter, way = np.uint64(turn), turn % DIRECTIONS
        here, strongest = field[first:end], 0.0
        for i in range(end - first):
            here[i, 0] = here[i, 1] = 0.0
            strongest = max(strongest, energy[first + i])
        if strongest > 0.0:
            turned = 0.5 * math.pi * share[way]
            for step in range(2):
                m = np.uint64(faded[way] + step)
                words = philox(counter, _SPECKLE, m & _LOW, m >> _HALF, low, high)
                _add(words, math.sin(turned) if step else math.cos(turned), phasors, here)
            for i in range(end - first):
                amplitude = math.sqrt(energy[first + i])
                here[i, 0] *= amplitude
                here[i, 1] *= amplitude
        if root > 0.0:
            _add(philox(counter, _NOISE, n & _LOW, n >> _HALF, low, high), root, phasors, here)


@compiled
def detect(field: Array, window: float, per_bin: int, out: Array) -> None:
    """Bins of the matched filter's output: the largest of its samples in each, one a gate. The pulse sums the sound of as many gates as it is long.

    Args:
        field: (gates, 2) as of `scatter`.
        window, per_bin: of `Gates`.
        out: (bins, 2) receives real and imaginary part, uPa.
    """
    core, last = int(window), len(field)
    # What is left of the window goes to both its ends, by energy.
    rest = math.sqrt(0.5 * (window - core))
    for k in range(len(out)):
        peak = -1.0
        for middle in range(k * per_bin, (k + 1) * per_bin):
            first = middle - core // 2
            real = imaginary = 0.0
            if first >= 1 and first + core < last:
                real = rest * (field[first - 1, 0] + field[first + core, 0])
                imaginary = rest * (field[first - 1, 1] + field[first + core, 1])
            for j in range(max(first, 0), min(first + core, last)):
                real += field[j, 0]
                imaginary += field[j, 1]
            intensity = real * real + imaginary * imaginary
            if intensity > peak:
                peak, out[k, 0], out[k, 1] = intensity, real, imaginary


@compiled
def detect_mean(energy: Array, window: float, per_bin: int, out: Array) -> None:
    """The same of mean intensities (gates), which the pulse sums as they are: without speckle."""
    core, last = int(window), len(energy)
    rest = 0.5 * (window - core)
    for k in range(len(out)):
        peak = 0.0
        for middle in range(k * per_bin, (k + 1) * per_bin):
            first, total = middle - core // 2, 0.0
            if first >= 1 and first + core < last:
                total = rest * (energy[first - 1] + energy[first + core])
            for j in range(max(first, 0), min(first + core, last)):
                total += energy[j]
            peak = max(peak, total)
        out[k] = peak


@compiled
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
