"""The way to a place, and missions: what comes next, and when it is reached."""

from __future__ import annotations

import math
from typing import NamedTuple

from uwserver.autopilot.mission import Hold, Item, SetHeading, SetSpeed, Surface, Waypoint
from uwserver.autopilot.state import Estimate, Orders
from uwserver.autopilot.sticks import heading_of, wrapped
from uwserver.frames import Vec3
from uwserver.units import rad

_TURNED_RAD = 0.05
_SHORT_M = 0.5
"""Places nearer together than this have no line: the vehicle goes there straight."""


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


class Leg(NamedTuple):
    """The line to a place, seen from the vehicle.

    Attributes:
        towards: direction, in N.
        left: way to go along it, m; negative past the place.
        beside: from the vehicle to the nearest point of the line, m in N.
    """

    towards: Vec3
    left: float
    beside: Vec3


def leg(o: Orders, e: Estimate) -> Leg | None:
    """The line from `origin` to `place`; None where there is none: nothing began there, or another depth was told on the way."""
    (ax, ay, az), (bx, by, bz) = o.origin, o.place
    length = math.dist(o.origin, o.place)
    if not length > _SHORT_M or o.depth != bz:
        return None
    ux, uy, uz = (bx - ax) / length, (by - ay) / length, (bz - az) / length
    dx, dy, dz = bx - e.p[0], by - e.p[1], bz - e.p[2]
    left = dx * ux + dy * uy + dz * uz
    return Leg((ux, uy, uz), left, (dx - left * ux, dy - left * uy, dz - left * uz))


def distance(o: Orders, e: Estimate) -> float:
    """To the place, m; depth counts."""
    return math.dist(e.p, o.place)


def advance(o: Orders, e: Estimate, dt: float, flies: bool, up: float, arrival_m: float) -> str:
    """Go on with the mission; returns what there is to tell, "" for nothing.

    Args:
        o, e: orders, which are changed, and the estimate.
        dt: of a step, s.
        flies: the vehicle cannot stay in a place: it circles.
        up: nearer to the surface than this (m) it has come up.
        arrival_m: distance at which a waypoint counts as reached that names no radius.
    """
    if o.index < 0:
        return ""
    item = o.items[o.index]
    if not o.entered:
        o.entered, o.waited = True, 0.0
        _begin(o, e, item, arrival_m)
    if not _is_done(o, e, item, dt, flies, up):
        return ""
    o.reached += 1
    o.entered = False
    o.index += 1
    if o.index < len(o.items):
        return f"mission: item {o.index - 1} done"
    o.index = -1
    return f"mission: all {len(o.items)} items done"


def _begin(o: Orders, e: Estimate, item: Item, arrival_m: float) -> None:
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


def _is_done(o: Orders, e: Estimate, item: Item, dt: float, flies: bool, up: float) -> bool:
    if isinstance(item, Waypoint):
        if o.waited == 0.0 and distance(o, e) > o.radius:
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
