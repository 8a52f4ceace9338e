"""Missions: their items, as a client gives them in JSON."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, cast, get_args

import msgspec
from msgspec import Meta, Struct

from uwserver.ports import Json, Refused

MAX_ITEMS = 700
"""As many as ArduPilot stores on its usual boards. A longer mission would also make a message that takes too long to read."""
Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
Seconds = Annotated[float, Meta(ge=0, le=1e6)]
Speed = Annotated[float, Meta(gt=0, le=20)]
Degrees = Annotated[float, Meta(ge=-1e4, le=1e4)]
Altitude = Annotated[float, Meta(gt=0, le=12_000)]


class _Item(Struct, tag_field="kind", frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One step of a mission."""


class Waypoint(_Item, tag="waypoint", frozen=True):
    """Go to a place, to within `radius_m` (default: what the vehicle can do), then stay for `hold_s`. Without `heading_deg` the bow points where the
    vehicle goes.

    The place is `position_ned_m`, whose third number is the depth; or `position_ne_m` with exactly one of `depth_m` and `altitude_m` (above the
    bottom, also on the way there).
    """

    position_ned_m: tuple[Coordinate, Coordinate, Coordinate] | None = None
    position_ne_m: tuple[Coordinate, Coordinate] | None = None
    depth_m: Coordinate | None = None
    altitude_m: Altitude | None = None
    radius_m: Annotated[float, Meta(gt=0, le=1e4)] | None = None
    speed_mps: Speed | None = None
    heading_deg: Degrees | None = None
    hold_s: Seconds = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError if the keys of the place do not fit together."""
        if self.position_ned_m is not None:
            for key in ("position_ne_m", "depth_m", "altitude_m"):
                if getattr(self, key) is not None:
                    raise ValueError(f"position_ned_m holds a depth already: write position_ne_m beside {_BESIDE[key]}")
        elif self.position_ne_m is None:
            raise ValueError("a place is missing: position_ned_m, or position_ne_m with depth_m or altitude_m")
        elif (self.depth_m is None) == (self.altitude_m is None):
            how = "neither is given" if self.depth_m is None else "not both"
            raise ValueError(f"position_ne_m takes exactly one of depth_m and altitude_m: {how}")

    @property
    def place(self) -> tuple[float, float, float | None]:
        """North, east and depth (m); the depth is None if `altitude_m` is given."""
        if self.position_ned_m is not None:
            return self.position_ned_m
        assert self.position_ne_m is not None
        return (*self.position_ne_m, self.depth_m)


_BESIDE = {"position_ne_m": "depth_m or altitude_m", "depth_m": "depth_m", "altitude_m": "altitude_m"}


class Hold(_Item, tag="hold", frozen=True):
    """Stay for a time."""

    time_s: Seconds


class SetSpeed(_Item, tag="speed", frozen=True):
    """Set the speed for all later waypoints that have none."""

    speed_mps: Speed


class SetHeading(_Item, tag="heading", frozen=True):
    """Turn to a heading, and keep it on the way to later waypoints that have none."""

    heading_deg: Degrees


class Surface(_Item, tag="surface", frozen=True):
    """Come to the surface."""


Item = Waypoint | Hold | SetSpeed | SetHeading | Surface
_INDEX = re.compile(r"\$\[(\d+)\]")
"""The place in a list that an error of msgspec names."""
_KEYS = {str(item.__struct_config__.tag): item.__struct_fields__ for item in get_args(Item)}


def read_items(raw: Json) -> tuple[Item, ...]:
    """Return the items of a mission.

    Raises:
        Refused: `items` is not a list or is too long, or an item is wrong; the text names its number and key.
    """
    if not isinstance(raw, list):
        raise Refused("bad_argument", 'items must be a list of objects like {"kind": "waypoint", ...}', "items")
    if len(raw) > MAX_ITEMS:
        raise Refused("out_of_range", f"a mission has at most {MAX_ITEMS} items, not {len(raw)}", "items")
    try:
        # All in one call: one by one, the items of a long mission would take longer than a tick.
        return msgspec.convert(raw, tuple[Item, ...])
    except (msgspec.ValidationError, RecursionError) as error:
        at = _INDEX.search(str(error))
        first = int(at[1]) if at else 0
        return tuple(_read_item(k, item) for k, item in enumerate(raw[first:], first))


def _read_item(k: int, raw: Json) -> Item:
    """Return item k. Its errors are better than those of `read_items`: they name what is allowed."""
    if isinstance(raw, dict):
        for key, value in raw.items():
            numbers = value if isinstance(value, list) else [value]
            if any(isinstance(number, float) and not math.isfinite(number) for number in numbers):
                raise Refused("not_finite", f"item {k}: {str(key)[:80]} is no finite number", f"items[{k}]")
        kind, text = raw.get("kind"), ""
        if isinstance(kind, str) and kind in _KEYS:
            unknown = [str(key) for key in raw if key not in ("kind", *_KEYS[kind])]
            if unknown:
                takes = ", ".join(_KEYS[kind]) or "none"
                text = f'item {k}: a {kind} has no key "{unknown[0][:80]}"; it takes: {takes}'
        elif "kind" in raw:
            text = f'item {k}: unknown kind "{str(kind)[:80]}"; there are: {", ".join(_KEYS)}'
        if text:
            raise Refused("bad_argument", text, f"items[{k}]")
    try:
        return cast(Item, msgspec.convert(raw, Item))
    except (msgspec.ValidationError, RecursionError) as error:
        text = str(error).replace("Object", "it").replace("`", "")
        raise Refused("bad_argument", f"item {k}: {text}", f"items[{k}]") from None


def read_place(given: Mapping[str, Json]) -> Waypoint:
    """Return the place that the arguments of a call give; they are keys of a waypoint, or None.

    Raises:
        Refused: they do not fit together; the text names the key.
    """
    try:
        return msgspec.convert({"kind": "waypoint", **{k: v for k, v in given.items() if v is not None}}, Waypoint)
    except msgspec.ValidationError as error:
        raise Refused("bad_argument", str(error).replace("`", ""), "position_ned_m") from None


def shown_items(items: tuple[Item, ...]) -> Json:
    """Return the items as a client gave them, without the keys that have their defaults."""
    return cast(Json, msgspec.json.decode(msgspec.json.encode(items)))
