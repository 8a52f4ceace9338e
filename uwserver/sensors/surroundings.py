"""What sensors in compiled code see of the world, as arrays: the table `now`, and how place and water are written into it."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.physics.kernel.layout import BODY, LAG, PROFILE_SIZE, STATE_SIZE, THRUSTER, WAVE_SIZE, Forms, columns
from uwserver.sensors.voices import VOICE
from uwserver.sensors.wiring import ELECTRIC

PLACE = np.dtype(
    [
        ("gravity", "f8"),  # m/s2 at the surface
        ("growth", "f8"),  # of gravity with depth, relative, 1/m
        ("rotating", "i8"),  # 1: the Earth turns and is round
        ("rate", "f8", (3,)),  # of the Earth at the origin, rad/s in N
        ("curvature", "f8", (2,)),  # of the Earth to the north and to the east, 1/m
        ("density", "f8"),  # kg/m3, which forces act with
        ("ph", "f8"),
        ("atmosphere", "f8"),  # Pa at the surface
        ("current", "f8", (3,)),  # steady part of the water's velocity in N, m/s
        ("moves", "i8"),  # 1: there is a sea, with more than that
        ("latitude", "f8"),  # of the origin of N, rad
        ("longitude", "f8"),
        ("declination", "f8"),  # magnetic, rad
        ("magnetic", "f8", (4, 3)),  # field at the origin in N, and its change north, east and down (T, T/m)
        ("epoch_ns", "i8"),  # UTC of t = 0
        ("t_ns", "i8"),  # simulation time of this instant
    ]
)
"""Where the world is, and its water but for its column."""

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
    "touching": columns(np.int64, 2),  # the contacts, a table again (`physics.contact.touching`)
    "voices": VOICE,  # of all sonars
}
"""Of the table `now`."""


def water_arrays(water: Water) -> dict[str, Any]:
    """Arrays of the water, by the names of `FORMS`."""
    rows = water.sea.rows if water.sea is not None else None
    nothing = np.zeros(7), np.zeros((0, PROFILE_SIZE)), np.zeros((0, WAVE_SIZE))
    uniform, profiles, waves = (rows.uniform, rows.profiles, rows.waves) if rows is not None else nothing
    return {"column": water.column.table, "uniform": uniform, "profiles": profiles, "waves": waves}


def place_row(water: Water, earth: Earth) -> Any:
    """The PLACE of a world."""
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
