"""The ports of an autopilot (its set points, and its state), and its services."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import cast

import msgspec
import numpy as np
from msgspec import structs

from uwserver.actuators.base import Given
from uwserver.autopilot import route
from uwserver.autopilot.config import Gains, Mode
from uwserver.autopilot.estimator import place_at
from uwserver.autopilot.mission import read_items, read_place, shown_items
from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.rows import MODES
from uwserver.autopilot.state import NAN, REASONS, STILL
from uwserver.autopilot.sticks import wrapped
from uwserver.modifiers.columns import columns_of
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Argument, Field, Json, Refused, Service, Value
from uwserver.ports.crossing import Later
from uwserver.sensors.base import IdealSensor, Scope, Writing
from uwserver.units import rad

TEST_TIMEOUT_S = 0.5
"""A test of the actuators ends after this time without a command, as in ArduSub."""
_FAR = 1e6
_DEEP = 12_000.0

Part = tuple[float, ...] | None
"""One field of a command; None if it was left out."""
TEXTS: tuple[tuple[Value, ...], ...] = tuple([(mode, reason) for mode in MODES for reason in REASONS])
"""All texts that a reading can have."""
_P_N = "place of the body origin in N"
_PLACE = Argument("position_ned_m", "float", _P_N, "m", shape=(3,), minimum=-_FAR, maximum=_FAR)
_THERE = (
    Argument("position_ned_m", "float", f"{_P_N}, with its depth", "m", False, shape=(3,), minimum=-_FAR, maximum=_FAR),
    Argument("position_ne_m", "float", "the same without the depth: then give depth_m or altitude_m", "m", False, shape=(2,), minimum=-_FAR,
             maximum=_FAR),
    Argument("depth_m", "float", "of position_ne_m", "m", False, minimum=-_FAR, maximum=_FAR),
    Argument("altitude_m", "float", "of position_ne_m, above the bottom, also on the way", "m", False, minimum=0.01, maximum=12_000.0),
)  # fmt: skip
_FORCE = Argument(
    "force", "bool", "arm even if a sensor is missing or there is water in the hull", required=False, default=False
)
_MODE = Argument("mode", "str", "what it holds", choices=MODES)
_HEADING = Argument(
    "heading_deg", "float", "heading on the way, in degrees; default: the direction of travel", required=False,
    minimum=-1e4, maximum=1e4,
)  # fmt: skip
_SPEED = Argument(
    "speed_mps", "float", "speed on the way; default: cruise_mps", "m/s", required=False, minimum=0.01, maximum=20.0
)
_ITEMS = Argument("items", "json", "list of waypoint, hold, speed, heading and surface items")
_FLOWN = Argument("items", "json", "of the mission; default: the present mission", required=False)
_INDEX = Argument("index", "int", "item to begin with", required=False, default=0, minimum=0, maximum=1e6)
_NAME = Argument("name", "str", "name of a gain, as in the reply of get_gains", choices=Gains.__struct_fields__)
_VALUE = Argument("value", "float", "in the unit that its name or its text says")


def _keep() -> None:
    """Keep the set point: it has no watchdog."""


@dataclass(frozen=True)
class SetPoint:
    """The actuator of a port for set points. A command changes the orders of the autopilot.

    Attributes:
        fields, doc: those of the port.
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


_STATE = (
    Field("mode", "1", "manual, stabilise, depth_hold ...", type="str"),
    Field("armed", "1", "it holds the actuators", type="bool"),
    Field("p_N", "m", "position of the body origin, estimated", "N", (3,)),
    Field("position_valid", "1", "the position is known or dead-reckoned", type="bool"),
    Field("v_N", "m/s", "velocity over ground, estimated", "N", (3,)),
    Field("velocity_valid", "1", "the velocity is measured", type="bool"),
    Field("q_NB", "1", "attitude, estimated, w x y z", "NB", (4,)),
    Field("w_B", "rad/s", "angular rate, measured", "B", (3,)),
    Field("depth", "m", "below the surface, estimated; nan when unknown"),
    Field("altitude", "m", "above the bottom, estimated; nan when unknown"),
    Field("p_ref_N", "m", "place to go to; nan when none", "N", (3,)),
    Field("depth_ref", "m", "depth to hold; nan when none"),
    Field("heading_ref", "rad", "heading to hold; nan when none"),
    Field("mission_index", "1", "item of the mission under way; -1 for none", type="int"),
    Field("mission_count", "1", "items of the mission", type="int"),
    Field("reached", "1", "items done since the mission was started", type="int"),
    Field("tau", "N, N m", "demanded force and moment about the body origin, in B", "", (6,)),
    Field("failsafe", "1", "why it does not do what it was told; empty when it does", type="str"),
)


class StateSensor(IdealSensor):
    """The estimate and the set points of an autopilot, as a sensor."""

    doc = "What the autopilot estimates from its sensors, and what it wants."
    writes = True

    def __init__(self, pilot: Autopilot) -> None:
        self._pilot = pilot
        names = pilot.spec.names
        doc = f"commands of its actuators, parts of their full commands: {', '.join(names)}"
        self.fields = (*_STATE, Field("outputs", "1", doc, "", (len(names),)))

    def begin(self, number: int) -> None:
        """Do nothing: it draws no random numbers."""

    def measure(self, scope: Scope | None) -> tuple[bool, list[Value]]:
        """Return the reading, which is always valid; its own fields say which parts are."""
        columns = columns_of(self.fields)
        row = np.zeros(columns.width)
        return True, list(columns.unpack(row, self.write(row)))

    def write(self, row: FloatArray) -> tuple[Value, ...]:
        """Write the numbers of the reading; see `Sensor.write`."""
        pilot = self._pilot
        return TEXTS[pilot.row.tell(pilot.t_ns, row)]

    @property
    def writing(self) -> Writing:  # type: ignore[override]  # its row may change
        """How compiled code writes the reading; see `Sensor.writing`."""
        return Writing(self._pilot.row.k, TEXTS)


Asked = Mapping[str, Json]
Answer = Callable[[Asked], Json | Later]


def services(pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    """Yield all services, each with the function that carries it out."""
    path = pilot.spec.path
    yield from _state(path, pilot)
    yield from _goto(path, pilot)
    yield from _missions(path, pilot)
    yield from _gains(path, pilot)


def _state(path: str, pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    def set_position(args: Asked) -> Json:
        north, east, down = cast("list[float]", args["position_ned_m"])
        place_at(pilot.estimate, north, east, None if pilot.known.depth else down)
        pilot.row.stay()
        return None

    yield (
        Service(f"{path}/arm", "Take over the actuators; commands from others are refused until disarm.", (_FORCE,)),
        lambda args: pilot.arm(bool(args["force"])),
    )
    yield Service(f"{path}/disarm", "Stop, and let others command the actuators."), lambda _: pilot.disarm()
    yield (
        Service(f"{path}/set_mode", "Begin a mode where the vehicle is; refused if a sensor that it needs is missing.", (_MODE,)),
        lambda args: pilot.set_mode(cast("Mode", args["mode"])),
    )  # fmt: skip
    yield (
        Service(f"{path}/set_position", "Correct dead reckoning: the vehicle is here. The depth is used only without a depth sensor.", (_PLACE,)),
        set_position,
    )  # fmt: skip


def _goto(path: str, pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    def goto(args: Asked) -> Later:
        heading, speed, radius = (cast("float | None", args[key]) for key in ("heading_deg", "speed_mps", "radius_m"))
        where = read_place({argument.name: args[argument.name] for argument in _THERE})
        return pilot.go(where, None if heading is None else wrapped(rad(heading)), speed, radius)

    def cancel_goto(_: Asked) -> Json:
        pilot.preempt("cancelled by the caller")
        if pilot.orders.mode == "guided":
            pilot.hold()
        return None

    near = f"distance at which it has arrived; default: {pilot.spec.arrival_m:g}"
    radius = Argument("radius_m", "float", near, "m", required=False, minimum=0.01, maximum=1e4)
    yield (
        Service(
            f"{path}/goto", "Go to a place, at a depth or at an altitude, in mode guided, and stay there; replies on arrival.",
            (_THERE[0], _HEADING, _SPEED, radius, *_THERE[1:]), long_running=True,
        ),
        goto,
    )  # fmt: skip
    yield Service(f"{path}/cancel_goto", "End the present goto, and hold where the vehicle is."), cancel_goto


def _missions(path: str, pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    def set_mission(args: Asked) -> Json:
        pilot.set_mission(read_items(args["items"]))
        return {"count": len(pilot.orders.items)}

    def get_mission(_: Asked) -> Json:
        o = pilot.orders
        return {"items": shown_items(o.items), "index": o.index, "reached": o.reached}

    def fly_mission(args: Asked) -> Later:
        given = args["items"]
        return pilot.fly(None if given is None else read_items(given), cast("int", args["index"]))

    def cancel_fly_mission(_: Asked) -> Json:
        if pilot.orders.mode == "mission":
            pilot.preempt("cancelled by the caller")
            pilot.set_mode("position_hold")
        return None

    yield (
        Service(f"{path}/set_mission", "Replace the mission; if anything is wrong with the new one, nothing changes.", (_ITEMS,)),
        set_mission,
    )  # fmt: skip
    yield (
        Service(f"{path}/get_mission", "The mission, the present item (-1 for none) and how many are done."),
        get_mission,
    )
    yield (
        Service(f"{path}/start_mission", "Begin mode mission with this item; the autopilot must be armed.", (_INDEX,)),
        lambda args: pilot.start_mission(cast("int", args["index"])),
    )
    yield (
        Service(
            f"{path}/fly_mission",
            "Fly a mission (items as for set_mission; default: the present mission) from this item on; replies when its last item is done.",
            (_FLOWN, _INDEX), long_running=True,
        ),
        fly_mission,
    )  # fmt: skip
    yield (
        Service(f"{path}/cancel_fly_mission", "End the present fly_mission, and hold where the vehicle is."),
        cancel_fly_mission,
    )
    yield (
        Service(f"{path}/clear_mission", "Remove the mission; a vehicle that flies it holds where it is."),
        lambda _: pilot.set_mission(()),
    )


def _gains(path: str, pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    def set_gain(args: Asked) -> Json:
        name = str(args["name"])
        try:
            gains = msgspec.convert({**structs.asdict(pilot.orders.gains), name: args["value"]}, Gains)
        except msgspec.ValidationError as error:
            raise Refused("out_of_range", f"{name}: {error}", "value") from None
        pilot.orders.gains = gains
        return None

    yield (
        Service(f"{path}/get_gains", "Gains, limits and time-outs in use, by name."),
        lambda _: structs.asdict(pilot.orders.gains),
    )
    yield Service(f"{path}/set_gain", "Change one of them, until the world is reset.", (_NAME, _VALUE)), set_gain
