"""Actions: what of the world takes long, tells how far it is, and can be cancelled, in ROS' words. Long-running services are their source."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from uwserver.ports import Fault, Json, Service
from uwserver_adapters.ros.messages.codec import heading_deg
from uwserver_adapters.ros.messages.commands import pose_in_map
from uwserver_adapters.ros.messages.entities import result_of
from uwserver_adapters.ros.messages.services import Ask, json_value
from uwserver_adapters.ros.messages.source import ros_name
from uwserver_adapters.ros.messages.types import BadMessage, Types

EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 2, 3, 4, 5, 6
"""Of action_msgs/GoalStatus."""
GOTO, MISSION, STEPS = (
    "uwserver_msgs/action/Goto",
    "uwserver_msgs/action/Mission",
    "simulation_interfaces/action/SimulateSteps",
)


@dataclass(frozen=True)
class Action:
    """An action.

    Attributes:
        name: of the action.
        type: ``package/action/Name``.
        ask: what a goal asks for; raises `BadMessage`.
        result: of a reply of the world.
        feedback: of a goal, when a part of it (0..1) is done.
    """

    name: str
    type: str
    ask: Callable[[Any], Ask]
    result: Callable[[Json, Fault | None], object]
    feedback: Callable[[Any, float], object]


def actions(types: Types, services: Iterable[Service]) -> Iterator[Action]:
    """All actions of a world; ROS 1 has none.

    Args:
        types: of the distribution.
        services: ours.
    """
    if types.is_ros1:
        return
    for service in services:
        levels = service.path.split("/")
        if levels[1:] == ["autopilot", "goto"]:
            yield _goto(types, service.path, "/" + ros_name(levels[0]))
        elif levels[1:] == ["autopilot", "fly_mission"]:
            yield _mission(types, service.path, "/" + ros_name(levels[0]))
        elif service.path == "world/step":
            yield _steps(types)


def end_of(fault: Fault | None, is_cancelled: bool) -> int:
    """Status of a goal whose call was answered."""
    if fault is None:
        return SUCCEEDED
    return CANCELED if is_cancelled and fault.code == "preempted" else ABORTED


def _goto(types: Types, service: str, vehicle: str) -> Action:
    def ask(goal: Any) -> Ask:
        place, heading = pose_in_map(goal.pose)
        args: dict[str, object] = {"position_ned_m": list(place)}
        if heading is not None:
            args["heading_deg"] = heading_deg(heading)
        # What is 0 was not given: neither a speed nor a radius can be.
        args |= {key: value for key, value in (("speed_mps", goal.speed), ("radius_m", goal.radius)) if value != 0.0}
        return Ask(service, args)

    def result(found: Json, fault: Fault | None) -> object:
        away = found.get("distance_m") if isinstance(found, dict) else None
        distance = away if isinstance(away, float | int) else math.nan
        return types.make(f"{GOTO}_Result", success=fault is None, message=_why(fault), distance=float(distance))

    return Action(f"{vehicle}/goto", GOTO, ask, result, lambda _, part: types.make(f"{GOTO}_Feedback", progress=part))


def _mission(types: Types, service: str, vehicle: str) -> Action:
    def ask(goal: Any) -> Ask:
        args: dict[str, object] = {"index": goal.first}
        if goal.poses and goal.items:
            raise BadMessage("give poses or items, not both")
        if goal.poses:
            args["items"] = [_waypoint(pose) for pose in goal.poses]
        elif goal.items:
            args["items"] = json_value(goal.items, "items")
        return Ask(service, args)

    def result(found: Json, fault: Fault | None) -> object:
        reached = found.get("reached") if isinstance(found, dict) else None
        reached = reached if isinstance(reached, int) else 0
        return types.make(f"{MISSION}_Result", success=fault is None, message=_why(fault), reached=reached)

    return Action(
        f"{vehicle}/mission", MISSION, ask, result, lambda _, part: types.make(f"{MISSION}_Feedback", progress=part)
    )


def _waypoint(pose: Any) -> dict[str, object]:
    place, heading = pose_in_map(pose)
    item: dict[str, object] = {"kind": "waypoint", "position_ned_m": list(place)}
    return item if heading is None else {**item, "heading_deg": heading_deg(heading)}


def _steps(types: Types) -> Action:
    def result(_: Json, fault: Fault | None) -> object:
        return types.make(f"{STEPS}_Result", result=result_of(types, fault))

    def feedback(goal: Any, part: float) -> object:
        done = min(goal.steps, max(0, round(goal.steps * part)))
        return types.make(f"{STEPS}_Feedback", completed_steps=done, remaining_steps=goal.steps - done)

    return Action(
        "/uwserver/simulate_steps", STEPS, lambda goal: Ask("world/step", {"n": goal.steps}), result, feedback
    )


def _why(fault: Fault | None) -> str:
    return "" if fault is None else fault.text
