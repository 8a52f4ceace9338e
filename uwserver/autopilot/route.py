"""The way to a place, and the items of a mission: how each begins, and what follows it. `flight` finds out when an item is done."""

from __future__ import annotations

import math

from uwserver.autopilot import flight
from uwserver.autopilot.config import Gains
from uwserver.autopilot.mission import Hold, Item, SetHeading, SetSpeed, Surface, Waypoint
from uwserver.autopilot.state import NAN, Estimate, Orders, SetPointName
from uwserver.autopilot.sticks import wrapped
from uwserver.autopilot.vehicle_spec import VehicleSpec
from uwserver.frames import Vec3
from uwserver.ports import Refused
from uwserver.units import rad

_KINDS = {
    Waypoint: flight.WAYPOINT, Hold: flight.HOLD, SetSpeed: flight.SPEED, SetHeading: flight.HEADING, Surface: flight.COME_UP,
}  # fmt: skip


def kind_of(item: Item) -> tuple[int, float]:
    """Return the code of the kind of an item, and the time that the vehicle stays there, s."""
    lasts = item.hold_s if isinstance(item, Waypoint) else item.time_s if isinstance(item, Hold) else 0.0
    return _KINDS[type(item)], lasts


def check_altitude(where: Waypoint, spec: VehicleSpec, gains: Gains, at: str, key: str) -> None:
    """Check that a vehicle can keep the altitude of a waypoint.

    Args:
        where: the waypoint.
        spec, gains: those of the vehicle.
        at: begin of the error text: which item.
        key: key of the error.

    Raises:
        Refused: the vehicle cannot see the bottom or cannot dive, or the altitude is less than the least of its gains.
    """
    if where.altitude_m is None:
        return
    if not spec.sees_bottom:
        text = "altitude_m needs a sensor of kind altimeter or dvl in the vehicle: give depth_m instead"
        raise Refused("denied", at + text, key)
    if not spec.dives:
        raise Refused("denied", f"{at}altitude_m is for vehicles that dive: give depth_m instead", key)
    if where.altitude_m < gains.min_altitude_m:
        text = f"altitude_m = {where.altitude_m:g} is below the gain min_altitude_m of this vehicle, {gains.min_altitude_m:g}"
        raise Refused("out_of_range", at + text, key)


def give(o: Orders, *names: SetPointName) -> None:
    """Note that a command has set these set points."""
    given = o.given
    if not all(name in given for name in names):
        o.given = tuple(sorted({*given, *names}))


def leave_bottom(o: Orders) -> None:
    """Let the depth no longer follow the bottom."""
    o.given = tuple([name for name in o.given if name != "altitude"])
    o.blind = False
    if o.failsafe == "sensor altitude":
        o.failsafe = ""


def set_course(o: Orders, e: Estimate, place: Vec3, heading: float | None, speed: float | None, radius: float) -> None:
    """Go to a place and its depth.

    Args:
        o, e: those of the vehicle.
        place: p_N, m.
        heading: rad; None: the bow points where the vehicle goes.
        speed: m/s; None: `cruise_mps` of the gains.
        radius: distance at which the vehicle has arrived, m.
    """
    o.origin, o.place, o.depth, o.radius = e.p, place, place[2], radius
    give(o, "depth", "heading", "place")
    o.looks = heading is None
    if heading is not None:
        o.heading = heading
    o.speed = o.gains.cruise_mps if speed is None else speed
    o.frame, o.attitude = "", None
    o.settled = o.astray = False
    o.turn, o.turn_limit = NAN, math.inf


def go(
    o: Orders,
    e: Estimate,
    where: Waypoint,
    heading: float | None,
    speed: float | None,
    radius: float,
    sees_bottom: bool,
) -> None:
    """Go to the place of a waypoint, at its depth or its altitude. The other arguments are those of `set_course`.

    At an altitude the depth follows the bottom. While the bottom is not seen (`sees_bottom` is false), the vehicle keeps its present depth.
    """
    north, east, down = where.place
    if down is None:
        down = o.depth if "depth" in o.given else e.p[2]
    if where.altitude_m is None:
        leave_bottom(o)
    else:
        o.altitude = where.altitude_m
        give(o, "altitude")
        if sees_bottom:
            down = min(e.bottom - max(where.altitude_m, o.gains.min_altitude_m), o.gains.max_depth_m)
    set_course(o, e, (north, east, down), heading, speed, radius)


def distance(o: Orders, e: Estimate) -> float:
    """Return the distance to the place, m; the depth counts."""
    return math.dist(e.p, o.place)


def begin(o: Orders, e: Estimate, arrival_m: float, sees_bottom: bool) -> None:
    """Begin the present item of the mission.

    Args:
        o, e: those of the vehicle.
        arrival_m: distance at which a waypoint without a radius counts as reached, m.
        sees_bottom: whether the altitude is known.
    """
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
        go(o, e, item, heading, speed, radius, sees_bottom)
        # The line begins at the last place, not where the vehicle has entered its circle, so that lines are those of the plan.
        o.origin = begun if math.dist(begun, e.p) < 5.0 * max(radius, 1.0) else e.p
    elif isinstance(item, SetSpeed):
        o.pace = item.speed_mps
    elif isinstance(item, SetHeading):
        o.bound = o.heading = wrapped(rad(item.heading_deg))
        o.looks = False
    elif isinstance(item, Surface):
        leave_bottom(o)
        o.depth = 0.0  # differs from the depth of the place, so the vehicle leaves the line there


def start(o: Orders, index: int) -> None:
    """Start the mission at an item; -1: do not fly it."""
    o.index, o.reached, o.pace, o.bound = index, 0, NAN, NAN


def end(o: Orders) -> str:
    """End the present item, and go on to the next one. Returns a text that reports it."""
    done = o.index
    o.reached += 1
    o.entered = False
    o.index = done + 1 if done + 1 < len(o.items) else -1
    return f"mission: all {len(o.items)} items done" if o.index < 0 else f"mission: item {done} done"
