"""Errors of three like axes at right angles, as data sheets of gyroscopes, accelerometers and magnetometers state them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uwserver.frames import Vec3
from uwserver.table import NonNegative, Positive, Table

HUMP = 0.618
"""Largest Allan deviation of a first-order Gauss-Markov process over its standard deviation, at 1.89 correlation times (IEEE Std 952)."""


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


class Triad:
    """Applies `TriadErrors`. Its memory, SIZE numbers in a list of the owner, is: matrix (9), turn-on, Gauss-Markov and random-walk bias.

    Attributes:
        draws: how many normal random numbers a reading takes.
        exact: there are no errors.
    """

    SIZE = 18

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

    def turn_on(self, rng: np.random.Generator) -> list[float]:
        """Memory at the start of a run."""
        e = self._errors
        matrix = np.eye(3) + rng.normal(0.0, e.cross_axis, (3, 3))
        matrix[np.diag_indices(3)] = 1.0 + rng.normal(0.0, e.scale, 3)
        constant, slow = rng.normal(0.0, e.turn_on, 3), rng.normal(0.0, self._sigma, 3)
        return [*matrix.ravel().tolist(), *constant.tolist(), *slow.tolist(), 0.0, 0.0, 0.0]

    def read(self, truth: Vec3, memory: list[float], at: int, dt: float, rng: np.random.Generator) -> Vec3:
        """A reading with its errors; moves the biases on by `dt` (s). The memory begins at index `at`."""
        return self.disturbed(truth, memory, at, dt, rng.standard_normal(self.draws).tolist())

    def disturbed(
        self, truth: Vec3, memory: list[float], at: int, dt: float, draws: Sequence[float], k: int = 0
    ) -> Vec3:
        """As `read`, with the random numbers from `draws[k]` on, for one who draws those of several triads at once."""
        if dt != self._dt:
            self._retime(dt)
        a, b, c, d, e, f, g, h, i, x, y, z, gx, gy, gz, rx, ry, rz = memory[at : at + self.SIZE]
        if self._wanders:
            decay, step = self._decay, self._wander_step
            gx, gy, gz = (
                decay * gx + step * draws[k],
                decay * gy + step * draws[k + 1],
                decay * gz + step * draws[k + 2],
            )
            memory[at + 12 : at + 15] = gx, gy, gz
            k += 3
        if self._walks:
            step = self._walk_step
            rx, ry, rz = rx + step * draws[k], ry + step * draws[k + 1], rz + step * draws[k + 2]
            memory[at + 15 : at + 18] = rx, ry, rz
            k += 3
        x, y, z = truth[0] + x + gx + rx, truth[1] + y + gy + ry, truth[2] + z + gz + rz
        if self._noisy:
            white = self._white
            x, y, z = x + white * draws[k], y + white * draws[k + 1], z + white * draws[k + 2]
        return self._converted(a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)

    def _converted(self, x: float, y: float, z: float) -> Vec3:
        limit, step = self._errors.limit, self._errors.resolution
        if limit > 0.0 and not (-limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit):
            x, y, z = max(-limit, min(limit, x)), max(-limit, min(limit, y)), max(-limit, min(limit, z))
        if step > 0.0:
            x, y, z = round(x / step) * step, round(y / step) * step, round(z / step) * step
        return x, y, z
