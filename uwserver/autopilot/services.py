"""What an autopilot can be asked to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import cast

import msgspec
from msgspec import structs

from uwserver.autopilot.estimator import place_at
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.mission import read_items, read_place, shown_items
from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.rows import MODES
from uwserver.autopilot.state import Mode
from uwserver.autopilot.sticks import wrapped
from uwserver.frames import Vec3
from uwserver.ports import Argument, Json, Refused, Service
from uwserver.ports.crossing import Later
from uwserver.units import rad

Asked = Mapping[str, Json]
Answer = Callable[[Asked], Json | Later]

_FAR = 1e6
_P_N = "place of the body origin in N"
_PLACE = Argument("position_ned_m", "float", _P_N, "m", shape=(3,), minimum=-_FAR, maximum=_FAR)
_THERE = (
    Argument("position_ned_m", "float", f"{_P_N}, with its depth", "m", False, shape=(3,), minimum=-_FAR, maximum=_FAR),
    Argument("position_ne_m", "float", "the same without: then give depth_m or altitude_m", "m", False, shape=(2,), minimum=-_FAR, maximum=_FAR),
    Argument("depth_m", "float", "of position_ne_m", "m", False, minimum=-_FAR, maximum=_FAR),
    Argument("altitude_m", "float", "of position_ne_m, above the bottom, also on the way", "m", False, minimum=0.01, maximum=12_000.0),
)  # fmt: skip
_ANYWAY = "arm even if a sensor is missing or there is water in the hull"
_FORCE = Argument("force", "bool", _ANYWAY, required=False, default=False)
_MODE = Argument("mode", "str", "what it holds", choices=MODES)
_HEADING = Argument(
    "heading_deg", "float", "heading on the way, in degrees; default: the direction of travel", required=False,
    minimum=-1e4, maximum=1e4,
)  # fmt: skip
_SPEED = Argument(
    "speed_mps", "float", "speed on the way; default: cruise_mps", "m/s", required=False, minimum=0.01, maximum=20.0
)
_ITEMS = Argument("items", "json", "list of waypoint, hold, speed, heading and surface items")
_FLOWN = Argument("items", "json", "of the mission; default: the one that is there", required=False)
_INDEX = Argument("index", "int", "item to begin with", required=False, default=0, minimum=0, maximum=1e6)
_NAME = Argument("name", "str", "as get_gains tells them", choices=Gains.__struct_fields__)
_VALUE = Argument("value", "float", "in the unit that its name or its text says")


def services(pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    """All of them with what they do."""
    path = pilot.craft.path
    yield from _state(path, pilot)
    yield from _ways(path, pilot)
    yield from _gains(path, pilot)


def _state(path: str, pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    def arm(args: Asked) -> Json:
        pilot.arm(bool(args["force"]))
        return None

    def disarm(_: Asked) -> Json:
        pilot.disarm()
        return None

    def set_mode(args: Asked) -> Json:
        pilot.set_mode(cast(Mode, args["mode"]))
        return None

    def set_position(args: Asked) -> Json:
        north, east, down = _vector(args["position_ned_m"])
        place_at(pilot.estimate, north, east, None if pilot.known.depth else down)
        pilot.moved()
        return None

    mode_doc = "Begin a mode, where the vehicle is; refused when a sensor that it needs is missing."
    place_doc = "Correct the dead reckoning: the vehicle is here. The depth is used only without a depth sensor."
    arm_doc = "Take over the actuators; commands from others are refused until disarm."
    yield Service(f"{path}/arm", arm_doc, (_FORCE,)), arm
    yield Service(f"{path}/disarm", "Stop, and let others command the actuators."), disarm
    yield Service(f"{path}/set_mode", mode_doc, (_MODE,)), set_mode
    yield Service(f"{path}/set_position", place_doc, (_PLACE,)), set_position


def _ways(path: str, pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    def goto(args: Asked) -> Later:
        heading, speed, radius = args["heading_deg"], args["speed_mps"], args["radius_m"]
        return pilot.go(
            read_place({argument.name: args[argument.name] for argument in _THERE}),
            None if heading is None else wrapped(rad(cast(float, heading))),
            None if speed is None else cast(float, speed),
            None if radius is None else cast(float, radius),
        )

    def cancel_goto(_: Asked) -> Json:
        pilot.preempt("cancelled by the caller")
        if pilot.orders.mode == "guided":
            pilot.hold()
        return None

    def set_mission(args: Asked) -> Json:
        pilot.set_mission(read_items(args["items"]))
        return {"count": len(pilot.orders.items)}

    def get_mission(_: Asked) -> Json:
        o = pilot.orders
        return {"items": shown_items(o.items), "index": o.index, "reached": o.reached}

    def start_mission(args: Asked) -> Json:
        pilot.start_mission(cast(int, args["index"]))
        return None

    def fly_mission(args: Asked) -> Later:
        given = args["items"]
        return pilot.fly(None if given is None else read_items(given), cast(int, args["index"]))

    def cancel_fly_mission(_: Asked) -> Json:
        if pilot.orders.mode == "mission":
            pilot.preempt("cancelled by the caller")
            pilot.set_mode("position_hold")
        return None

    def clear_mission(_: Asked) -> Json:
        pilot.set_mission(())
        return None

    near = f"distance at which it has arrived; default: {pilot.craft.arrival_m:g}"
    radius = Argument("radius_m", "float", near, "m", required=False, minimum=0.01, maximum=1e4)
    go = "Go to a place, at a depth or at an altitude, in mode guided, and stay; replies when it is there."
    put = "Replace the mission; if anything is wrong with the new one, nothing changes."
    show = "The mission, the item under way (-1 for none) and how many are done."
    begin = "Begin mode mission with this item; the autopilot must be armed."
    fly = "Fly a mission (items as for set_mission; default: the one that is there) from this item on; replies when its last item is done."
    leave = "End the fly_mission under way, and hold where the vehicle is."
    clear = "Remove the mission; a vehicle under way holds where it is."
    yield Service(f"{path}/goto", go, (_THERE[0], _HEADING, _SPEED, radius, *_THERE[1:]), long_running=True), goto
    yield Service(f"{path}/cancel_goto", "End the goto under way, and hold where the vehicle is."), cancel_goto
    yield Service(f"{path}/set_mission", put, (_ITEMS,)), set_mission
    yield Service(f"{path}/get_mission", show), get_mission
    yield Service(f"{path}/start_mission", begin, (_INDEX,)), start_mission
    yield Service(f"{path}/fly_mission", fly, (_FLOWN, _INDEX), long_running=True), fly_mission
    yield Service(f"{path}/cancel_fly_mission", leave), cancel_fly_mission
    yield Service(f"{path}/clear_mission", clear), clear_mission


def _gains(path: str, pilot: Autopilot) -> Iterator[tuple[Service, Answer]]:
    def get_gains(_: Asked) -> Json:
        return structs.asdict(pilot.orders.gains)

    def set_gain(args: Asked) -> Json:
        name, value = str(args["name"]), cast(float, args["value"])
        try:
            gains = msgspec.convert({**structs.asdict(pilot.orders.gains), name: value}, Gains)
        except msgspec.ValidationError as error:
            raise Refused("out_of_range", f"{name}: {error}", "value") from None
        pilot.orders.gains = gains
        return None

    yield Service(f"{path}/get_gains", "Gains, limits and time-outs in use, by name."), get_gains
    yield Service(f"{path}/set_gain", "Change one of them, until the world is reset.", (_NAME, _VALUE)), set_gain


def _vector(value: Json) -> Vec3:
    x, y, z = cast(list[float], value)
    return (x, y, z)
