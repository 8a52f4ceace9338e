"""The ports of an autopilot for set points."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from uwserver.actuators.base import Given
from uwserver.autopilot import route
from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.state import NAN, STILL
from uwserver.autopilot.sticks import wrapped
from uwserver.ports import Field

TEST_TIMEOUT_S = 0.5
"""A test of the actuators ends after this time without a command, as in ArduSub."""
_FAR = 1e6
_DEEP = 12_000.0

Part = tuple[float, ...] | None
"""One field of a command; None if it was left out."""


def _keep() -> None:
    """Keep the set point: it has no watchdog."""


@dataclass(frozen=True)
class SetPoint:
    """The actuator of a port for set points. A command changes the orders of the autopilot.

    Attributes:
        fields, doc: of the port.
        take: carries out a command; it gets the fields as arguments.
        neutral: carries out the watchdog.
    """

    fields: tuple[Field, ...]
    doc: str
    take: Callable[..., None]
    neutral: Callable[[], None] = _keep

    def apply(self, value: Given) -> None:
        """Carry out a command."""
        if any(part is not None for part in value):
            self.take(*value)


def set_points(pilot: Autopilot) -> Iterator[tuple[str, SetPoint]]:
    """Yield the names and the actuators of all ports for set points."""
    for name, make in _MAKERS.items():
        yield name, make(pilot)


def _pilot(pilot: Autopilot) -> SetPoint:
    axes = "surge, sway, heave (down positive), roll, pitch, yaw; 1 is full stick"
    return SetPoint(
        (Field("u", "1", axes, "", (6,), minimum=-1.0, maximum=1.0),),
        "The pilot's sticks. They act on the axes that the mode leaves free, and move the set points that it holds; without a command "
        "they return to neutral.",
        pilot.steer, pilot.lose_pilot,
    )  # fmt: skip


def _depth(pilot: Autopilot) -> SetPoint:
    def take(depth: tuple[float]) -> None:
        o = pilot.orders
        (o.depth,) = depth
        route.leave_bottom(o)
        route.give(o, "depth")
        if o.mode == "guided":
            pilot.preempt("a depth was commanded")

    fields = (Field("depth", "m", "below the surface, positive down", minimum=-_FAR, maximum=_DEEP),)
    return SetPoint(fields, "Depth to hold, until the mode changes.", take)


def _altitude(pilot: Autopilot) -> SetPoint:
    def take(altitude: tuple[float]) -> None:
        (pilot.orders.altitude,) = altitude
        route.give(pilot.orders, "altitude")

    fields = (Field("altitude", "m", "above the bottom", minimum=0.0, maximum=_DEEP),)
    return SetPoint(fields, "Altitude to hold, until the mode changes.", take)


def _heading(pilot: Autopilot) -> SetPoint:
    def take(heading: Part, rate: Part) -> None:
        o = pilot.orders
        o.turn, o.turn_limit, o.looks = NAN, math.inf, False
        if heading is not None:
            o.heading = wrapped(heading[0])
            if rate is not None:
                o.turn_limit = abs(rate[0])
        elif rate is not None:
            o.turn = rate[0] or NAN
        route.give(o, "heading")

    fields = (
        Field("heading", "rad", "to hold, from north, clockwise", minimum=-100.0, maximum=100.0),
        Field("rate", "rad/s", "without a heading: keep turning at this rate, 0 stops; with a heading: the largest rate of the turn",
              minimum=-10.0, maximum=10.0),
    )  # fmt: skip
    return SetPoint(fields, "Heading to hold, or a rate of turn, until the mode changes.", take)


def _attitude(pilot: Autopilot) -> SetPoint:
    def take(q: Part, heave: Part) -> None:
        o = pilot.orders
        pilot.preempt("an attitude was commanded")
        o.frame = ""
        if q is not None:
            norm = math.hypot(*q)
            w, x, y, z = q
            o.attitude = (w / norm, x / norm, y / norm, z / norm)
        if heave is not None:
            (o.heave,) = heave

    def stop() -> None:
        if pilot.orders.attitude is not None:
            pilot.hold()

    fields = (
        Field("q_NB", "1", "attitude to hold, w x y z; normalised", "NB", (4,), minimum=-_FAR, maximum=_FAR),
        Field("heave", "1", "vertical speed, part of the largest; 0 holds the depth", minimum=-1.0, maximum=1.0),
    )
    return SetPoint(
        fields,
        "Attitude to hold in mode guided; without a command the vehicle stops and holds where it is.",
        take,
        stop,
    )


def _velocity(pilot: Autopilot) -> SetPoint:
    def take(v_B: Part, v_N: Part, yaw_rate: Part, heading: Part) -> None:
        o = pilot.orders
        pilot.preempt("a velocity was commanded")
        o.attitude, o.looks = None, False
        if v_B is not None:
            o.velocity, o.frame = (v_B[0], v_B[1], v_B[2]), "B"
        elif v_N is not None:
            o.velocity, o.frame = (v_N[0], v_N[1], v_N[2]), "N"
        elif not o.frame:
            o.velocity, o.frame = STILL, "N"
        if yaw_rate is not None:
            o.turn = yaw_rate[0] or NAN
        if heading is not None:
            o.heading, o.turn = wrapped(heading[0]), NAN
        route.give(o, "heading")

    def stop() -> None:
        o = pilot.orders
        if o.frame:
            o.turn, o.velocity, o.frame = NAN, STILL, "N"

    fields = (
        Field("v_B", "m/s", "over ground, along the vehicle's axes when level", "B", (3,), minimum=-20.0, maximum=20.0),
        Field("v_N", "m/s", "over ground; v_B takes precedence", "N", (3,), minimum=-20.0, maximum=20.0),
        Field("yaw_rate", "rad/s", "to turn with", minimum=-10.0, maximum=10.0),
        Field("heading", "rad", "to hold; takes precedence over yaw_rate", minimum=-100.0, maximum=100.0),
    )
    return SetPoint(
        fields, "Velocity over ground in modes velocity and guided; without a command the vehicle stops.", take, stop
    )


def _position(pilot: Autopilot) -> SetPoint:
    def take(p: Part, heading: Part) -> None:
        o = pilot.orders
        pilot.preempt("a position was commanded")
        if p is not None:
            keep = o.heading if heading is None else wrapped(heading[0])
            route.leave_bottom(o)
            route.set_course(o, pilot.estimate, (p[0], p[1], p[2]), keep, None, o.radius)
        elif heading is not None:
            o.heading, o.looks = wrapped(heading[0]), False
            route.give(o, "heading")

    fields = (
        Field("p_N", "m", "place of the body origin", "N", (3,), minimum=-_FAR, maximum=_FAR),
        Field("heading", "rad", "to hold; default: the present one", minimum=-100.0, maximum=100.0),
    )
    return SetPoint(fields, "Place to hold in modes position_hold and guided, until the mode changes.", take)


def _test(pilot: Autopilot) -> SetPoint:
    names = pilot.spec.names
    return SetPoint(
        (Field("outputs", "1", "parts of the full commands", "", (len(names),), minimum=-1.0, maximum=1.0),),
        "Tests the actuators that the autopilot commands, instead of controlling the vehicle; after half a second without a command it disarms. "
        f"Order: {', '.join(names)}.",
        pilot.test, pilot.end_test,
    )  # fmt: skip


_MAKERS = {
    "pilot": _pilot, "depth": _depth, "altitude": _altitude, "heading": _heading, "attitude": _attitude, "velocity": _velocity,
    "position": _position, "test": _test,
}  # fmt: skip
