"""The way to a place, and the items of a mission: how each begins, and what comes after it. When it is done is found in `flight`."""

from __future__ import annotations

import math

from uwserver.autopilot import flight
from uwserver.autopilot.mission import Hold, Item, SetHeading, SetSpeed, Surface, Waypoint
from uwserver.autopilot.state import Estimate, Orders
from uwserver.autopilot.sticks import wrapped
from uwserver.frames import Vec3
from uwserver.units import rad

_KINDS = {
    Waypoint: flight.WAYPOINT, Hold: flight.HOLD, SetSpeed: flight.SPEED, SetHeading: flight.HEADING, Surface: flight.COME_UP,
}  # fmt: skip


def kind_of(item: Item) -> tuple[int, float]:
    """Code of an item's kind, and how long the vehicle stays there, s."""
    lasts = item.hold_s if isinstance(item, Waypoint) else item.time_s if isinstance(item, Hold) else 0.0
    return _KINDS[type(item)], lasts


def set_course(o: Orders, e: Estimate, place: Vec3, heading: float | None, speed: float | None, radius: float) -> None:
    """Go to a place (p_N, m), with a heading (rad) or looking where it goes; the depth is that of the place."""
    o.origin, o.place, o.depth = e.p, place, place[2]
    o.given = tuple(sorted({*o.given, "place", "depth", "heading"}))
    o.looks = heading is None
    if heading is not None:
        o.heading = heading
    o.radius = radius
    o.speed = o.gains.cruise_mps if speed is None else speed
    o.frame, o.attitude = "", None
    o.settled = o.astray = False
    o.turn, o.turn_limit = math.nan, math.inf


def distance(o: Orders, e: Estimate) -> float:
    """To the place, m; depth counts."""
    return math.dist(e.p, o.place)


def begin(o: Orders, e: Estimate, arrival_m: float) -> None:
    """Begin the item under way. `arrival_m`: distance at which a waypoint counts as reached that names no radius."""
    item = o.items[o.index]
    o.entered, o.waited = True, 0.0
    if isinstance(item, Waypoint):
        radius = arrival_m if item.radius_m is None else item.radius_m
        heading = None if item.heading_deg is None else wrapped(rad(item.heading_deg))
        if heading is None and o.bound == o.bound:
            heading = o.bound
        speed = item.speed_mps
        if speed is None and o.pace == o.pace:
            speed = o.pace
        begun = o.place if o.reached or "place" in o.given else e.p
        set_course(o, e, item.position_ned_m, heading, speed, radius)
        # From the last place, not from where its circle was entered: the lines are those of the plan.
        o.origin = begun if math.dist(begun, e.p) < 5.0 * max(radius, 1.0) else e.p
    elif isinstance(item, SetSpeed):
        o.pace = item.speed_mps
    elif isinstance(item, SetHeading):
        o.bound = o.heading = wrapped(rad(item.heading_deg))
        o.looks = False
    elif isinstance(item, Surface):
        o.depth = 0.0  # another than that of the place: the line there ends


def end(o: Orders) -> str:
    """The item under way is done; returns what there is to tell."""
    done = o.index
    o.reached += 1
    o.entered = False
    o.index = done + 1 if done + 1 < len(o.items) else -1
    return f"mission: all {len(o.items)} items done" if o.index < 0 else f"mission: item {done} done"
