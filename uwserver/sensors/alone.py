"""The instant that a sensor alone sees, from a scope in plain Python."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.team import ALONE
from uwserver.sensors.base import Scope
from uwserver.sensors.surroundings import FORMS, place_row, water_arrays
from uwserver.sensors.wiring import ELECTRIC


class Alone:
    """Keeps the arrays whose addresses are in `table`."""

    def __init__(self, scope: Scope) -> None:
        state: FloatArray = np.array([[*scope.p_NB, *scope.q_NB, *scope.v_NB_B, *scope.w_NB_B]])
        wiring = scope.wiring
        bodies: Any = np.zeros(1, layout.BODY)
        thrusters: Any = np.zeros(0, layout.THRUSTER)
        lags: Any = np.zeros(0, layout.LAG)
        if wiring is not None:
            bodies, thrusters, lags = wiring.bodies, wiring.thrusters, wiring.lags
        electrics = np.zeros(len(thrusters), ELECTRIC)
        if wiring is not None:
            wiring.fill(electrics)
        self.arrays = {
            "state": state,
            "nu_dot": np.array([scope.nu_dot], float),
            "tau": np.array([scope.tau], float),
            "bodies": bodies,
            "thrusters": thrusters,
            "electrics": electrics,
            "lags": lags,
            "place": place_row(scope.water, scope.earth),
            "lambert": scope.lambert,
            **water_arrays(scope.water),
            "team": ALONE,
        }
        self.arrays["place"]["t_ns"] = scope.t_ns
        self.table: IntArray = layout.addresses(FORMS, self.arrays)
