"""Whether water can give a body energy: damping, foils and derivatives of a hull must only take it, whatever the motion.

A published derivative holds for going ahead. Astern or sideways it may push where a hull would brake: a term c nu_j nu_k on axis i has the power
c nu_i nu_j nu_k, which changes its sign with the motion. Terms of one triple (i, j, k) that add up to zero do no work, as lift does none; what is
left of the sum must be less than what damping takes. No list of rules finds all of that; the power at the worst velocity does.
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
"""m/s. The last is where only terms of the second degree count: what does not feed there and at rest does nowhere."""
_DEPTH = 500.0
_STARTS, _ROUNDS, _FIRST_STEP, _SHRINK = 100, 300, 0.7, 0.98
"""Of the search: velocities that climb at once, attempts of each, and the size of an attempt over that of the velocity."""


class Feed(NamedTuple):
    """The velocity at which water takes least from a body, or gives it most, among those of one kinetic energy.

    Attributes:
        speed: of surge with that energy, m/s.
        rate: power of the water over the kinetic energy, 1/s; positive: it gives.
        nu: (6) that velocity in B, m/s and rad/s.
    """

    speed: float
    rate: float
    nu: FloatArray


class WaterPower:
    """Power of all that still, deep water does to a body, without thrust and with servos at their neutral; weight and buoyancy left out.

    Args:
        body: its parameters.
        rows: how many velocities are asked for at once.
    """

    def __init__(self, body: BodyParams, rows: int) -> None:
        self._M = body.M_RB + body.M_A
        self._hydro = Hydrodynamics([replace(body, weight=0.0, buoyancy=0.0, displaced=0.0)] * rows, 0.01)
        self._hydro.state[:, 2] = _DEPTH

    def __call__(self, nu: FloatArray) -> FloatArray:
        """(rows) in W at velocities (rows, 6) in B. Coriolis forces do no work, so it is nu^T M nu_dot."""
        self._hydro.state[:, NU : NU + 6] = nu
        power: FloatArray = np.einsum("ni,ij,nj->n", nu, self._M, self._hydro.rates_of_change(0.0)[0])
        return power

    def velocities(self, directions: FloatArray, speed: float) -> FloatArray:
        """(n, 6) of the kinetic energy of a surge speed (m/s), each axis with its share of it by directions (n, 6) of any length."""
        root = np.linalg.cholesky(np.linalg.inv(self._M))
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        result: FloatArray = speed * float(np.sqrt(self._M[0, 0])) * unit @ root.T
        return result

    def energy(self, speed: float) -> float:
        """Kinetic energy of body and water of that surge speed, J."""
        return 0.5 * float(self._M[0, 0]) * speed * speed


def largest_feed(body: BodyParams, speed: float, seed: int = 0) -> Feed:
    """The worst velocity of the kinetic energy of a surge speed (m/s), found by climbing from many random ones."""
    return _climb(WaterPower(body, _STARTS), speed, seed)


def feeds(body: BodyParams, speeds: Iterable[float] = SPEEDS) -> list[Feed]:
    """`largest_feed` at several speeds."""
    water = WaterPower(body, _STARTS)
    return [_climb(water, speed, 0) for speed in speeds]


def _climb(water: WaterPower, speed: float, seed: int) -> Feed:
    rng = np.random.default_rng(seed)
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
