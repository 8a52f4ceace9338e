"""Checks missions in files: our own (a JSON list), plans of QGroundControl (.plan), and waypoint files of ground stations (QGC WPL 110).

A vehicle takes plans over MAVLink. The commands and frames here are those that the adapter `mavlink` takes in a mission; a test compares them.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

from uwserver.autopilot.mission import MAX_ITEMS, read_items
from uwserver.ports import Refused
from uwserver.units import rad

COMMANDS = {
    16: "waypoint", 17: "waypoint", 19: "waypoint", 20: "return to launch", 21: "landing", 22: "take-off", 93: "delay", 112: "delay",
    115: "heading", 178: "speed",
}  # fmt: skip
"""What the commands of MAVLink (MAV_CMD) that a mission may hold are called, by number. A take-off is left out of the mission."""
PLACES = (16, 17, 19)
"""Those commands that go to a place."""
ABOVE_SURFACE, ABOVE_BOTTOM, LOCAL = (0, 3, 5, 6), (10, 11), (1,)
"""Frames of MAVLink (MAV_FRAME) of a place: with its height above the sea or above home (the surface), above the bottom, and north, east, down."""


class Item(NamedTuple):
    """One item of a plan: its number there, command, frame, and its seven parameters; those that are not given are NaN."""

    number: int
    command: int
    frame: int
    params: tuple[float, ...]

    @property
    def height(self) -> float:
        """The seventh parameter: height or depth of a place, m; NaN if it is not given."""
        return self.params[6] if len(self.params) > 6 else math.nan


class BadPlan(ValueError):
    """A file is not a mission of its format; the text says what is wrong."""


class Checked(NamedTuple):
    """What is in a mission file.

    Attributes:
        summary: how many items of which kind: ``3 items: 2 waypoints, 1 speed``.
        faults: what a vehicle would refuse.
        warnings: what it would take, but what is hardly meant.
    """

    summary: str
    faults: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def check_mission(text: str) -> Checked:
    """Check a mission as `set_mission` takes it: a JSON list of items.

    Raises:
        BadPlan: it is no JSON.
    """
    try:
        items = read_items(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise BadPlan(f"this is no JSON: {error}") from error
    except Refused as refused:
        return Checked("", (str(refused),))
    return Checked(_summary([str(item.__struct_config__.tag) for item in items]))


def check_plan(text: str) -> Checked:
    """Check a plan of QGroundControl.

    Raises:
        BadPlan: it is none.
    """
    try:
        return _checked(list(_items_of_plan(json.loads(text)["mission"]["items"])))
    except BadPlan:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadPlan(f"this is no plan: {type(error).__name__}: {error}") from error


def check_waypoints(text: str) -> Checked:
    """Check a file of waypoints: after the line ``QGC WPL 110`` twelve numbers a line.

    Raises:
        BadPlan: it is none.
    """
    items = []
    for number, line in enumerate(text.splitlines()[1:], 2):
        cells = line.split()
        if not cells:
            continue
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            values = []
        if len(values) != 12:
            raise BadPlan(
                f"line {number}: twelve numbers are needed: index, current, frame, command, p1 to p4, x, y, z, autocontinue"
            )
        items.append(Item(int(values[0]), int(values[3]), int(values[2]), tuple(values[4:11])))
    return _checked(items[1:])  # the first is home


def _items_of_plan(raw: Any) -> Iterator[Item]:
    for k, item in enumerate(raw, 1):
        if item.get("type") == "ComplexItem":
            inner = item.get("TransectStyleComplexItem", {}).get("Items")
            if inner is None:
                raise BadPlan(
                    f'item {k}: a "{item.get("complexItemType")}" without its waypoints: open the plan in QGroundControl, and save it again'
                )
            yield from _items_of_plan(inner)
            continue
        params = [math.nan if value is None else float(value) for value in item["params"]]
        yield Item(int(item.get("doJumpId", k)), int(item["command"]), int(item["frame"]), tuple(params))


def _checked(items: list[Item]) -> Checked:
    faults = [text for item in items for text in _faults(item)]
    if len(items) > MAX_ITEMS:
        faults.append(f"a mission has at most {MAX_ITEMS} items, this one has {len(items)}")
    high = [item for item in items if item.command in PLACES and item.frame in ABOVE_SURFACE and item.height > 0.0]
    warnings = [
        f"item {item.number}: {item.height:g} m is above the surface ({len(high)} such items): depths are negative altitudes"
        for item in high[:1]
    ]
    return Checked(_summary([COMMANDS.get(item.command, "other") for item in items]), tuple(faults), tuple(warnings))


def _faults(item: Item) -> Iterator[str]:
    if item.command not in COMMANDS:
        yield f"item {item.number}: command {item.command} is not supported in a mission"
        return
    if item.command not in PLACES:
        return
    if len(item.params) < 7 or not all(map(math.isfinite, item.params[4:7])):
        yield f"item {item.number}: its place is not a number"
        return
    x, y, z = item.params[4:7]
    if item.frame not in (*ABOVE_SURFACE, *ABOVE_BOTTOM, *LOCAL):
        yield f"item {item.number}: frame {item.frame} is not supported"
    elif item.frame not in LOCAL and not (abs(rad(x)) <= 0.5 * math.pi and abs(rad(y)) <= math.pi):
        yield f"item {item.number}: there is no such latitude or longitude"
    elif item.frame in ABOVE_BOTTOM and z <= 0.0:
        yield f"item {item.number}: {z:g} m is no altitude above the bottom"


def _summary(kinds: list[str]) -> str:
    counts = ", ".join(f"{count} {kind}{'s' * (count > 1)}" for kind, count in Counter(kinds).items())
    return f"{len(kinds)} item{'s' * (len(kinds) != 1)}{': ' * bool(counts)}{counts}"
