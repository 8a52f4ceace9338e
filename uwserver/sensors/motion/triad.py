"""Errors of three orthogonal axes, as data sheets of gyroscopes, accelerometers and magnetometers state them."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from uwserver.frames import Vec3
from uwserver.modifiers.base import Number
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.table import NonNegative, Positive, Table

HUMP = 0.618
"""Largest Allan deviation of a first-order Gauss-Markov process, at 1.89 correlation times, over its standard deviation (IEEE Std 952)."""

_Gain = Annotated[float, Meta(ge=-1e3, le=1e3)]


class TriadErrors(Table, kw_only=True, frozen=True):
    """Errors of each axis, in the unit of the field. If all are zero, there are none.

    Reading = (I + S + M) (truth + b_on + b_GM + b_RW + noise), held to +-`limit`, rounded to `resolution`.

    Attributes:
        noise_density: unit/sqrt(Hz); the Allan deviation at 1 s.
        instability: bias instability, the floor of the Allan deviation: a first-order Gauss-Markov bias of `instability` / 0.618.
        instability_tau_s: correlation time of that bias.
        random_walk: random walk of the bias, unit/sqrt(s). It grows without limit.
        turn_on: standard deviation of a constant bias, drawn once a run.
        scale: standard deviation of the scale errors (0.01 is 1 %), drawn once a run.
        cross_axis: standard deviation of the six off-axis sensitivities, rad, drawn once a run.
        limit: largest reading; 0 for none.
        resolution: smallest step; 0 for none.
    """

    noise_density: NonNegative = 0.0
    instability: NonNegative = 0.0
    instability_tau_s: Positive = 300.0
    random_walk: NonNegative = 0.0
    turn_on: NonNegative = 0.0
    scale: NonNegative = 0.0
    cross_axis: NonNegative = 0.0
    limit: NonNegative = 0.0
    resolution: NonNegative = 0.0

    def sigma(self, rate_hz: float) -> tuple[float]:
        """Return 1-sigma of a reading of each axis at a rate, without scale errors and random walk."""
        white = self.noise_density * math.sqrt(rate_hz)
        return (math.hypot(white, self.instability / HUMP, self.turn_on),)


class TriadMemory(Struct, frozen=True):
    """The part of a sensor's memory that a triad has.

    Attributes:
        matrix: I + S + M, row-major.
        turn_on, instability, walk: biases of the three axes, in the unit of the field: constant, Gauss-Markov and random walk.
    """

    matrix: tuple[_Gain, _Gain, _Gain, _Gain, _Gain, _Gain, _Gain, _Gain, _Gain] = (
        1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0,
    )  # fmt: skip
    turn_on: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    instability: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    walk: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


TRIAD = [("white", "f8"), ("wander", "f8"), ("tau", "f8"), ("walk", "f8"), ("limit", "f8"), ("resolution", "f8")]
"""`TriadErrors` in the record of a sensor. `wander` is the standard deviation of the Gauss-Markov bias."""
TRIAD_MEMORY = [("matrix", "f8", (9,)), ("turn_on", "f8", (3,)), ("instability", "f8", (3,)), ("walk", "f8", (3,))]
"""`TriadMemory` in the record of a sensor."""
TRIAD_DRAWS = 15
"""How many normal numbers `turn_on` takes."""
TRIAD_LANES = 6
"""How many lanes of random numbers `disturbed` takes."""


def fill_triad(row: Any, errors: TriadErrors) -> None:
    """Write errors into a record."""
    row["white"], row["wander"], row["tau"] = errors.noise_density, errors.instability / HUMP, errors.instability_tau_s
    row["walk"], row["limit"], row["resolution"] = errors.random_walk, errors.limit, errors.resolution


def turn_on(memory: Any, errors: TriadErrors, draws: FloatArray) -> None:
    """Draw the constant errors and the first biases of a run, and write them into a record.

    Args:
        memory: TRIAD_MEMORY.
        errors: errors of the axes.
        draws: (TRIAD_DRAWS) normal numbers.
    """
    matrix = np.eye(3) + errors.cross_axis * draws[:9].reshape(3, 3)
    matrix[np.diag_indices(3)] = 1.0 + errors.scale * draws[:9].reshape(3, 3).diagonal()
    memory["matrix"], memory["turn_on"] = matrix.ravel(), errors.turn_on * draws[9:12]
    memory["instability"], memory["walk"] = errors.instability / HUMP * draws[12:15], 0.0


@compiled
def _three_normals(head: Any, lane: int) -> Vec3:
    a, b = normals(head.key, head.number, SAMPLE, lane)
    c, _ = normals(head.key, head.number, SAMPLE, lane + 1)
    return a, b, c


@compiled
def disturbed(triad: Any, memory: Any, head: Any, lane: int, truth: Vec3) -> Vec3:
    """Return a reading with errors.

    Args:
        triad, memory: TRIAD, and TRIAD_MEMORY, which is updated.
        head: head of the sensor.
        lane: first of the TRIAD_LANES lanes of random numbers.
        truth: the reading of an ideal device.
    """
    x, y, z = truth
    x, y, z = x + memory.turn_on[0], y + memory.turn_on[1], z + memory.turn_on[2]
    if triad.wander > 0.0:
        decay = math.exp(-head.dt / triad.tau)
        step = triad.wander * math.sqrt(1.0 - decay * decay)
        slow = memory.instability
        a, b, c = _three_normals(head, lane)
        slow[0], slow[1], slow[2] = decay * slow[0] + step * a, decay * slow[1] + step * b, decay * slow[2] + step * c
        x, y, z = x + slow[0], y + slow[1], z + slow[2]
    if triad.walk > 0.0:
        step = triad.walk * math.sqrt(head.dt)
        walk = memory.walk
        a, b, c = _three_normals(head, lane + 2)
        walk[0], walk[1], walk[2] = walk[0] + step * a, walk[1] + step * b, walk[2] + step * c
        x, y, z = x + walk[0], y + walk[1], z + walk[2]
    if triad.white > 0.0:
        white = triad.white / math.sqrt(head.dt)
        a, b, c = _three_normals(head, lane + 4)
        x, y, z = x + white * a, y + white * b, z + white * c
    m = memory.matrix
    x, y, z = m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z
    return _through_converter(triad, x), _through_converter(triad, y), _through_converter(triad, z)


@compiled
def _through_converter(triad: Any, x: float) -> float:
    """Return the value after limit and resolution of the converter."""
    if triad.limit > 0.0:
        x = max(-triad.limit, min(triad.limit, x))
    if triad.resolution > 0.0:
        x = np.rint(x / triad.resolution) * triad.resolution
    return x
