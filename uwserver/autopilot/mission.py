"""Missions: their items, as a client gives them in JSON."""

from __future__ import annotations

import math
import re
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


class _Item(Struct, tag_field="kind", frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One step of a mission."""


class Waypoint(_Item, tag="waypoint", frozen=True):
    """Go there, within `radius_m` (default: what the vehicle can do), then stay for `hold_s`. Without `heading_deg` it looks where it goes."""

    position_ned_m: tuple[Coordinate, Coordinate, Coordinate]
    radius_m: Annotated[float, Meta(gt=0, le=1e4)] | None = None
    speed_mps: Speed | None = None
    heading_deg: Degrees | None = None
    hold_s: Seconds = 0.0


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


def shown_items(items: tuple[Item, ...]) -> Json:
    """The items as a client gave them; what stands at its default is left out."""
    return cast(Json, msgspec.json.decode(msgspec.json.encode(items)))
