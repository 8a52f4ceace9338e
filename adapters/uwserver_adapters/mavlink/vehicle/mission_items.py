"""Converts mission items between MAVLink and the autopilot. An item that the vehicle cannot do is refused, never silently left out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal

from msgspec import Struct

from uwserver.frames import Vec3
from uwserver.ports import Json
from uwserver_adapters.mavlink.vehicle.bridge import Home
from uwserver_adapters.mavlink.vehicle.setpoints import GLOBAL_FRAMES, LOCAL_NED
from uwserver_adapters.mavlink.wire.codec import degrees_e7, finite, vec3
from uwserver_adapters.mavlink.wire.dialect import Entry, MavlinkMessage

Result = Literal[
    "ACCEPTED", "ERROR", "DENIED", "UNSUPPORTED", "UNSUPPORTED_FRAME", "NO_SPACE", "OPERATION_CANCELLED", "INVALID", "INVALID_SEQUENCE",
    "INVALID_PARAM1", "INVALID_PARAM2", "INVALID_PARAM5_X", "INVALID_PARAM7",
]  # fmt: skip
"""A MAV_MISSION_RESULT without its prefix."""
LARGEST = 700
"""Items of the longest mission."""
WAYPOINT, LAND, NAV_DELAY = "MAV_CMD_NAV_WAYPOINT", "MAV_CMD_NAV_LAND", "MAV_CMD_NAV_DELAY"
SPEED, YAW = "MAV_CMD_DO_CHANGE_SPEED", "MAV_CMD_CONDITION_YAW"
_LOITER, _LOITER_TIME = "MAV_CMD_NAV_LOITER_UNLIM", "MAV_CMD_NAV_LOITER_TIME"
TAKEOFF = "MAV_CMD_NAV_TAKEOFF"
"""QGroundControl begins each mission with a take-off. A submarine has nothing to do for it, and ArduSub goes on to the next item."""
_WITH_PLACE = (WAYPOINT, _LOITER, _LOITER_TIME)
_NO_HEADING_DEG = (0.0, 999.0)
"""Headings that ground stations send for "none", besides NaN: zero, and 999 from Cockpit."""
GLOBAL, NO_PLACE = "MAV_FRAME_GLOBAL", "MAV_FRAME_MISSION"
"""Frames with the altitude above the sea, and of items without a place."""
TERRAIN = "MAV_FRAME_GLOBAL_TERRAIN_ALT"
_TERRAIN_FRAMES = (TERRAIN, "MAV_FRAME_GLOBAL_TERRAIN_ALT_INT")
"""Frames with the altitude above the bottom."""
_FOREVER_S = 1e6
"""The longest hold that the autopilot accepts: more than eleven days."""


class Item(Struct, frozen=True):
    """One item as it was uploaded.

    Attributes:
        seq: its number.
        frame, command: names and numbers.
        params: the first four parameters.
        x, y: 1e-7 degrees, or 1e-4 m in a local frame.
        z: m, up positive except in local frames.
        autocontinue: kept for the download.
    """

    seq: int
    frame: Entry
    command: Entry
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    autocontinue: int = 1

    def fields(self) -> dict[str, int | float]:
        """Return the fields of MISSION_ITEM_INT, except the addressee."""
        names = ("param1", "param2", "param3", "param4")
        frame, command = self.frame.number, self.command.number
        base = {"seq": self.seq, "frame": frame, "command": command, "autocontinue": self.autocontinue}
        return {**base, **dict(zip(names, self.params, strict=True)), "x": self.x, "y": self.y, "z": self.z}


class BadItem(Exception):
    """An item cannot be accepted. Holds the result for the acknowledgement, and a text."""

    def __init__(self, result: Result, text: str) -> None:
        super().__init__(text)
        self.result: Result = result


def item_of(message: MavlinkMessage) -> Item:
    """Return the item of a MISSION_ITEM_INT, or of the older MISSION_ITEM with degrees as floats.

    As in ArduPilot, x, y and z matter only where the command has a place: MAVSDK sends NaN with others.

    Raises:
        BadItem: a coordinate of a place is not a number.
    """
    frame, command = message.entry("frame"), message.entry("command")
    x, y, z = (message.number(axis) for axis in "xyz")
    if command.name in _WITH_PLACE and not all(map(math.isfinite, (x, y, z))):
        raise BadItem("INVALID_PARAM5_X", f"item {message.integer('seq')}: its place is not a number")
    x, y = finite(x) or 0.0, finite(y) or 0.0
    if message.name == "MISSION_ITEM":
        scale = 1e4 if frame.name == LOCAL_NED else 1e7
        x, y = max(-2e9, min(2e9, x * scale)), max(-2e9, min(2e9, y * scale))
    p1, p2, p3, p4 = (message.number(f"param{k}") for k in range(1, 5))
    seq, autocontinue = message.integer("seq"), message.integer("autocontinue")
    return Item(seq, frame, command, (p1, p2, p3, p4), round(x), round(y), z, autocontinue)


def translate(item: Item, home: Home) -> Json:
    """Return an item for the autopilot.

    Neither for take-offs, which are left out, nor for the first uploaded item, which is home, as in ArduPilot.

    Raises:
        BadItem: the item cannot be accepted.
    """
    p1, p2, _, p4 = item.params
    command = item.command.name
    if command in (WAYPOINT, _LOITER, _LOITER_TIME):
        waypoint: dict[str, Json] = {"kind": "waypoint", **_where(item, home)}
        if command == WAYPOINT and p2 > 0.0:
            waypoint["radius_m"] = p2
        if math.isfinite(p4) and abs(p4) not in _NO_HEADING_DEG and command == WAYPOINT:
            waypoint["heading_deg"] = p4
        hold = _FOREVER_S if command == _LOITER else p1
        if math.isfinite(hold) and hold > 0.0:
            waypoint["hold_s"] = min(hold, _FOREVER_S)
        return waypoint
    if command in (NAV_DELAY, "MAV_CMD_CONDITION_DELAY"):
        return {"kind": "hold", "time_s": _positive(item, p1, "INVALID_PARAM1", allow_zero=True)}
    if command == SPEED:
        return {"kind": "speed", "speed_mps": _positive(item, p2, "INVALID_PARAM2")}
    if command == YAW:
        if not math.isfinite(p1) or p4 != 0.0:
            raise BadItem("INVALID_PARAM1", f"item {item.seq}: a heading must be a number of degrees from north")
        return {"kind": "heading", "heading_deg": p1}
    if command == LAND:
        return {"kind": "surface"}
    if command == "MAV_CMD_NAV_RETURN_TO_LAUNCH":
        if home.home is None or home.origin is None:
            raise BadItem("INVALID", f"item {item.seq}: home is not known")
        north, east = home.origin.north_east(home.home.latitude, home.home.longitude)
        return {"kind": "waypoint", "position_ned_m": [north, east, -home.home.altitude]}
    raise BadItem("UNSUPPORTED", f"item {item.seq}: command {item.command.number} is not supported in a mission")


def _where(item: Item, home: Home) -> dict[str, Json]:
    """Return the keys of a waypoint that hold its place."""
    if item.frame.name not in _TERRAIN_FRAMES:
        return {"position_ned_m": list(place_of(item, home))}
    if not item.z > 0.0:
        raise BadItem("INVALID_PARAM7", f"item {item.seq}: {item.z:g} m is no altitude above the bottom")
    north, east, _ = _point(item, home, is_relative=False)
    return {"position_ne_m": [north, east], "altitude_m": item.z}


def place_of(item: Item, home: Home) -> Vec3:
    """Return the place of an item in N, m.

    Raises:
        BadItem: its frame or place cannot be used, or the origin is not known.
    """
    if item.frame.name == LOCAL_NED:
        return item.x / 1e4, item.y / 1e4, item.z
    if item.frame.name not in GLOBAL_FRAMES:
        raise BadItem("UNSUPPORTED_FRAME", f"item {item.seq}: frame {item.frame.number} is not supported")
    return _point(item, home, GLOBAL_FRAMES[item.frame.name])


def _point(item: Item, home: Home, is_relative: bool) -> Vec3:
    if home.origin is None:
        raise BadItem("INVALID", f"item {item.seq}: the origin is not known, send SET_GPS_GLOBAL_ORIGIN")
    point = home.point(item.x, item.y, item.z, is_relative)
    if point is None:
        raise BadItem("INVALID_PARAM5_X", f"item {item.seq}: there is no such latitude or longitude")
    return point


def _positive(item: Item, value: float, result: Result, allow_zero: bool = False) -> float:
    if not math.isfinite(value) or value < 0.0 or (value == 0.0 and not allow_zero):
        raise BadItem(result, f"item {item.seq}: {value:g} is no time or speed")
    return value


def home_item(home: Home, entry: Callable[[str], Entry]) -> Item:
    """Return the first item of a mission for the download: home.

    Args:
        home: the origin and home.
        entry: returns the entry of a name in the dialect.
    """
    at = home.home
    x, y = (0, 0) if at is None else (round(degrees_e7(at.latitude)), round(degrees_e7(at.longitude)))
    return Item(0, entry(GLOBAL), entry(WAYPOINT), (0.0,) * 4, x, y, 0.0 if at is None else at.altitude)


def untranslated(seq: int, item: Mapping[str, Json], home: Home, entry: Callable[[str], Entry]) -> Item:
    """Return an item for the download from one of the autopilot, which a scenario or another adapter has set.

    Without an origin its place is in the local frame.

    Args:
        seq: its number; home is 0.
        item: the autopilot's item.
        home: the origin and home.
        entry: returns the entry of a name in the dialect.
    """

    def number(key: str) -> float:
        return finite(item.get(key)) or 0.0

    kind = item.get("kind")
    without_place: dict[str, tuple[str, str, tuple[float, float, float, float]]] = {
        "hold": (NO_PLACE, NAV_DELAY, (number("time_s"), -1.0, -1.0, -1.0)),
        "speed": (NO_PLACE, SPEED, (0.0, number("speed_mps"), -1.0, 0.0)),
        "heading": (NO_PLACE, YAW, (number("heading_deg"), 0.0, 0.0, 0.0)),
        "surface": (GLOBAL, LAND, (0.0, 0.0, 0.0, 0.0)),
    }
    if isinstance(kind, str) and kind in without_place:
        frame, command, params = without_place[kind]
        return Item(seq, entry(frame), entry(command), params, 0, 0, 0.0)
    flat = item.get("position_ne_m")
    given = [*flat, number("depth_m")] if isinstance(flat, list) else item.get("position_ned_m")
    north, east, down = vec3(given) or (0.0, 0.0, 0.0)
    params = (number("hold_s"), number("radius_m"), 0.0, number("heading_deg"))
    there = home.place((north, east, down))
    over_bottom = "altitude_m" in item
    if there is None:
        down = math.nan if over_bottom else down  # no local frame has an altitude above the bottom
        return Item(seq, entry(LOCAL_NED), entry(WAYPOINT), params, round(north * 1e4), round(east * 1e4), down)
    x, y = round(degrees_e7(there.latitude)), round(degrees_e7(there.longitude))
    if over_bottom:
        return Item(seq, entry(TERRAIN), entry(WAYPOINT), params, x, y, number("altitude_m"))
    return Item(seq, entry(GLOBAL), entry(WAYPOINT), params, x, y, there.altitude)
