"""Errors of three like axes at right angles, as data sheets of gyroscopes, accelerometers and magnetometers state them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from uwserver.frames import Vec3
from uwserver.modifiers.base import Number
from uwserver.table import NonNegative, Positive, Table

HUMP = 0.618
"""Largest Allan deviation of a first-order Gauss-Markov process over its standard deviation, at 1.89 correlation times (IEEE Std 952)."""

_Gain = Annotated[float, Meta(ge=-1e3, le=1e3)]


class TriadErrors(Table, kw_only=True, frozen=True):
    """Errors of each axis, in the unit of the field. All zero: none.

    Reading = (I + S + M) (truth + b_on + b_GM + b_RW + noise), held to +-`limit`, rounded to `resolution`.

    Attributes:
        noise_density: unit/sqrt(Hz); the Allan deviation of 1 s.
        instability: bias instability, the floor of the Allan deviation: a first-order Gauss-Markov bias of `instability` / 0.618.
        instability_tau_s: its correlation time.
        random_walk: of the bias, unit/sqrt(s); it grows without end.
        turn_on: standard deviation of a constant bias, drawn once a run.
        scale: standard deviation of the scale errors, drawn once a run (0.01 is 1 %).
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


class TriadMemory(Struct, frozen=True):
    """Part of the memory of a sensor with three such axes.

    Attributes:
    matrix: I + S + M, row-major.
    turn_on, instability, walk: the biases of the three axes, in the unit of the field: constant, Gauss-Markov and random walk.
    """

    matrix: tuple[_Gain, _Gain, _Gain, _Gain, _Gain, _Gain, _Gain, _Gain, _Gain] = (
        1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0,
    )  # fmt: skip
    turn_on: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    instability: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    walk: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


class Triad:
    """Applies `TriadErrors`; its memory is kept by the sensor that has it.

    Attributes:
        draws: how many normal random numbers a reading takes.
        exact: there are no errors.
    """

    def __init__(self, errors: TriadErrors) -> None:
        self._errors = errors
        self._sigma = errors.instability / HUMP
        self._noisy, self._wanders, self._walks = (
            errors.noise_density > 0.0,
            self._sigma > 0.0,
            errors.random_walk > 0.0,
        )
        self.draws = 3 * (self._noisy + self._wanders + self._walks)
        self.exact = errors == TriadErrors()
        self._retime(1.0)

    def _retime(self, dt: float) -> None:
        """Factors that depend on the interval alone."""
        e = self._errors
        self._dt, self._decay = dt, math.exp(-dt / e.instability_tau_s)
        self._wander_step = self._sigma * math.sqrt(1.0 - self._decay * self._decay)
        self._walk_step, self._white = e.random_walk * math.sqrt(dt), e.noise_density / math.sqrt(dt)

    def turn_on(self, rng: np.random.Generator) -> TriadMemory:
        """Memory at the start of a run."""
        e = self._errors
        matrix = np.eye(3) + rng.normal(0.0, e.cross_axis, (3, 3))
        matrix[np.diag_indices(3)] = 1.0 + rng.normal(0.0, e.scale, 3)
        constant, slow = rng.normal(0.0, e.turn_on, 3), rng.normal(0.0, self._sigma, 3)
        # mypy does not count: nine and three numbers
        return TriadMemory(tuple(matrix.ravel().tolist()), tuple(constant.tolist()), tuple(slow.tolist()))  # type: ignore[arg-type]

    def disturbed(
        self, truth: Vec3, memory: TriadMemory, dt: float, draws: Sequence[float], k: int = 0
    ) -> tuple[Vec3, TriadMemory]:
        """A reading with its errors, and the memory after it.

        Args:
            truth: what an ideal device reads.
            memory: from the last reading.
            dt: time since then, s.
            draws: normal random numbers, of which it takes `self.draws` from place k on: who has several triads draws for all at once.
            k: see there.
        """
        if dt != self._dt:
            self._retime(dt)
        a, b, c, d, e, f, g, h, i = memory.matrix
        (x, y, z), (gx, gy, gz), (rx, ry, rz) = memory.turn_on, memory.instability, memory.walk
        if self._wanders:
            decay, step = self._decay, self._wander_step
            p, q, r = draws[k : k + 3]
            gx, gy, gz = decay * gx + step * p, decay * gy + step * q, decay * gz + step * r
            k += 3
        if self._walks:
            step = self._walk_step
            rx, ry, rz = rx + step * draws[k], ry + step * draws[k + 1], rz + step * draws[k + 2]
            k += 3
        if self._wanders or self._walks:
            memory = TriadMemory(memory.matrix, memory.turn_on, (gx, gy, gz), (rx, ry, rz))
        x, y, z = truth[0] + x + gx + rx, truth[1] + y + gy + ry, truth[2] + z + gz + rz
        if self._noisy:
            white = self._white
            x, y, z = x + white * draws[k], y + white * draws[k + 1], z + white * draws[k + 2]
        return self._converted(a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z), memory

    def _converted(self, x: float, y: float, z: float) -> Vec3:
        limit, step = self._errors.limit, self._errors.resolution
        if limit > 0.0 and not (-limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit):
            x, y, z = max(-limit, min(limit, x)), max(-limit, min(limit, y)), max(-limit, min(limit, z))
        if step > 0.0:
            x, y, z = round(x / step) * step, round(y / step) * step, round(z / step) * step
        return x, y, z
