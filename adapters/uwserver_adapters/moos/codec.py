"""The conventional variables of MOOS and uSimMarine, in degrees, east and north; inside are N, B and radians."""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec import Struct

from uwserver.adapter.earth import latitude_longitude
from uwserver.frames import Quat, Vec3, quat_from_rpy, rotate, rpy_from_quat
from uwserver.units import NANOSECONDS
from uwserver.units import deg as deg  # for the modules beside this one: only a codec converts units
from uwserver.units import rad as rad

Pairs = list[tuple[str, float | str]]

_TURN = 2 * math.pi


class Fix(Struct, kw_only=True):
    """The present state of the vehicle; None for values that are not known.

    Attributes:
        p_N: position in N, m.
        q_NB: attitude.
        v_B: velocity over ground in B, m/s.
        v_water_B: velocity through the water in B, m/s, where it is measured.
        flow_B: velocity of the water in B, m/s.
        depth: measured depth below the surface, m.
        altitude: measured altitude above the bottom, m.
        water_depth: depth of the bottom, m.
        t_ns: simulation time of the position.
    """

    p_N: Vec3 | None = None
    q_NB: Quat | None = None
    v_B: Vec3 | None = None
    v_water_B: Vec3 | None = None
    flow_B: Vec3 | None = None
    depth: float | None = None
    altitude: float | None = None
    water_depth: float | None = None
    t_ns: int = -1

    @property
    def below(self) -> float | None:
        """Depth below the surface, m: the measured one, else from the position."""
        return self.p_N[2] if self.depth is None and self.p_N is not None else self.depth

    @property
    def rpy(self) -> Vec3 | None:
        """Roll, pitch (nose up) and yaw, rad."""
        return None if self.q_NB is None else rpy_from_quat(self.q_NB)


def speed_through_water(fix: Fix) -> float | None:
    """Return the surge through the water, m/s: over ground where the water's velocity is not known, None where nothing is known."""
    if fix.v_water_B is not None:
        return fix.v_water_B[0]
    if fix.v_B is None:
        return None
    return fix.v_B[0] - (fix.flow_B[0] if fix.flow_B is not None else 0.0)


def navigation(fix: Fix, prefix: str, origin_deg: tuple[float, float] | None) -> Pairs:
    """Return the conventional set of variables, of what is known.

    X is east and Y north, DEPTH and SPEED are in m and m/s, HEADING in degrees clockwise from north, ROLL and PITCH (nose up) in rad. YAW is in rad
    counter-clockwise from north, as uSimMarine has it. SPEED is the surge through the water, never negative, as a helm expects it.
    """
    pairs: Pairs = []
    depth, altitude = fix.below, fix.altitude
    if fix.p_N is not None:
        north, east, _ = fix.p_N
        pairs += [("X", east), ("Y", north)]
        if origin_deg is not None:
            pairs += zip(("LAT", "LONG"), geodetic(north, east, origin_deg), strict=True)
    if fix.rpy is not None:
        roll, pitch, yaw = fix.rpy
        pairs += [("HEADING", compass(yaw)), ("YAW", -yaw), ("PITCH", pitch), ("ROLL", roll)]
    speed = speed_through_water(fix)
    if speed is not None:
        pairs.append(("SPEED", max(speed, 0.0)))
    if fix.v_B is not None and fix.q_NB is not None:
        v_n, v_e, _ = rotate(fix.q_NB, fix.v_B)
        pairs += [("SPEED_OVER_GROUND", math.hypot(v_n, v_e)), ("HEADING_OVER_GROUND", compass(math.atan2(v_e, v_n)))]
    if depth is not None:
        pairs += [("DEPTH", depth), ("Z", -depth)]
        if altitude is None and fix.water_depth is not None:
            altitude = max(fix.water_depth - depth, 0.0)
    if altitude is not None:
        pairs.append(("ALTITUDE", altitude))
    return [(f"{prefix}_{name}", value) for name, value in pairs]


def compass(yaw: float) -> float:
    """Return the heading, degrees in [0, 360), of a yaw angle (rad)."""
    return deg(yaw % _TURN) % deg(_TURN)


def geodetic(north: float, east: float, origin_deg: tuple[float, float]) -> tuple[float, float]:
    """Return latitude and longitude (degrees) of a place in the tangent plane of an origin, on the ellipsoid WGS 84."""
    latitude, longitude = latitude_longitude(north, east, rad(origin_deg[0]), rad(origin_deg[1]))
    return deg(latitude), deg(longitude)


def turned(heading: float) -> float:
    """Return a difference of headings (degrees) within [-180, 180]."""
    return math.remainder(heading, deg(_TURN))


TEXT_LIMIT = 256
"""Longest text with a few numbers that is read, characters."""


def _parts(text: str) -> list[str]:
    if len(text) > TEXT_LIMIT:
        raise ValueError(f"a text of {len(text)} characters: at most {TEXT_LIMIT} are read")
    return [part.strip() for part in text.split(",")]


_RESET_KEYS: Mapping[str, str] = {
    "x": "x", "y": "y", "heading": "heading", "hdg": "heading", "deg": "heading", "speed": "speed", "spd": "speed", "depth": "depth", "dep": "depth",
}  # fmt: skip
_RESET_ORDER = ("x", "y", "heading", "speed", "depth")
_RESET_ADVICE = "write x=10,y=-5,heading=90,speed=1,depth=2, or these five numbers in this order"


class ResetPose(Struct, frozen=True):
    """The pose that a USM_RESET gives the vehicle: level, and at rest except for the surge.

    Attributes:
        p_N: position in N, m.
        yaw: rad.
        speed: surge over ground, m/s.
    """

    p_N: Vec3
    yaw: float
    speed: float

    def command(self) -> Mapping[str, list[float]]:
        """Return the fields of a teleport command."""
        return {
            "p_NB": list(self.p_N),
            "q_NB": list(quat_from_rpy(0.0, 0.0, self.yaw)),
            "v_NB_B": [self.speed, 0.0, 0.0],
            "w_NB_B": [0.0, 0.0, 0.0],
        }


def pose_of(fix: Fix) -> ResetPose:
    """Return where the vehicle is; its speed is not kept."""
    return ResetPose(fix.p_N or (0.0, 0.0, 0.0), 0.0 if fix.rpy is None else fix.rpy[2], 0.0)


def reset_pose(text: str, base: ResetPose) -> ResetPose:
    """Parse a USM_RESET.

    It is ``x=10,y=-5,heading=90,speed=1,depth=2``, also with uSimMarine's short keys (`hdg`, `deg`, `spd`, `dep`), or these numbers in this order, of
    which the last ones may be missing. What is missing stays as in `base`.

    Raises:
        ValueError: it cannot be read as a whole; the text says what is wrong.
    """
    found: dict[str, float] = {}
    for index, part in enumerate(_parts(text.strip().rstrip(","))):
        name, equals, number = part.partition("=")
        if not equals and index < len(_RESET_ORDER):
            name, number = _RESET_ORDER[index], name
        key = _RESET_KEYS.get(name.strip().lower())
        if key is None or key in found:
            raise ValueError(f'"{part[:40]}": {_RESET_ADVICE}')
        found[key] = finite(number)
    north, east, down = base.p_N
    return ResetPose(
        (found.get("y", north), found.get("x", east), found.get("depth", down)),
        rad(found["heading"]) if "heading" in found else base.yaw,
        found.get("speed", base.speed),
    )


def drift(text: str) -> tuple[float, float]:
    """Return north and east components (m/s) of ``direction,speed``: the direction to which the water flows, in degrees clockwise from north, and its
    speed, m/s.

    Raises:
        ValueError: the text says what is wrong.
    """
    parts = _parts(text)
    if len(parts) != 2:
        raise ValueError(f'"{text[:40]}": write direction,speed as in 90,0.5')
    angle, speed = rad(finite(parts[0])), finite(parts[1])
    return speed * math.cos(angle), speed * math.sin(angle)


def seconds(t_ns: int) -> float:
    """Return seconds of nanoseconds."""
    return t_ns / NANOSECONDS


def period_ns(rate_hz: float) -> int:
    """Return the period of a rate, ns."""
    return round(NANOSECONDS / rate_hz)


def finite(text: str) -> float:
    """Return the finite number in a text. Raises ValueError where it is none."""
    try:
        number = float(text) if len(text) <= TEXT_LIMIT else math.nan
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f'"{text.strip()[:40]}" is no finite number')
    return number
