"""The instant that a sensor alone sees, from a scope in plain Python."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.team import ALONE
from uwserver.sensors.base import Scope
from uwserver.sensors.instant import FORMS, PLACE
from uwserver.sensors.wiring import ELECTRIC


def water_arrays(water: Water) -> dict[str, Any]:
    """Arrays of the water, by the names of `FORMS`."""
    rows = water.sea.rows if water.sea is not None else None
    nothing = np.zeros(7), np.zeros((0, layout.PROFILE_SIZE)), np.zeros((0, layout.WAVE_SIZE))
    uniform, profiles, waves = (rows.uniform, rows.profiles, rows.waves) if rows is not None else nothing
    return {"column": water.column.table, "uniform": uniform, "profiles": profiles, "waves": waves}


def place_row(water: Water, earth: Earth) -> Any:
    """The PLACE of a world."""
    place = np.zeros(1, PLACE)
    row = place[0]
    row["gravity"], row["density"], row["atmosphere"] = water.gravity, water.density, water.atmospheric_pressure
    row["current"], row["ph"] = water.current, water.column.ph
    row["moves"] = water.sea is not None
    row["latitude"], row["longitude"], row["epoch_ns"] = earth.latitude, earth.longitude, earth.epoch_ns
    row["declination"], row["magnetic"] = earth.declination, earth.magnetic
    return place


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
