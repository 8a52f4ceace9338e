"""The set points that an autopilot takes by ports of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from uwserver.autopilot import route
from uwserver.autopilot.allocation import Given
from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.state import NAN, STILL
from uwserver.autopilot.sticks import wrapped
from uwserver.ports import Field

TEST_TIMEOUT_S = 0.5
"""Without a command a test of the actuators ends; that of ArduSub too."""
_FAR = 1e6
_DEEP = 12_000.0


@dataclass(frozen=True)
class SetPoint:
    """An actuator that is no device: a command changes the autopilot's orders."""

    fields: tuple[Field, ...]
    doc: str
    apply: Callable[[Given], None]
    neutral: Callable[[], None]


def set_points(pilot: Autopilot) -> Iterator[tuple[str, SetPoint]]:
    """All of them by name."""
    yield "pilot", _pilot(pilot)
    yield "depth", _depth(pilot)
    yield "altitude", _altitude(pilot)
    yield "heading", _heading(pilot)
    yield "attitude", _attitude(pilot)
    yield "velocity", _velocity(pilot)
    yield "position", _position(pilot)
    yield "test", _test(pilot)


def _nothing() -> None:
    """A set point without watchdog stands."""


def _pilot(pilot: Autopilot) -> SetPoint:
    def apply(value: Given) -> None:
        (u,) = value
        if u is not None:
            pilot.steer(u)

    doc = (
        "The pilot's sticks. They act on the axes that the mode leaves free, and move the set points that it holds; without a command "
        "they spring back."
    )
    axes = "surge, sway, heave (down positive), roll, pitch, yaw; 1 is full stick"
    field = Field("u", "1", axes, "", (6,), minimum=-1.0, maximum=1.0)
    return SetPoint((field,), doc, apply, pilot.lose_pilot)


def _depth(pilot: Autopilot) -> SetPoint:
    def apply(value: Given) -> None:
        (depth,) = value
        if depth is not None:
            (pilot.orders.depth,) = depth
            pilot.seat.leave_bottom()
            route.give(pilot.orders, "depth")
            if pilot.orders.mode == "guided":
                pilot.preempt("a depth was commanded")

    field = Field("depth", "m", "below the surface, positive down", minimum=-_FAR, maximum=_DEEP)
    return SetPoint((field,), "Depth to hold; it stands until the mode changes.", apply, _nothing)


def _altitude(pilot: Autopilot) -> SetPoint:
    def apply(value: Given) -> None:
        (altitude,) = value
        if altitude is not None:
            (pilot.orders.altitude,) = altitude
            route.give(pilot.orders, "altitude")

    field = Field("altitude", "m", "above the bottom", minimum=0.0, maximum=_DEEP)
    return SetPoint((field,), "Altitude to hold; it stands until the mode changes.", apply, _nothing)


def _heading(pilot: Autopilot) -> SetPoint:
    def apply(value: Given) -> None:
        heading, rate = value
        o = pilot.orders
        o.turn, o.turn_limit, o.looks = NAN, math.inf, False
        if heading is not None:
            o.heading = wrapped(heading[0])
            route.give(pilot.orders, "heading")
            if rate is not None:
                o.turn_limit = abs(rate[0])
        elif rate is not None:
            o.turn = rate[0] if rate[0] else NAN
            route.give(pilot.orders, "heading")

    fields = (
        Field("heading", "rad", "to hold, from north, clockwise", minimum=-100.0, maximum=100.0),
        Field("rate", "rad/s", "alone: keep turning at this rate, 0 stops; with a heading: the largest rate of the turn",
              minimum=-10.0, maximum=10.0),
    )  # fmt: skip
    return SetPoint(fields, "Heading to hold, or a rate of turn; it stands until the mode changes.", apply, _nothing)


def _attitude(pilot: Autopilot) -> SetPoint:
    def apply(value: Given) -> None:
        q, heave = value
        o = pilot.orders
        pilot.preempt("an attitude was commanded")
        o.frame = ""
        if q is not None:
            norm = math.hypot(*q)
            w, x, y, z = q
            o.attitude = (w / norm, x / norm, y / norm, z / norm)
        if heave is not None:
            (o.heave,) = heave

    def neutral() -> None:
        if pilot.orders.attitude is not None:
            pilot.hold()

    fields = (
        Field("q_NB", "1", "attitude to hold, w x y z; normalised", "NB", (4,), minimum=-_FAR, maximum=_FAR),
        Field("heave", "1", "vertical speed, part of the largest; 0 holds the depth", minimum=-1.0, maximum=1.0),
    )
    doc = "Attitude to hold in mode guided; without a command the vehicle stops and holds where it is."
    return SetPoint(fields, doc, apply, neutral)


def _velocity(pilot: Autopilot) -> SetPoint:
    def apply(value: Given) -> None:
        v_B, v_N, yaw_rate, heading = value
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
            o.turn = yaw_rate[0] if yaw_rate[0] else NAN
        if heading is not None:
            o.heading, o.turn = wrapped(heading[0]), NAN
        route.give(pilot.orders, "heading")

    def neutral() -> None:
        o = pilot.orders
        if o.frame:
            o.turn = NAN
            o.velocity, o.frame = STILL, "N"

    fields = (
        Field("v_B", "m/s", "over ground, along the vehicle's axes when level", "B", (3,), minimum=-20.0, maximum=20.0),
        Field("v_N", "m/s", "over ground; v_B takes precedence", "N", (3,), minimum=-20.0, maximum=20.0),
        Field("yaw_rate", "rad/s", "to turn with", minimum=-10.0, maximum=10.0),
        Field("heading", "rad", "to hold; takes precedence over yaw_rate", minimum=-100.0, maximum=100.0),
    )
    doc = "Velocity over ground in modes velocity and guided; without a command the vehicle stops."
    return SetPoint(fields, doc, apply, neutral)


def _position(pilot: Autopilot) -> SetPoint:
    def apply(value: Given) -> None:
        p, heading = value
        o = pilot.orders
        pilot.preempt("a position was commanded")
        if p is not None:
            keep = o.heading if heading is None else wrapped(heading[0])
            pilot.seat.leave_bottom()
            pilot.seat.set_course((p[0], p[1], p[2]), keep, None, o.radius)
        elif heading is not None:
            o.heading, o.looks = wrapped(heading[0]), False
            route.give(pilot.orders, "heading")

    fields = (
        Field("p_N", "m", "place of the body origin", "N", (3,), minimum=-_FAR, maximum=_FAR),
        Field("heading", "rad", "to hold; default: the present one", minimum=-100.0, maximum=100.0),
    )
    doc = "Place to hold in modes position_hold and guided; it stands until the mode changes."
    return SetPoint(fields, doc, apply, _nothing)


def _test(pilot: Autopilot) -> SetPoint:
    def apply(value: Given) -> None:
        (outputs,) = value
        if outputs is not None:
            pilot.test(outputs)

    doc = (
        "Tests the actuators that the autopilot holds, instead of controlling the vehicle; half a second without a command disarms it. "
        f"Order: {', '.join(pilot.craft.names)}."
    )
    size = len(pilot.craft.names)
    field = Field("outputs", "1", "parts of the full commands", "", (size,), minimum=-1.0, maximum=1.0)
    return SetPoint((field,), doc, apply, pilot.end_test)
