"""The arrays of sensors in compiled code: the head of each sensor, and the table `surroundings` of what they see of the world."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.physics.kernel.layout import BODY, LAG, PROFILE_SIZE, STATE_SIZE, THRUSTER, WAVE_SIZE, Forms, columns
from uwserver.sensors.voices import VOICE
from uwserver.sensors.wiring import ELECTRIC

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
