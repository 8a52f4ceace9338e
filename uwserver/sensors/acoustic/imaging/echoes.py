"""Echoes of rays over range (compiled).

A ray stands for a small solid angle. What it hits counts as flat across that angle, so its echo covers an interval of ranges, not a point. So there
are neither gaps nor moire patterns at grazing incidence, and the energy does not depend on the number of rays. Energies are kept in gates of range,
which are so short that the resolution of the pulse is at least one gate long.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import Elsewhere, compiled, entry
from uwserver.physics.rays.raycast import NOTHING

_LEAST_COSINE = 0.01
"""Least cosine of incidence. At a flatter incidence a ray would meet more than one piece of a real surface."""
_LONGEST = 0.25
"""Largest relative change of range from the middle to the edge of a ray's cell."""
_LEAST_EXTENT = 0.05
"""Least length of an echo, gates."""
_LEAST_RANGE = 1e-2
"""Least range, m; nearer things count as if they were there."""
DECIBEL = 0.1 * math.log(10.0)
"""Natural logarithm of the intensity ratio of 1 dB."""
_LEAST_LOOKS = 2
"""Least number of gates in the resolution of a pulse, so that something thin is in one window as a whole, wherever it stands."""
MOST_GATES = 1 << 17
"""Largest number of gates of a ping; a pulse that would need more counts as longer."""


class Gates(NamedTuple):
    """How range is divided into gates.

    Attributes:
        per_metre: gates in a true metre.
        window: gates in the resolution of the pulse.
        per_bin: gates in a bin.
        total: gates of a ping, including some behind the last bin.
    """

    per_metre: float
    window: float
    per_bin: int
    total: int


def gates(reach: float, bins: int, resolution: float, stretch: float = 1.0) -> Gates:
    """Return the gates of a ping: a whole number of them in each bin, and two or more in the resolution of the pulse.

    Args:
        reach: range at the end of the last bin, as the device believes, m.
        bins: number of bins.
        resolution: resolution of the pulse, true m: c / (2 B).
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
    per_metre: float, column: Array, shift: float, level: float, seconds: Array,
) -> None:  # fmt: skip
    """Add the echoes of rays to the gates of their columns.

    A ray brings Lambert's mu cos^2 on an area r^2 dOmega / cos, spread as r^-4. On a flat bottom at grazing incidence all this together
    falls as r^-5, even within what one ray covers: so it is deposited without that factor, which `energies` applies later.

    Args:
        cells: (n) cells of the rays, as CELL.
        direction: (n, 3) of the rays, in N. What a ray hits is continued as a plane to the middle of its cell.
        R: (3, 3) rotation matrix from the fan to N.
        distance, normal, bodies, material: what each ray hits, as `Hits`.
        ground: ground of the world, as `uwserver.physics.rays.echoes.Ground`.
        per_metre: as in `Gates`.
        column: (n) column of each ray.
        shift: number of gates before the first one that counts; echoes from before that are left out.
        level: factor of all echoes.
        seconds: (columns, gates + 3), to which the second differences of the energy are added. The energy before an edge of an echo is a ramp, whose
            second difference is two numbers; one running sum of all of them gives the energy of the gates.
    """
    for i in range(len(cells)):
        if bodies[i] != NOTHING and distance[i] * per_metre >= shift:
            mu = level * _strength(bodies[i], material[i], ground)
            _deposit(cells[i], direction[i], R, distance[i], normal[i], mu, per_metre, shift, seconds[column[i]])


deposit_columns = entry(deposit.py_func)
"""`deposit`, for Python."""


@compiled
def _deposit(
    cell: Any, direction: Array, R: Array, distance: float, normal: Array, mu: float, per_metre: float, shift: float, second: Array
) -> None:  # fmt: skip
    """Add the echo of one ray to the gates of its column; `mu`: Lambert's parameter of what it hits. Other arguments as of `deposit`."""
    toward = across = along = met = 0.0
    for j in range(3):
        component = normal[0] * R[0, j] + normal[1] * R[1, j] + normal[2] * R[2, j]
        toward += component * cell.direction[j]
        across += component * cell.across[j]
        along += component * cell.along[j]
        met += normal[j] * direction[j]
    sense = 1.0 if met > 0.0 else -1.0
    cosine = max(sense * toward, _LEAST_COSINE)
    # The echo of a cell around range r extends from r / (1 + q) to r / (1 - q).
    q = min(0.5 * math.sqrt(across * across + along * along) / cosine, _LONGEST)
    r = max(distance * min(max(abs(met) / cosine, 1.0 - _LONGEST), 1.0 / (1.0 - _LONGEST)), _LEAST_RANGE)
    start, stop = r / (1.0 + q) * per_metre, r / (1.0 - q) * per_metre
    # An echo within one gate is deposited for the middle of its gate, as `energies` applies the factor of that range.
    at = (math.floor(r * per_metre) + 0.5) / per_metre if stop - start < 1.0 else r
    missing = 0.5 * max(_LEAST_EXTENT - (stop - start), 0.0)
    energy = cell.emitted * mu * cosine * at * at * at * at * at / (r * r * (1.0 - q * q))
    start, stop = max(start - missing - shift, 0.0), max(stop + missing - shift, _LEAST_EXTENT)
    slope = energy / (stop - start)
    _ramp(second, start, slope)
    _ramp(second, stop, -slope)


@compiled
def _ramp(second: Array, edge: float, slope: float) -> None:
    """Add a ramp of the energy that begins at `edge` (gates), as its second difference."""
    edge = min(edge, len(second) - 2.0)
    whole = int(edge)
    part = edge - whole
    second[whole] += slope * (1.0 - part)
    second[whole + 1] += slope * part


@compiled
def energies(second: Array, per_metre: float, alpha: float, out: Array) -> None:
    """Find the mean intensity of all echoes in each gate of a single column, uPa^2.

    Args:
        second: (gates + 3) second differences, as a row of `deposit`.
        per_metre: as in `Gates`.
        alpha: absorption, dB/m.
        out: (gates) receives the intensities; what lies behind the last gate is lost.
    """
    total, lost = 0.0, math.exp(-DECIBEL * alpha / per_metre)
    step = lost * lost
    for k in range(len(out)):
        total += second[k]
        out[k] = 0.0
        if total > 0.0:
            r = (k + 0.5) / per_metre
            out[k] = total * lost / (r * r * r * r * r)
        lost *= step
