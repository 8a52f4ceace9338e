"""The way to a place, and the items of a mission: how each begins, and what comes after it. When it is done is found in `flight`."""

from __future__ import annotations

import math

from uwserver.autopilot import flight
from uwserver.autopilot.bank import Seat
from uwserver.autopilot.craft import Craft
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.mission import Hold, Item, SetHeading, SetSpeed, Surface, Waypoint
from uwserver.autopilot.state import Estimate, Orders, SetPointName
from uwserver.autopilot.sticks import wrapped
from uwserver.ports import Refused
from uwserver.units import rad

_KINDS = {
    Waypoint: flight.WAYPOINT, Hold: flight.HOLD, SetSpeed: flight.SPEED, SetHeading: flight.HEADING, Surface: flight.COME_UP,
}  # fmt: skip


def kind_of(item: Item) -> tuple[int, float]:
    """Code of an item's kind, and how long the vehicle stays there, s."""
    lasts = item.hold_s if isinstance(item, Waypoint) else item.time_s if isinstance(item, Hold) else 0.0
    return _KINDS[type(item)], lasts


def check_altitude(where: Waypoint, craft: Craft, gains: Gains, at: str, key: str) -> None:
    """Refuse an altitude that a vehicle cannot keep.

    Args:
        where: to go to.
        craft, gains: of the vehicle.
        at, key: for the text: which item, and what is refused.

    Raises:
        Refused: it sees no bottom, cannot dive, or shall not go so near.
    """
    if where.altitude_m is None:
        return
    if not craft.sees_bottom:
        text = "altitude_m needs a sensor of kind altimeter or dvl in the vehicle: give depth_m instead"
        raise Refused("denied", at + text, key)
    if not craft.dives:
        raise Refused("denied", f"{at}altitude_m is for vehicles that dive: give depth_m instead", key)
    if where.altitude_m < gains.min_altitude_m:
        text = f"altitude_m = {where.altitude_m:g} is below the gain min_altitude_m of this vehicle, {gains.min_altitude_m:g}"
        raise Refused("out_of_range", at + text, key)


def give(o: Orders, *names: SetPointName) -> None:
    """These set points were given."""
    given = o.given
    if not all(name in given for name in names):
        o.given = tuple(sorted({*given, *names}))


def set_altitude(o: Orders, e: Estimate, altitude: float, sees_bottom: bool) -> None:
    """Go there at this altitude (m): at a depth that follows the bottom. While that is not seen, the depth is that of the place."""
    o.altitude = altitude
    give(o, "altitude")
    if sees_bottom:
        depth = min(e.bottom - max(altitude, o.gains.min_altitude_m), o.gains.max_depth_m)
        o.place, o.depth = (o.place[0], o.place[1], depth), depth


def go(
    seat: Seat, where: Waypoint, heading: float | None, speed: float | None, radius: float, sees_bottom: bool
) -> None:
    """Go to the place of a waypoint (`Seat.set_course`) at its depth or altitude. `sees_bottom`: the altitude is known."""
    o, e = seat.orders, seat.estimate
    north, east, down = where.place
    last = o.depth if "depth" in o.given else e.p[2]
    if where.altitude_m is None:
        seat.leave_bottom()
    seat.set_course((north, east, last if down is None else down), heading, speed, radius)
    if where.altitude_m is not None:
        set_altitude(o, e, where.altitude_m, sees_bottom)


def distance(o: Orders, e: Estimate) -> float:
    """To the place, m; depth counts."""
    return math.dist(e.p, o.place)


def begin(seat: Seat, arrival_m: float, sees_bottom: bool) -> None:
    """Begin the item under way.

    Args:
        seat: of the vehicle.
        arrival_m: distance at which a waypoint counts as reached that names no radius.
        sees_bottom: the altitude is known.
    """
    o, e = seat.orders, seat.estimate
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
        go(seat, item, heading, speed, radius, sees_bottom)
        # From the last place, not from where its circle was entered: the lines are those of the plan.
        o.origin = begun if math.dist(begun, e.p) < 5.0 * max(radius, 1.0) else e.p
    elif isinstance(item, SetSpeed):
        o.pace = item.speed_mps
    elif isinstance(item, SetHeading):
        o.bound = o.heading = wrapped(rad(item.heading_deg))
        o.looks = False
    elif isinstance(item, Surface):
        seat.leave_bottom()
        o.depth = 0.0  # another than that of the place: the line there ends


def end(o: Orders) -> str:
    """The item under way is done; returns what there is to tell."""
    done = o.index
    o.reached += 1
    o.entered = False
    o.index = done + 1 if done + 1 < len(o.items) else -1
    return f"mission: all {len(o.items)} items done" if o.index < 0 else f"mission: item {done} done"
