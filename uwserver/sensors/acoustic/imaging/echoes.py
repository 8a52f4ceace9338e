"""Echoes of rays over range (compiled).

A ray stands for a small solid angle. What it hits counts as flat across that angle, so its echo covers an interval of ranges, not a point:
neither gaps nor moire appear at grazing incidence, and the energy stays the same whatever the number of rays. Energies are kept by gates, which
are so short that two or more make the resolution of the pulse.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import Elsewhere, compiled, entry
from uwserver.physics.rays.raycast import NOTHING

_LEAST_COSINE = 0.01
"""Of incidence: nothing is so flat that a ray along it meets only one piece."""
_LONGEST = 0.25
"""Largest part by which a range changes from the middle to the edge of a ray's cell."""
_LEAST_EXTENT = 0.05
"""Gates; an echo covers at least that."""
_LEAST_RANGE = 1e-2
"""m; nearer things count as if they were there."""
_DECIBEL = 0.1 * math.log(10.0)
_LEAST_LOOKS = 2
"""Gates of the resolution of a pulse, so that what is thin is in one window whole, wherever it stands."""
MOST_GATES = 1 << 17
"""A pulse so short that a ping would have more gates counts as longer."""


class Gates(NamedTuple):
    """How range is divided.

    Attributes:
        per_metre: gates of a true metre.
        window: gates that the resolution of the pulse is long, 2 or more.
        per_bin: gates of a bin.
        total: of a ping, some behind the last bin included.
    """

    per_metre: float
    window: float
    per_bin: int
    total: int


def gates(reach: float, bins: int, resolution: float, stretch: float = 1.0) -> Gates:
    """Gates of a ping: a whole number of them in each bin, and two or more in the resolution of the pulse.

    Args:
        reach: range at the end of the last bin, as the device believes, m.
        bins: of the ping.
        resolution: of the pulse, true m: c / (2 B).
        stretch: believed over true sound speed.
    """
    resolved = min(stretch * resolution, reach)
    per_bin = math.ceil(min(_LEAST_LOOKS * reach / (bins * resolved), max(MOST_GATES // bins, 1)))
    gate_m = reach / (bins * per_bin)
    window = max(resolved / gate_m, float(_LEAST_LOOKS))
    return Gates(stretch / gate_m, window, per_bin, bins * per_bin + math.ceil(0.5 * window) + 1)


_strength: Any = Elsewhere("uwserver.physics.rays.echoes", "strength")


@compiled
def deposit(
    cells: Array, direction: Array, R: Array, distance: Array, normal: Array, bodies: Array, material: Array, ground: Any,
    per_metre: float, second: Array,
) -> None:  # fmt: skip
    """Put the echoes of rays into gates.

    A ray brings Lambert's mu cos^2 on an area r^2 dOmega / cos, spread as r^-4. On a flat bottom at grazing incidence all this together
    falls as r^-5, also within what one ray covers: so it is deposited without that factor, which `energies` brings.

    Args:
        cells: (n) of the rays, as CELL.
        direction: (n, 3) of the rays, in N. What a ray meets is continued flat to the middle of its cell.
        R: (3, 3) attitude of the fan in N.
        distance, normal, bodies, material: of `Hits`: what each ray meets.
        ground: of the world, as `uwserver.physics.rays.echoes.Ground`.
        per_metre: of `Gates`.
        second: (gates + 3), to which is added. The energy before an edge of an echo is a ramp: its second difference is two numbers, and one
            running sum of all gives the gates.
    """
    for i in range(len(cells)):
        if bodies[i] != NOTHING:
            mu = _strength(bodies[i], material[i], ground)
            _deposit(cells[i], direction[i], R, distance[i], normal[i], mu, per_metre, 0.0, second)


@entry
def deposit_columns(
    cells: Array, direction: Array, R: Array, distance: Array, normal: Array, bodies: Array, material: Array, ground: Any,
    per_metre: float, column: Array, shift: float, level: float, seconds: Array,
) -> None:  # fmt: skip
    """Put the echoes of rays into gates of their columns.

    Args:
        cells: (n) of the rays.
        direction, R, distance, normal, bodies, material, ground, per_metre: of `deposit`.
        column: (n) of each ray.
        shift: gates that went by before the first one that counts.
        level: factor of all.
        seconds: (columns, gates + 3), each as `second` of `deposit`; rays that would stand before the first gate are left out.
    """
    for i in range(len(cells)):
        if bodies[i] != NOTHING and distance[i] * per_metre >= shift:
            mu = level * _strength(bodies[i], material[i], ground)
            _deposit(cells[i], direction[i], R, distance[i], normal[i], mu, per_metre, shift, seconds[column[i]])


@compiled
def _deposit(
    cell: Any, direction: Array, R: Array, distance: float, normal: Array, mu: float, per_metre: float, shift: float, second: Array
) -> None:  # fmt: skip
    """Put the echo of one ray into gates; `mu`: Lambert's parameter of what it meets."""
    toward = across = along = met = 0.0
    for j in range(3):
        component = normal[0] * R[0, j] + normal[1] * R[1, j] + normal[2] * R[2, j]
        toward += component * cell.direction[j]
        across += component * cell.across[j]
        along += component * cell.along[j]
        met += normal[j] * direction[j]
    sense = 1.0 if met > 0.0 else -1.0
    cosine = max(sense * toward, _LEAST_COSINE)
    # What a cell meets at range r reaches from r / (1 + q) to r / (1 - q).
    q = min(0.5 * math.sqrt(across * across + along * along) / cosine, _LONGEST)
    r = max(distance * min(max(abs(met) / cosine, 1.0 - _LONGEST), 1.0 / (1.0 - _LONGEST)), _LEAST_RANGE)
    start, stop = r / (1.0 + q) * per_metre, r / (1.0 - q) * per_metre
    # An echo within one gate is deposited for the middle of its gate.
    at = (math.floor(r * per_metre) + 0.5) / per_metre if stop - start < 1.0 else r
    missing = 0.5 * max(_LEAST_EXTENT - (stop - start), 0.0)
    energy = cell.emitted * mu * cosine * at * at * at * at * at / (r * r * (1.0 - q * q))
    start, stop = max(start - missing - shift, 0.0), max(stop + missing - shift, _LEAST_EXTENT)
    slope = energy / (stop - start)
    _ramp(second, start, slope)
    _ramp(second, stop, -slope)


@compiled
def _ramp(second: Array, edge: float, slope: float) -> None:
    edge = min(edge, len(second) - 2.0)
    whole = int(edge)
    part = edge - whole
    second[whole] += slope * (1.0 - part)
    second[whole + 1] += slope * part


@compiled
def energies(second: Array, per_metre: float, alpha: float, out: Array) -> None:
    """Mean intensity that the echoes of each gate bring together, uPa^2.

    Args:
        second: as `deposit` leaves it.
        per_metre: of `Gates`.
        alpha: absorption, dB/m.
        out: (gates) receives it; what lies behind the last gate is lost.
    """
    total, lost = 0.0, math.exp(-_DECIBEL * alpha / per_metre)
    step = lost * lost
    for k in range(len(out)):
        total += second[k]
        out[k] = 0.0
        if total > 0.0:
            r = (k + 0.5) / per_metre
            out[k] = total * lost / (r * r * r * r * r)
        lost *= step
