"""Tests whether the water can give energy to a body. Damping, foils and derivatives of a hull must only take energy, whatever the motion.

A published derivative is valid for motion ahead. Astern or sideways it may push where a real hull would brake: a term c nu_j nu_k on axis i has
the power c nu_i nu_j nu_k, which changes its sign with the motion. Terms of one triple (i, j, k) that add up to zero do no work, like lift. What
is left of the sum must be less than what damping takes. No list of rules finds all such terms; the power at the worst velocity does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import NU

SPEEDS = (0.5, 2.0, 10.0, 50.0)
"""Speeds in m/s. At the last one only terms of the second degree matter: a body that gets no energy there and near rest gets none anywhere."""
_DEPTH = 500.0
_STARTS, _ROUNDS, _FIRST_STEP, _SHRINK = 100, 300, 0.7, 0.98
"""Parameters of the search: velocities that climb side by side, steps of each, size of the first step relative to the velocity, and the factor
from step to step."""


class Feed(NamedTuple):
    """The velocity at which the water takes the least energy from a body, or gives it the most, among velocities of one kinetic energy.

    Attributes:
        speed: surge speed with that kinetic energy, m/s.
        rate: power of the water over the kinetic energy, 1/s; positive if the water gives energy.
        nu: (6) the velocity in B, m/s and rad/s.
    """

    speed: float
    rate: float
    nu: FloatArray


class WaterPower:
    """The power of still, deep water on a body without thrust, with servos at neutral, and without weight and buoyancy.

    Args:
        body: parameters of the body.
        rows: number of velocities that are evaluated at once.
    """

    def __init__(self, body: BodyParams, rows: int) -> None:
        self._M = body.M_RB + body.M_A
        self._hydro = Hydrodynamics([replace(body, weight=0.0, buoyancy=0.0, displaced=0.0)] * rows, 0.01)
        self._hydro.state[:, 2] = _DEPTH

    def __call__(self, nu: FloatArray) -> FloatArray:
        """Return the power (rows) in W at velocities (rows, 6) in B. It is nu^T M nu_dot, because Coriolis forces do no work."""
        self._hydro.state[:, NU : NU + 6] = nu
        power: FloatArray = np.einsum("ni,ij,nj->n", nu, self._M, self._hydro.rates_of_change(0.0)[0])
        return power

    def velocities(self, directions: FloatArray, speed: float) -> FloatArray:
        """Return velocities (n, 6) with the kinetic energy of a surge speed (m/s). Directions (n, 6) of any length distribute it among the axes."""
        root = np.linalg.cholesky(np.linalg.inv(self._M))
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        result: FloatArray = speed * float(np.sqrt(self._M[0, 0])) * unit @ root.T
        return result

    def energy(self, speed: float) -> float:
        """Return the kinetic energy of body and added mass at a surge speed, J."""
        return 0.5 * float(self._M[0, 0]) * speed * speed


def feeds(body: BodyParams, speeds: Iterable[float] = SPEEDS) -> list[Feed]:
    """Return `largest_feed` at several speeds (m/s)."""
    return [largest_feed(body, speed) for speed in speeds]


def largest_feed(body: BodyParams, speed: float, seed: int = 0) -> Feed:
    """Return the worst velocity with the kinetic energy of a surge speed (m/s), found by climbing from many random velocities."""
    water, rng = WaterPower(body, _STARTS), np.random.default_rng(seed)
    x = rng.normal(size=(_STARTS, 6))
    best = water(water.velocities(x, speed))
    for k in range(_ROUNDS):
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        tried = x + _FIRST_STEP * _SHRINK**k * rng.normal(size=x.shape)
        power = water(water.velocities(tried, speed))
        better = power > best
        x[better], best[better] = tried[better], power[better]
    worst = int(np.argmax(best))
    return Feed(speed, float(best[worst]) / water.energy(speed), water.velocities(x[worst : worst + 1], speed)[0])
