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
"""As many as ArduPilot keeps on its usual boards; the message that brings them stays below what one may cost."""
Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
Seconds = Annotated[float, Meta(ge=0, le=1e6)]
Speed = Annotated[float, Meta(gt=0, le=20)]
Degrees = Annotated[float, Meta(ge=-1e4, le=1e4)]
Altitude = Annotated[float, Meta(gt=0, le=12_000)]


class _Item(Struct, tag_field="kind", frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One step of a mission."""


class Waypoint(_Item, tag="waypoint", frozen=True):
    """Go there, within `radius_m` (default: what the vehicle can do), then stay for `hold_s`. Without `heading_deg` it looks where it goes.

    The place is `position_ned_m`, whose third number is its depth; or `position_ne_m` with exactly one of `depth_m` and `altitude_m` (above the
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
        """ValueError where the keys of its place do not go together."""
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
        """North, east and depth (m); None for the depth where `altitude_m` says it."""
        if self.position_ned_m is not None:
            return self.position_ned_m
        assert self.position_ne_m is not None
        return (*self.position_ne_m, self.depth_m)


_BESIDE = {"position_ne_m": "depth_m or altitude_m", "depth_m": "depth_m", "altitude_m": "altitude_m"}


class Hold(_Item, tag="hold", frozen=True):
    """Stay for a time."""

    time_s: Seconds


class SetSpeed(_Item, tag="speed", frozen=True):
    """Speed of all waypoints from here on that name none."""

    speed_mps: Speed


class SetHeading(_Item, tag="heading", frozen=True):
    """Turn there, and keep it on the way to waypoints that name none."""

    heading_deg: Degrees


class Surface(_Item, tag="surface", frozen=True):
    """Come up."""


Item = Waypoint | Hold | SetSpeed | SetHeading | Surface
_INDEX = re.compile(r"\$\[(\d+)\]")
"""Where msgspec says that a list is wrong."""
_KEYS = {str(item.__struct_config__.tag): item.__struct_fields__ for item in get_args(Item)}


def read_items(raw: Json) -> tuple[Item, ...]:
    """The items of a mission.

    Raises:
        Refused: `items` is no list, too long, or an item has a fault; the text names its number and key.
    """
    if not isinstance(raw, list):
        raise Refused("bad_argument", 'items must be a list of objects like {"kind": "waypoint", ...}', "items")
    if len(raw) > MAX_ITEMS:
        raise Refused("out_of_range", f"a mission has at most {MAX_ITEMS} items, not {len(raw)}", "items")
    try:
        return msgspec.convert(
            raw, tuple[Item, ...]
        )  # all at once: one by one, a long mission takes longer than a tick
    except (msgspec.ValidationError, RecursionError) as error:
        at = _INDEX.search(str(error))
        first = int(at[1]) if at else 0
        return tuple(_read_item(k, item) for k, item in enumerate(raw[first:], first))


def _read_item(k: int, raw: Json) -> Item:
    if isinstance(raw, dict):
        for key, value in raw.items():
            for number in value if isinstance(value, list) else [value]:
                if isinstance(number, float) and not math.isfinite(number):
                    raise Refused("not_finite", f"item {k}: {str(key)[:80]} is no finite number", f"items[{k}]")
        kind = raw.get("kind")
        if isinstance(kind, str) and kind in _KEYS:
            for key in raw:
                if key != "kind" and key not in _KEYS[kind]:
                    takes = ", ".join(_KEYS[kind]) or "none"
                    text = f'item {k}: a {kind} has no key "{str(key)[:80]}"; it takes: {takes}'
                    raise Refused("bad_argument", text, f"items[{k}]")
        elif "kind" in raw:
            text = f'item {k}: unknown kind "{str(kind)[:80]}"; there are: {", ".join(_KEYS)}'
            raise Refused("bad_argument", text, f"items[{k}]")
    try:
        return cast(Item, msgspec.convert(raw, Item))
    except (msgspec.ValidationError, RecursionError) as error:
        text = str(error).replace("Object", "it").replace("`", "")
        raise Refused("bad_argument", f"item {k}: {text}", f"items[{k}]") from None


def read_place(given: Mapping[str, Json]) -> Waypoint:
    """Where to go, as the arguments of a call say it: those of a waypoint that are not None.

    Raises:
        Refused: they do not go together; the text names the key.
    """
    try:
        return msgspec.convert({"kind": "waypoint", **{k: v for k, v in given.items() if v is not None}}, Waypoint)
    except msgspec.ValidationError as error:
        raise Refused("bad_argument", str(error).replace("`", ""), "position_ned_m") from None


def shown_items(items: tuple[Item, ...]) -> Json:
    """The items as a client gave them; what stands at its default is left out."""
    return cast(Json, msgspec.json.decode(msgspec.json.encode(items)))
