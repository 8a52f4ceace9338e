"""Bollard pull: the thrust of a vehicle that is held fast."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.arrays import FloatArray

DEPTH = 500.0
"""Depth in m at which the surface has no effect."""
_HEAVY = 1e12
"""Mass in kg and inertia in kg m2 of a body that no thrust moves."""
_DT, _SPUN_UP_S = 0.02, 10.0


def bollard(body: BodyParams, tell: Sequence[Callable[[Hydrodynamics, int], None]]) -> FloatArray:
    """Return the wrench (n, 6) in B about the origin, N and N m, of n commands, after shafts and lags have settled.

    Args:
        body: parameters of the vehicle.
        tell: functions that command the vehicle in a row of the world.
    """
    zero, eye = np.zeros((6, 6)), np.eye(6)
    fast = replace(
        body, M_RB=_HEAVY * eye, M_A=zero, D_L=zero, D_Q=zero, D_S=zero, weight=0.0, buoyancy=0.0, displaced=0.0
    )
    hydro = Hydrodynamics([fast] * len(tell), _DT)
    hydro.state[:, 2] = DEPTH
    for row, command in enumerate(tell):
        command(hydro, row)
    for k in range(round(_SPUN_UP_S / _DT)):
        hydro.advance(k * _DT)
    wrench: FloatArray = hydro.rates_of_change(_SPUN_UP_S)[1]
    return wrench
