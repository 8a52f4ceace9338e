"""The services of simulation_interfaces for entities: which vehicles and objects there are, where they are, and how they are moved."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from uwserver.adapter import AdapterContext, Conversation
from uwserver.frames import Quat, Vec3, rotate
from uwserver.ports import Fault, Refused, Reply, Sample, SceneState
from uwserver_adapters.ros.messages.commands import check_frame, parts, q_NB_of
from uwserver_adapters.ros.messages.frames import attitude, enu
from uwserver_adapters.ros.messages.ros_port import Facts
from uwserver_adapters.ros.messages.services import Answered, Errand
from uwserver_adapters.ros.messages.types import BadMessage, Types

UNSUPPORTED, OK, NOT_FOUND, WRONG_STATE, FAILED = range(5)
"""Numbers of simulation_interfaces/Result."""
FRAMES = ("map", "world")
"""Frames in which poses may be given."""
PACKAGE = "simulation_interfaces"
_CODES = {"unknown_port": NOT_FOUND, "unknown_service": NOT_FOUND, "busy": WRONG_STATE}
_INVALID_POSE = 101
_OBJECT, _ROBOT = 0, 1


def result_of(types: Types, fault: Fault | None) -> object:
    """Return the Result for an answer of the world."""
    if fault is None:
        return types.make(f"{PACKAGE}/msg/Result", result=OK)
    return types.make(
        f"{PACKAGE}/msg/Result", result=_CODES.get(fault.code, FAILED), error_message=fault.text or fault.code
    )


def response(types: Types, short: str, code: int, text: str = "", **fields: object) -> object:
    """Return the response of a service, with its Result.

    Args:
        types: message types of the distribution.
        short: name of the service type without its package.
        code: code of the Result.
        text: error message of the Result.
        fields: further fields of the response.
    """
    result = types.make(f"{PACKAGE}/msg/Result", result=code, error_message=text)
    return types.make(f"{PACKAGE}/srv/{short}_Response", result=result, **fields)


def outcome(types: Types, short: str, fault: Fault | None) -> object:
    """Return the response that only holds the Result for an answer of the world."""
    return types.make(f"{PACKAGE}/srv/{short}_Response", result=result_of(types, fault))


def reason(fault: Fault | None) -> str:
    """Return why something failed; "" where nothing failed."""
    return "" if fault is None else fault.text


class Entities:
    """Answers requests about entities: with the response, or with an `Errand` where the world must be asked.

    Args:
        types: message types of the distribution.
        facts: what is the same for all topics; states of entities are given only where `truth` is set.
        context: the world.
    """

    def __init__(self, types: Types, facts: Facts, context: AdapterContext) -> None:
        self._types, self._facts, self._context = types, facts, context

    def _scene_errand(
        self, make: Callable[[SceneState, Sequence[Sample]], object], moving: Sequence[str] = ()
    ) -> Errand:
        """Return an errand that looks where everything is.

        Args:
            make: makes the response from poses and velocities.
            moving: entities whose velocities are needed, as their truth sensors last gave them.
        """
        ports = [f"{entity}/truth/velocity" for entity in moving]

        def begin(conversation: Conversation, answered: Answered) -> None:
            def seen(state: SceneState) -> None:
                def came(speeds: Sequence[Sample]) -> None:
                    response: Any = make(state, speeds)
                    answered(response, response.result.error_message)

                if ports:
                    _ask_within_limit(conversation, partial(self._context.read, ports), came)
                else:
                    came(())

            _ask_within_limit(conversation, self._context.request_scene_state, seen)

        return Errand(begin)

    def _truth(
        self, short: str, make: Callable[[SceneState, Sequence[Sample]], object], moving: Sequence[str]
    ) -> object:
        """Return an errand that looks at ground truth, or the refusal where it may not be given."""
        if not self._facts.truth:
            text = "states of entities are ground truth: set truth = true for this adapter"
            return response(self._types, short, UNSUPPORTED, text)
        return self._scene_errand(make, moving)

    def entities(self, request: Any) -> object:
        if _has_filters(request):
            return response(self._types, "GetEntities", UNSUPPORTED, "there are no filters: send none")
        return self._scene_errand(
            lambda state, _: response(self._types, "GetEntities", OK, entities=sorted(_names(state)))
        )

    def info(self, request: Any) -> object:
        def told(state: SceneState, _: Sequence[Sample]) -> object:
            names = _names(state)
            if request.entity not in names:
                return response(self._types, "GetEntityInfo", NOT_FOUND, _nobody(request.entity, names))
            is_vehicle = names.index(request.entity) < len(state.entities.vehicles)
            model = next((v.model for v in self._context.world.vehicles if v.name == request.entity), "")
            category = self._types.make(f"{PACKAGE}/msg/EntityCategory", category=_ROBOT if is_vehicle else _OBJECT)
            info = self._types.make(f"{PACKAGE}/msg/EntityInfo", category=category, description=model)
            return response(self._types, "GetEntityInfo", OK, info=info)

        return self._scene_errand(told)

    # -- states of entities -----------------------------------------------------------------------------------------------------------------

    def state_of(self, request: Any) -> object:
        def told(state: SceneState, speeds: Sequence[Sample]) -> object:
            names = _names(state)
            if request.entity not in names:
                return response(self._types, "GetEntityState", NOT_FOUND, _nobody(request.entity, names))
            found = self._entity(state, names.index(request.entity), speeds)
            return response(self._types, "GetEntityState", OK, state=found)

        return self._truth("GetEntityState", told, [request.entity])

    def states(self, request: Any) -> object:
        if _has_filters(request):
            return response(self._types, "GetEntitiesStates", UNSUPPORTED, "there are no filters: send none")

        def told(state: SceneState, speeds: Sequence[Sample]) -> object:
            names = _names(state)
            found = [self._entity(state, k, speeds) for k in range(len(names))]
            return response(self._types, "GetEntitiesStates", OK, entities=names, states=found)

        return self._truth("GetEntitiesStates", told, [vehicle.name for vehicle in self._context.world.vehicles])

    def _entity(self, state: SceneState, k: int, speeds: Sequence[Sample]) -> object:
        """Return the EntityState of body k in map. Velocities without a truth sensor are NaN, and so are all accelerations."""
        types, pose = self._types, state.poses[k].tolist()
        q = (pose[3], pose[4], pose[5], pose[6])
        unknown: Vec3 = (math.nan,) * 3
        v, w = unknown, unknown
        path = f"{_names(state)[k]}/truth/velocity"
        for sample in speeds:
            if sample.port == path and sample.valid:
                fields = [field.name for field in self._context.ports[path].fields]
                told = dict(zip(fields, sample.value, strict=True))
                v, w = (enu(rotate(q, told[name])) for name in ("v_NB_B", "w_NB_B"))  # type: ignore[arg-type]  # vectors
        rest = types.make("geometry_msgs/msg/Accel", linear=types.vector(unknown), angular=types.vector(unknown))
        return types.make(
            f"{PACKAGE}/msg/EntityState", header=types.header(self._facts.epoch_ns + state.t_ns, "map"),
            pose=types.make(
                "geometry_msgs/msg/Pose", position=types.point(enu(pose[:3])), orientation=types.quaternion(attitude(q))
            ),
            twist=types.make("geometry_msgs/msg/Twist", linear=types.vector(v), angular=types.vector(w)), acceleration=rest,
        )  # fmt: skip

    def set_state_of(self, request: Any) -> object:
        """Move a vehicle by its actuator of kind teleport."""
        short, entity, state = "SetEntityState", request.entity, request.state
        # Requests of simulation_interfaces 1.x have no such switches: everything is set.
        wants_pose, wants_twist = getattr(request, "set_pose", True), getattr(request, "set_twist", True)
        vehicles = [vehicle.name for vehicle in self._context.world.vehicles]
        if entity not in vehicles:
            return response(self._types, short, NOT_FOUND, _nobody(entity, vehicles))
        port = next(
            (p for p in self._context.ports.values() if p.kind == "teleport" and p.path.startswith(f"{entity}/")), None
        )
        if port is None or getattr(request, "set_acceleration", False):
            text = f'"{entity}" has no actuator of kind teleport' if port is None else "accelerations cannot be set"
            return response(self._types, short, UNSUPPORTED, text)
        try:
            check_frame(state, *FRAMES)
            q = q_NB_of(state.pose.orientation)
        except BadMessage as bad:
            return response(self._types, short, _INVALID_POSE, str(bad))
        if wants_pose and q is None:
            return response(self._types, short, _INVALID_POSE, "the orientation is all zero")
        path = port.path

        def move(conversation: Conversation, answered: Answered, now: Quat) -> None:
            value: dict[str, object] = {}
            if wants_pose:
                value |= {"p_NB": list(enu(parts(state.pose.position))), "q_NB": list(now)}
            if wants_twist:
                back = (now[0], -now[1], -now[2], -now[3])
                linear, angular = (rotate(back, enu(parts(v))) for v in (state.twist.linear, state.twist.angular))
                value |= {"v_NB_B": list(linear), "w_NB_B": list(angular)}

            def moved(reply: Reply) -> None:
                answered(outcome(self._types, short, reply.fault), reason(reply.fault))

            conversation.command(path, value, moved)

        def begin(conversation: Conversation, answered: Answered) -> None:
            if wants_pose and q is not None:
                move(conversation, answered, q)
                return

            def seen(scene: SceneState) -> None:
                w, x, y, z = scene.poses[_names(scene).index(entity)].tolist()[3:]
                move(conversation, answered, (w, x, y, z))

            _ask_within_limit(conversation, self._context.request_scene_state, seen)

        return Errand(begin)


def _has_filters(request: Any) -> bool:
    filters = request.filters
    return bool(filters.filter or len(filters.categories) or filters.tags.tags or filters.bounds.type)


def _ask_within_limit(
    conversation: Conversation, ask: Callable[[Callable[[Any], None], str], None], told: Callable[[Any], None]
) -> None:
    """Ask the world something within what the peer may have unanswered; `ask` gets what takes the answer, and the source.

    Raises:
        Refused: too much waits already.
    """
    in_flight = conversation.in_flight
    in_flight.add()

    def answered(what: Any) -> None:
        in_flight.count -= 1
        if not conversation.is_closed:
            told(what)

    try:
        ask(answered, conversation.source)
    except Refused:
        in_flight.count -= 1
        raise


def _names(state: SceneState) -> list[str]:
    return [one.name for one in (*state.entities.vehicles, *state.entities.objects)]


def _nobody(name: str, there: Sequence[str]) -> str:
    return f'no "{name[:100]}" here, there is: {", ".join(there) or "nothing"}'
