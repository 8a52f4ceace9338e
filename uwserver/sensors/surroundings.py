"""The arrays of sensors in compiled code: the head of each sensor, and the table `surroundings` of what they see of the world.

For a sensor outside a world, `ScopeArrays` makes them from a scope.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.physics.collision.contacts import Contacts, Impulses
from uwserver.physics.contact.touching import Touching
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records
from uwserver.physics.kernel.layout import BODY, LAG, PROFILE_SIZE, STATE_SIZE, THRUSTER, WAVE_SIZE, Forms, columns
from uwserver.physics.kernel.team import ALONE
from uwserver.sensors.base import Scope
from uwserver.sensors.voices import NO_VOICES, VOICE
from uwserver.sensors.wiring import ELECTRIC, Touch

HEAD = np.dtype(
    [
        ("body", "i8"),  # row of the body that carries it
        ("row", "i8"),  # its record among those of its kind
        ("first", "i8"),  # place of its reading in the array of numbers
        ("width", "i8"),
        ("exact_first", "i8"),  # place of the reading without errors; -1 if nobody reads that
        ("stream_first", "i8"),  # its own stream; further ones follow
        ("stream_count", "i8"),
        ("number", "i8"),  # readings made so far
        ("key", "u8"),  # key of its random numbers
        ("p", "f8", (3,)),  # p_BS, m
        ("q", "f8", (4,)),  # q_BS
        ("to_S", "f8", (4,)),  # inverse of q
        ("dt", "f8"),  # time between readings, s
        ("latency_ns", "i8"),
        ("exact", "i8"),  # 1: it has no errors of its own
        ("silent", "i8"),  # 1: a fault keeps it from reading
        ("rays", "i8"),  # most rays that it casts in a reading
        ("sees_own", "i8"),  # 1: the rays also meet the body that carries it
        ("voice", "i8"),  # row of its VOICE among those of all sonars; -1 if it sends no sound
        ("shadow", "i8"),  # 1: only the reading without errors is asked for, so it must not change the world
        # The last reading, as in `modifiers.Measurement`:
        ("ready", "i8"),  # 0: there was no reading
        ("valid", "i8"),
        ("exact_valid", "i8"),
        ("delay_ns", "i8"),
        ("since_ns", "i8"),
    ]
)
"""The head of a sensor: what the rows of all kinds have in common."""

PLACE = np.dtype(
    [
        ("gravity", "f8"),  # at the surface, m/s2
        ("growth", "f8"),  # relative growth of gravity with depth, 1/m
        ("rotating", "i8"),  # 1: the Earth turns and is round
        ("rate", "f8", (3,)),  # of the Earth's rotation at the origin, rad/s in N
        ("curvature", "f8", (2,)),  # of the Earth to the north and to the east, 1/m
        ("density", "f8"),  # the one that forces use, kg/m3
        ("ph", "f8"),
        ("atmosphere", "f8"),  # pressure at the surface, Pa
        ("current", "f8", (3,)),  # steady part of the water's velocity, m/s in N
        ("moves", "i8"),  # 1: there is a sea, which adds to the steady current
        ("latitude", "f8"),  # of the origin of N, rad
        ("longitude", "f8"),
        ("declination", "f8"),  # magnetic, rad
        ("magnetic", "f8", (4, 3)),  # field at the origin in N, and its change north, east and down (T, T/m)
        ("epoch_ns", "i8"),  # UTC of t = 0
        ("t_ns", "i8"),  # simulation time of this instant
    ]
)
"""The place of the world on the Earth, and its water without the water column."""

FORMS: Forms = {
    "state": columns(np.float64, STATE_SIZE),
    "nu_dot": columns(np.float64, 6),
    "tau": columns(np.float64, 6),
    "bodies": BODY,
    "thrusters": THRUSTER,
    "electrics": ELECTRIC,
    "lags": LAG,
    "place": PLACE,
    "lambert": columns(np.float64),
    "column": columns(np.float64, 6),
    "uniform": columns(np.float64),
    "profiles": columns(np.float64, PROFILE_SIZE),
    "waves": columns(np.float64, WAVE_SIZE),
    "team": columns(np.int64),
    "touching": columns(np.int64, 2),  # the contacts, which are a table themselves (`physics.contact.touching`)
    "voices": VOICE,  # of all sonars
}
"""The arrays of the table `surroundings`."""


def water_arrays(water: Water) -> dict[str, Any]:
    """Return the arrays of the water, by their names in `FORMS`."""
    rows = water.sea.rows if water.sea is not None else None
    nothing = np.zeros(7), np.zeros((0, PROFILE_SIZE)), np.zeros((0, WAVE_SIZE))
    uniform, profiles, waves = (rows.uniform, rows.profiles, rows.waves) if rows is not None else nothing
    return {"column": water.column.table, "uniform": uniform, "profiles": profiles, "waves": waves}


def place_row(water: Water, earth: Earth) -> Any:
    """Return the PLACE (1) of a world."""
    place = np.zeros(1, PLACE)
    row = place[0]
    row["gravity"], row["density"], row["atmosphere"] = water.gravity, water.density, water.atmospheric_pressure
    row["growth"], row["rotating"] = water.growth, earth.rotating
    row["rate"], row["curvature"] = earth.rate, earth.curvature
    row["current"], row["ph"] = water.current, water.column.ph
    row["moves"] = water.sea is not None
    row["latitude"], row["longitude"], row["epoch_ns"] = earth.latitude, earth.longitude, earth.epoch_ns
    row["declination"], row["magnetic"] = earth.declination, earth.magnetic
    return place


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
