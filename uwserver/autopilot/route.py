"""The way to a place, and missions: what comes next, and when it is reached."""

from __future__ import annotations

import math

from uwserver.autopilot.mission import Hold, Item, SetHeading, SetSpeed, Surface, Waypoint
from uwserver.autopilot.state import Estimate, Orders
from uwserver.autopilot.sticks import heading_of, wrapped
from uwserver.frames import Vec3
from uwserver.units import rad

_TURNED_RAD = 0.05


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


def advance(o: Orders, e: Estimate, dt: float, flies: bool, up: float) -> str:
    """Go on with the mission; returns what there is to tell, "" for nothing.

    Args:
        o, e: orders, which are changed, and the estimate.
        dt: of a step, s.
        flies: the vehicle cannot stay in a place: it circles.
        up: nearer to the surface than this (m) it has come up.
    """
    if o.index < 0:
        return ""
    item = o.items[o.index]
    if not o.entered:
        o.entered, o.waited = True, 0.0
        _begin(o, e, item)
    if not _is_done(o, e, item, dt, flies, up):
        return ""
    o.reached += 1
    o.entered = False
    o.index += 1
    if o.index < len(o.items):
        return f"mission: item {o.index - 1} done"
    o.index = -1
    return f"mission: all {len(o.items)} items done"


def _begin(o: Orders, e: Estimate, item: Item) -> None:
    if isinstance(item, Waypoint):
        heading = None if item.heading_deg is None else wrapped(rad(item.heading_deg))
        if heading is None and o.bound == o.bound:
            heading = o.bound
        speed = item.speed_mps
        if speed is None and o.pace == o.pace:
            speed = o.pace
        begun = o.place if o.reached or "place" in o.given else e.p
        set_course(o, e, item.position_ned_m, heading, speed, item.radius_m)
        # From the last place, not from where its circle was entered: the lines are those of the plan.
        o.origin = begun if math.dist(begun, e.p) < 5.0 * max(item.radius_m, 1.0) else e.p
    elif isinstance(item, SetSpeed):
        o.pace = item.speed_mps
    elif isinstance(item, SetHeading):
        o.bound = o.heading = wrapped(rad(item.heading_deg))
        o.looks = False
    elif isinstance(item, Surface):
        o.depth = 0.0


def _is_done(o: Orders, e: Estimate, item: Item, dt: float, flies: bool, up: float) -> bool:
    if isinstance(item, Waypoint):
        if o.waited == 0.0 and distance(o, e) > item.radius_m:
            return False
        o.waited += dt
        o.settled = True
        return o.waited >= item.hold_s
    if isinstance(item, Hold):
        o.waited += dt
        return o.waited >= item.time_s
    if isinstance(item, SetHeading):
        return flies or abs(wrapped(o.heading - heading_of(e))) < _TURNED_RAD
    if isinstance(item, Surface):
        return e.p[2] < up
    return True
