"""The arrays that a sensor outside a world sees, made from a scope in Python."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uwserver.physics.collision.contacts import Contacts, Impulses
from uwserver.physics.contact.touching import Touching
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records
from uwserver.physics.kernel.team import ALONE
from uwserver.sensors.base import Scope
from uwserver.sensors.surroundings import FORMS, place_row, water_arrays
from uwserver.sensors.voices import NO_VOICES
from uwserver.sensors.wiring import ELECTRIC, Touch


def _touching(touches: Sequence[Touch]) -> Touching:
    """Return the contacts of the only body, which is in row 0. The other bodies keep the rows that they have in the world."""
    n, made = len(touches), Touching(len(touches))
    rows, nothing = np.array([touch.other for touch in touches], np.int64), np.zeros((n, 3))
    points = np.array([touch.point for touch in touches]).reshape(n, 3)
    impulses = np.array([touch.impulse for touch in touches]).reshape(n, 3)
    flat: FloatArray = np.zeros(n)
    contacts = Contacts(np.zeros_like(rows), rows, points, nothing, flat, rows, flat, flat)
    made.keep(Impulses(contacts, impulses, nothing))
    return made


class ScopeArrays:
    """Keeps the arrays whose addresses are in `table` (`surroundings.FORMS`)."""

    def __init__(self, scope: Scope, voices: Records = NO_VOICES) -> None:
        """Fill the arrays from a scope and from (n) VOICE of the sonars that are heard."""
        state: FloatArray = np.array([[*scope.p_NB, *scope.q_NB, *scope.v_NB_B, *scope.w_NB_B]])
        bodies: Any = np.zeros(1, layout.BODY)
        thrusters: Any = np.zeros(0, layout.THRUSTER)
        lags: Any = np.zeros(0, layout.LAG)
        electrics, touches = np.zeros(0, ELECTRIC), list[Touch]()
        if scope.wiring is not None:
            hydro, row = scope.wiring.hydro, scope.wiring.row
            bodies, thrusters, lags = hydro.bodies[row : row + 1], hydro.thrusters, hydro.lags
            electrics, touches = np.zeros(len(thrusters), ELECTRIC), scope.wiring.touches()
            scope.wiring.fill(electrics)
        self._touching = _touching(touches)
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
            "touching": self._touching.table,
            "voices": voices,
        }
        self.arrays["place"]["t_ns"] = scope.t_ns
        self.table: IntArray = layout.addresses(FORMS, self.arrays)
