"""Echoes of rays, over range where they are those of a fan (compiled).

A ray of a fan stands for a small solid angle. What it hits counts as flat across that angle, so its echo covers an interval of ranges, not a point:
neither gaps nor moire appear at grazing incidence, and the energy stays the same whatever the number of rays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, entry
from uwserver.physics.rays.raycast import NOTHING, SURFACE, Hits

_LEAST_COSINE = 0.01
"""Of incidence: nothing is so flat that a ray along it meets only one piece."""
_LONGEST = 0.25
"""Largest part by which a range changes from the middle to the edge of a ray's cell."""
_LEAST_EXTENT = 0.05
"""Bins; an echo covers at least that."""
_LEAST_RANGE = 1e-2
"""m; nearer things count as if they were there."""
_LEAST_INTENSITY = 1e-30
_LEAST_GRAZING = 0.01
"""Sine below which backscatter falls no further: no bottom is that flat."""
_DECIBEL = 0.1 * math.log(10.0)


class Ground(NamedTuple):
    """How strongly things scatter sound back.

    Attributes:
        lambert: Lambert's parameter by material, linear.
        surface: of the sea surface.
    """

    lambert: Array
    surface: float


class Pulse(NamedTuple):
    """How echoes are spread over range.

    Attributes:
        per_metre: bins.
        resolution: of the pulse, m.
        alpha: absorption, dB/m.
    """

    per_metre: float
    resolution: float
    alpha: float


@entry
def backscatter(
    direction: Array, normal: Array, bodies: Array, material: Array, lambert: Array, surface: float, out: Array
) -> None:
    """Intensity that a square metre of what each ray hits scatters back at 1 m, per unit of incident intensity: Lambert's law.

    Args:
        direction, normal: (n, 3) of the rays and of what they hit.
        bodies, material: (n) of what they hit; nothing comes back from a miss.
        lambert, surface: of `Ground`.
        out: (n) receives it.
    """
    ground = Ground(lambert, surface)
    for i in range(len(out)):
        out[i] = returned(direction[i], normal[i], bodies[i], material[i], ground)


@compiled
def returned(direction: Array, normal: Array, body: int, material: int, ground: Ground) -> float:
    """The same of one ray."""
    sine = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    sine = max(abs(sine), _LEAST_GRAZING)
    return float(_mu(body, material, ground) * sine * sine)


@compiled
def _mu(body: int, material: int, ground: Ground) -> float:
    """Lambert's parameter. A material that nobody named counts as the last one: a sensor is no place to fail."""
    if body == NOTHING:
        return 0.0
    return ground.surface if body == SURFACE else float(ground.lambert[min(max(material, 0), len(ground.lambert) - 1)])


@entry
def intensity(cells: Array, R: Array, hits: Hits, ground: Ground, pulse: Pulse, out: Array) -> None:
    """Mean intensity of the echoes in cells of the pulse's resolution.

    A ray brings Lambert's mu cos^2 on an area r^2 dOmega / cos, spread as r^-4. On a flat bottom at grazing incidence all this together
    falls as r^-5, also within what one ray covers: so it is deposited without that factor, which the bins bring.

    Args:
        cells: (n) of the fan, as `layout.CELL`.
        R: (3, 3) attitude of the fan in N.
        hits: what each ray meets.
        ground: of the world.
        pulse: of the instrument.
        out: (bins) receives uPa^2; what lies behind the last bin is lost.
    """
    bins, normal = len(out), hits.normal
    per_metre, resolution = pulse.per_metre, pulse.resolution
    # The energy before an edge of an echo is a ramp: its second difference is two numbers, and one running sum of all gives the bins.
    second = np.zeros(bins + 3)
    for i in range(len(cells)):
        if hits.body[i] == NOTHING:
            continue
        cell = cells[i]
        toward = across = along = 0.0
        for j in range(3):
            component = normal[i, 0] * R[0, j] + normal[i, 1] * R[1, j] + normal[i, 2] * R[2, j]
            toward += component * cell.direction[j]
            across += component * cell.across[j]
            along += component * cell.along[j]
        cosine = max(abs(toward), _LEAST_COSINE)
        # What a ray meets at range r reaches from r / (1 + q) to r / (1 - q).
        q = min(0.5 * math.sqrt(across * across + along * along) / cosine, _LONGEST)
        r = max(hits.distance[i], _LEAST_RANGE)
        start, stop = r / (1.0 + q) * per_metre, r / (1.0 - q) * per_metre
        missing = 0.5 * max(max(resolution * per_metre, _LEAST_EXTENT) - (stop - start), 0.0)
        # An echo within one bin is deposited for the middle of its bin.
        at = (math.floor(r * per_metre) + 0.5) / per_metre if stop - start < 1.0 else r
        mu = _mu(hits.body[i], hits.material[i], ground)
        energy = cell.emitted * mu * cosine * at * at * at * at * at / (r * r * (1.0 - q * q))
        start, stop = max(start - missing, 0.0), stop + missing
        slope = energy / (stop - start)
        _ramp(second, start, slope, bins)
        _ramp(second, stop, -slope, bins)
    total = 0.0
    for k in range(bins):
        total += second[k]
        middle = (k + 0.5) / per_metre
        spread = 1.0 / (middle * middle * middle * middle * middle)
        out[k] = max(total, 0.0) * spread * math.exp(-2.0 * _DECIBEL * pulse.alpha * middle) * (resolution * per_metre)


@compiled
def _ramp(second: Array, edge: float, slope: float, bins: int) -> None:
    edge = min(edge, bins + 1.0)
    whole = int(edge)
    part = edge - whole
    second[whole] += slope * (1.0 - part)
    second[whole + 1] += slope * part


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
