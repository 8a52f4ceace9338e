"""Actions in ROS terms, made from the world's long-running services: they report progress and can be cancelled."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from uwserver.ports import Fault, Json, Service
from uwserver_adapters.ros.messages.codec import heading_deg
from uwserver_adapters.ros.messages.commands import pose_in_map
from uwserver_adapters.ros.messages.entities import reason, result_of
from uwserver_adapters.ros.messages.ros_port import ros_name
from uwserver_adapters.ros.messages.services import Ask, json_value
from uwserver_adapters.ros.messages.types import BadMessage, Types

EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 2, 3, 4, 5, 6
"""Numbers of action_msgs/GoalStatus."""
GOTO, MISSION, STEPS = (
    "uwserver_msgs/action/Goto",
    "uwserver_msgs/action/Mission",
    "simulation_interfaces/action/SimulateSteps",
)


@dataclass(frozen=True)
class Action:
    """An action.

    Attributes:
        name: name of the action.
        type: ``package/action/Name``.
        ask: turns a goal into a call; raises `BadMessage`.
        result: makes the result from a reply of the world.
        feedback: makes the feedback of a goal of which a fraction (0..1) is done.
    """

    name: str
    type: str
    ask: Callable[[Any], Ask]
    result: Callable[[Json, Fault | None], object]
    feedback: Callable[[Any, float], object]


def actions(types: Types, services: Iterable[Service]) -> Iterator[Action]:
    """Yield all actions of a world; ROS 1 has none.

    Args:
        types: message types of the distribution.
        services: our services.
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
    """Return the status of a goal whose call was answered."""
    if fault is None:
        return SUCCEEDED
    return CANCELED if is_cancelled and fault.code == "preempted" else ABORTED


def _goto(types: Types, service: str, vehicle: str) -> Action:
    def ask(goal: Any) -> Ask:
        # A speed or radius of 0 was not given: neither can be 0.
        given = {key: value for key, value in (("speed_mps", goal.speed), ("radius_m", goal.radius)) if value != 0.0}
        return Ask(service, {**_place(goal.pose), **given})

    def result(found: Json, fault: Fault | None) -> object:
        away = found.get("distance_m") if isinstance(found, dict) else None
        distance = away if isinstance(away, float | int) else math.nan
        return types.make(f"{GOTO}_Result", success=fault is None, message=reason(fault), distance=float(distance))

    return Action(f"{vehicle}/goto", GOTO, ask, result, lambda _, part: types.make(f"{GOTO}_Feedback", progress=part))


def _mission(types: Types, service: str, vehicle: str) -> Action:
    def ask(goal: Any) -> Ask:
        args: dict[str, object] = {"index": goal.first}
        if goal.poses and goal.items:
            raise BadMessage("give poses or items, not both")
        if goal.poses:
            args["items"] = [{"kind": "waypoint", **_place(pose)} for pose in goal.poses]
        elif goal.items:
            args["items"] = json_value(goal.items, "items")
        return Ask(service, args)

    def result(found: Json, fault: Fault | None) -> object:
        reached = found.get("reached") if isinstance(found, dict) else None
        reached = reached if isinstance(reached, int) else 0
        return types.make(f"{MISSION}_Result", success=fault is None, message=reason(fault), reached=reached)

    return Action(
        f"{vehicle}/mission", MISSION, ask, result, lambda _, part: types.make(f"{MISSION}_Feedback", progress=part)
    )


def _place(pose: Any) -> dict[str, object]:
    """Return a PoseStamped as the autopilot's services take it: position, and heading where the pose has one."""
    position, heading = pose_in_map(pose)
    place: dict[str, object] = {"position_ned_m": list(position)}
    return place if heading is None else {**place, "heading_deg": heading_deg(heading)}


def _steps(types: Types) -> Action:
    def result(_: Json, fault: Fault | None) -> object:
        return types.make(f"{STEPS}_Result", result=result_of(types, fault))

    def feedback(goal: Any, part: float) -> object:
        done = min(goal.steps, max(0, round(goal.steps * part)))
        return types.make(f"{STEPS}_Feedback", completed_steps=done, remaining_steps=goal.steps - done)

    return Action(
        "/uwserver/simulate_steps", STEPS, lambda goal: Ask("world/step", {"n": goal.steps}), result, feedback
    )
