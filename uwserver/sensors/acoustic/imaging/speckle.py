"""Speckle and bins: what a receiver makes of the echoes in gates (compiled).

The scatterers of a gate have random phases. Together they are one complex normal number, the phasor of the gate. The pulse sums the phasors of its
gates, so amplitudes are Rayleigh distributed, and correlated below the resolution. Phasors come from a counter-based generator and need no memory:
they depend only on the sensor, the gate and the pose, so a sonar at rest sees the same speckle again. Each block of gates has a direction of its own
in the space of poses. While the pose moves along this direction by one unit, one set of phasors fades into the next.
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
"""Number of gates whose phasors come from one random word, which gives their place in a table of normal numbers."""
_BLOCKS = 4  # the generator gives four words at a time
SIZE = _BLOCKS * BLOCK
"""Number of gates whose phasors come from one call of the generator."""
DIRECTIONS = 64
"""Number of directions in the space of poses; blocks of gates use them in turn."""
_SPECKLE, _NOISE = np.uint64(1), np.uint64(2)
"""Second word of the counter; `columns` has others. It is 0 for all other random numbers of a sensor."""
LOW, HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
_PLACES = 1 << 15
_PLACE = np.uint64(_PLACES - 1)
_LEAST_INTENSITY = 1e-30
_PACE = 1.7
"""Units of fading per unit of motion along a random direction. With it, the correlation after one unit of motion is 1 / e."""


def _phasors() -> npt.NDArray[np.float32]:
    """Return (_PLACES + BLOCK, 2) complex normal numbers of mean intensity 1, as real and imaginary part.

    Their spectrum is made flat, so that sums of neighbours have the mean intensity of independent numbers. The first ones come again at the end.
    """
    a, b = np.random.Generator(np.random.Philox(key=11)).standard_normal((2, _PLACES))
    spectrum = np.fft.fft(a + 1j * b)
    made = np.fft.ifft(spectrum / np.abs(spectrum)) * np.sqrt(_PLACES)
    made = np.concatenate([made, made[:BLOCK]])
    return np.stack([made.real, made.imag], axis=1).astype(np.float32)


PHASORS = _phasors()
"""The phasors of all sensors. A random number of the sensor chooses those of a gate."""


def _directions() -> FloatArray:
    """Return (DIRECTIONS, 7) random directions in the space of poses, times `_PACE`, and an offset."""
    rng = np.random.Generator(np.random.Philox(key=7))
    result: FloatArray = np.concatenate(
        [_PACE * rng.standard_normal((DIRECTIONS, 6)), rng.random((DIRECTIONS, 1))], axis=1
    )
    return result


WAYS = _directions()
"""Directions along which the sets of phasors fade."""


@entry
def fade(
    p: Vec3, axis: Vec3, length: float, angle: float, ways: Array, faded: Array, share: Array
) -> None:  # fmt: skip
    """Do what `fading` does, into arrays (DIRECTIONS) of integers and of floats; `ways`: WAYS."""
    for k in range(len(ways)):
        along = ways[k, 6]
        for j in range(3):
            along += ways[k, j] * (p[j] / length) + ways[k, 3 + j] * (axis[j] / angle)
        whole = math.floor(along)
        faded[k], share[k] = whole, along - whole


def fading(p: Vec3, axis: FloatArray, length: float, angle: float) -> tuple[IntArray, FloatArray]:
    """Find how far the phasors of a pose have faded from one set to the next.

    Args:
        p: position of the transducer in N, m.
        axis: (3) unit vector of the beam in N.
        length: motion (m) after which the correlation is 1 / e: half the aperture.
        angle: turn of the beam (rad) after which it is 1 / e: 0.8 beam widths.

    Returns:
        For each direction (DIRECTIONS) the number of the set, and the fraction of the way to the next set.
    """
    faded, share = np.empty(DIRECTIONS, np.int64), np.empty(DIRECTIONS)
    x, y, z = (float(part) for part in p)
    fade((x, y, z), tuple(axis.tolist()), float(length), float(angle), WAYS, faded, share)
    return faded, share


@compiled
def add_phasors(
    words: tuple[np.uint64, np.uint64, np.uint64, np.uint64], factor: float, phasors: Array, real: Array, imaginary: Array
) -> None:  # fmt: skip
    """Add the phasors of four blocks, chosen by four random words, times a factor, to the gates (n); `factor` has the precision of the gates."""
    for block in range(_BLOCKS):
        place, first = words[block] & _PLACE, block * BLOCK
        for i in range(min(BLOCK, len(real) - first)):
            # An unsigned index cannot be negative, so the compiled code does not check for one that counts from the end.
            at = place + np.uint64(i)
            real[first + i] += factor * phasors[at, 0]
            imaginary[first + i] += factor * phasors[at, 1]


@compiled
def scatter(
    energy: Array, key: int, number: int, noise: float, faded: Array, share: Array, phasors: Array, field: Array
) -> None:  # fmt: skip
    """Make the sound of each gate: echoes with the phasors of the pose, and noise with those of the ping.

    Args:
        energy: (gates) mean intensity of the echoes, uPa^2.
        key: key of the sensor's random numbers.
        number: number of the ping.
        noise: its mean intensity in a gate, uPa^2.
        faded, share: as `fading` returns them.
        phasors: PHASORS.
        field: (gates, 2) receives real and imaginary part, uPa.
    """
    k, n = np.uint64(key), np.uint64(number)
    low, high = k & LOW, k >> HALF
    root = math.sqrt(noise)
    for first in range(0, len(energy), SIZE):
        end, turn = min(first + SIZE, len(energy)), first // SIZE
        counter, way = np.uint64(turn), turn % DIRECTIONS
        here, strongest = field[first:end], 0.0
        real, imaginary = here[:, 0], here[:, 1]
        for i in range(end - first):
            here[i, 0] = here[i, 1] = 0.0
            strongest = max(strongest, energy[first + i])
        if strongest > 0.0:
            turned = 0.5 * math.pi * share[way]
            for step in range(2):
                m = np.uint64(faded[way] + step)
                words = philox(counter, _SPECKLE, m & LOW, m >> HALF, low, high)
                add_phasors(words, math.sin(turned) if step else math.cos(turned), phasors, real, imaginary)
            for i in range(end - first):
                amplitude = math.sqrt(energy[first + i])
                here[i, 0] *= amplitude
                here[i, 1] *= amplitude
        if root > 0.0:
            add_phasors(philox(counter, _NOISE, n & LOW, n >> HALF, low, high), root, phasors, real, imaginary)


@compiled
def detect(field: Array, window: float, per_bin: int, out: Array) -> None:
    """Find the strongest sample of the matched filter's output in each bin. There is one sample a gate: the sum of the gates within the pulse.

    Args:
        field: (gates, 2) as `scatter` writes it.
        window, per_bin: as in `Gates`.
        out: (bins, 2) receives real and imaginary part, uPa.
    """
    core, last = int(window), len(field)
    # The fraction of a gate that is left of the window is shared by both its ends, by energy.
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
    """Do what `detect` does with mean intensities (gates), without speckle. The pulse sums intensities; `out` is (bins), uPa^2."""
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
    """Make counts on a logarithmic scale after time-varied gain.

    Args:
        intensity: (bins) uPa^2.
        spacing: length of a bin, m.
        spreading, alpha, limit: the time-varied gain is spreading lg r + 2 alpha r, at most the limit; alpha in dB/m, the others in dB.
        offset: added to the level, dB.
        steps: counts per dB.
        full: largest count.
        counts: (bins) receives integers.
    """
    for k in range(len(intensity)):
        r = (k + 0.5) * spacing
        level = 10.0 * math.log10(max(intensity[k], _LEAST_INTENSITY)) + offset
        level += min(spreading * math.log10(r) + 2.0 * alpha * r, limit)
        counts[k] = int(np.rint(min(max(level * steps, 0.0), full)))
