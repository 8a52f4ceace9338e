"""The services of an autopilot."""

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
