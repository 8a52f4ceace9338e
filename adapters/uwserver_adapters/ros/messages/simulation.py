"""The standard services of ROS simulators (simulation_interfaces) on our world. Vehicles and objects of the scenario can be spawned again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Fault, Json, Reply, Service
from uwserver_adapters.ros.messages.commands import placed
from uwserver_adapters.ros.messages.entities import (
    FAILED,
    FRAMES,
    NOT_FOUND,
    OK,
    PACKAGE,
    UNSUPPORTED,
    Entities,
    outcome,
    reason,
    response,
    result_of,
)
from uwserver_adapters.ros.messages.ros_port import Facts
from uwserver_adapters.ros.messages.services import Answered, Ask, Errand, Offer
from uwserver_adapters.ros.messages.types import BadMessage, Types

_STOPPED, _PLAYING, _PAUSED, _QUITTING = range(4)
_ALREADY = 101
_NOT_UNIQUE, _NAME_INVALID, _FORMAT, _NO_RESOURCE, _NAMESPACE, _INVALID_POSE = 101, 102, 103, 104, 105, 109


def simulation(types: Types, facts: Facts, context: AdapterContext) -> Iterator[Offer]:
    """Yield those of the standard services that the world can carry out.

    Args:
        types: message types of the distribution.
        facts: what is the same for all topics; states of entities are given only where `truth` is set.
        context: the world.
    """
    made, known = _Simulation(types, facts, context), context.services
    for needed, name, short, ask, answer in made.table():
        if not needed or needed in known:
            yield Offer(f"/uwserver/{name}", f"{PACKAGE}/srv/{short}", ask, answer)


class _Simulation(Entities):
    """Answers requests about the simulation too: with the response, or with an `Ask` or `Errand` where the world must be asked."""

    def table(
        self,
    ) -> tuple[tuple[str, str, str, Callable[[Any], object], Callable[[Json, Fault | None], object]], ...]:
        """Return a row for each service: the service of ours that it needs, its name, its type, and the `ask` and `answer` of its `Offer`."""

        def no(*_: object) -> object:
            return None

        def told(short: str) -> Callable[[Json, Fault | None], object]:
            return lambda _, fault: outcome(self._types, short, fault)

        return (
            ("", "get_simulator_features", "GetSimulatorFeatures", self._features, no),
            ("", "get_entities", "GetEntities", self.entities, no),
            ("", "get_entity_info", "GetEntityInfo", self.info, no),
            ("", "get_entity_state", "GetEntityState", self.state_of, no),
            ("", "get_entities_states", "GetEntitiesStates", self.states, no),
            ("", "set_entity_state", "SetEntityState", self.set_state_of, no),
            ("world/spawn", "get_spawnables", "GetSpawnables", self._spawnables, no),
            ("world/spawn", "spawn_entity", "SpawnEntity", self._spawn, no),
            ("world/remove", "delete_entity", "DeleteEntity", lambda m: Ask("world/remove", {"name": m.entity}), self._deleted),
            ("world/status", "get_simulation_state", "GetSimulationState", lambda _: Ask("world/status", {}), self._state),
            ("world/pause", "set_simulation_state", "SetSimulationState", self._set_state, no),
            ("world/step", "step_simulation", "StepSimulation", lambda m: Ask("world/step", {"n": m.steps}), told("StepSimulation")),
            ("world/reset", "reset_simulation", "ResetSimulation", self._reset, told("ResetSimulation")),
        )  # fmt: skip

    # -- responses --------------------------------------------------------------------------------------------------------------------------

    def _deleted(self, _: Json, fault: Fault | None) -> object:
        if fault is not None and (fault.code, fault.where) == ("bad_argument", "name"):
            return response(self._types, "DeleteEntity", NOT_FOUND, fault.text)
        return outcome(self._types, "DeleteEntity", fault)

    # -- the simulation ---------------------------------------------------------------------------------------------------------------------

    def _features(self, _: object) -> object:
        known, found = self._context.services, [12, 20, 24, 25, 26, 31, 32, 33]
        found += [0, 14] if "world/spawn" in known else []
        found += [1] if "world/remove" in known else []
        found += [10] if self._facts.truth else []
        found += [11] if any(port.kind == "teleport" for port in self._context.ports.values()) else []
        features = self._types.filled(f"{PACKAGE}/msg/SimulatorFeatures", "features", sorted(found))
        made = self._types.make(f"{PACKAGE}/msg/SimulatorFeatures", features=features, custom_info="uwserver")
        return self._types.make(f"{PACKAGE}/srv/GetSimulatorFeatures_Response", features=made)

    def _state(self, status: Json, fault: Fault | None) -> object:
        state = self._types.make(f"{PACKAGE}/msg/SimulationState", state=_state_in(status))
        result = result_of(self._types, fault)
        return self._types.make(f"{PACKAGE}/srv/GetSimulationState_Response", result=result, state=state)

    def _set_state(self, request: Any) -> object:
        """Set a state: "stopped" means paused at the start, "quitting" ends the server."""
        wanted, known = request.state.state, self._context.services
        # An unknown state needs a service "?", which no world has.
        calls = {
            _PLAYING: ["world/resume"], _PAUSED: ["world/pause"], _STOPPED: ["world/pause", "world/reset"], _QUITTING: ["world/shutdown"],
        }.get(wanted, ["?"])  # fmt: skip
        if not known.keys() >= set(calls):
            text = f"state {wanted} is not supported, but stopped (0), playing (1), paused (2) and quitting (3)"
            return response(self._types, "SetSimulationState", UNSUPPORTED, text)

        def begin(conversation: Conversation, answered: Answered) -> None:
            def after(reply: Reply, rest: list[str]) -> None:
                if reply.fault is not None or not rest:
                    answered(outcome(self._types, "SetSimulationState", reply.fault), reason(reply.fault))
                else:
                    go(rest)

            def go(services: list[str]) -> None:
                conversation.call(services[0], {}, lambda reply: after(reply, services[1:]))

            def status(reply: Reply) -> None:
                if reply.fault is None and _state_in(reply.result) == wanted:
                    answered(response(self._types, "SetSimulationState", _ALREADY, "it is in this state already"), "")
                else:
                    go(calls)

            conversation.call("world/status", {}, status)

        return Errand(begin)

    def _reset(self, request: Any) -> object:
        if request.scope in (0, 255):
            return Ask("world/reset", {})
        text = f"scope {request.scope} is not supported: all is reset at once (0 or 255)"
        return response(self._types, "ResetSimulation", UNSUPPORTED, text)

    # -- what can be spawned ----------------------------------------------------------------------------------------------------------------

    def _likes(self) -> tuple[str, ...]:
        service: Service = self._context.services["world/spawn"]
        return next((argument.choices for argument in service.arguments if argument.name == "like"), ())

    def _spawnables(self, _: object) -> object:
        kind, types = f"{PACKAGE}/msg/Spawnable", self._types
        text = "a vehicle or object of the scenario"
        made = [
            types.make(kind, entity_resource=types.make(f"{PACKAGE}/msg/Resource", uri=like), description=text)
            if f"{PACKAGE}/msg/Resource" in types
            else types.make(kind, uri=like, description=text)
            for like in self._likes()
        ]
        return response(self._types, "GetSpawnables", OK, spawnables=made)

    def _spawn(self, request: Any) -> object:
        short, resource = "SpawnEntity", getattr(request, "entity_resource", request)
        like, name = resource.uri, request.name
        if not like:
            code = _FORMAT if resource.resource_string else _NO_RESOURCE
            text = "give a uri: the name of a vehicle or object of the scenario (get_spawnables lists them)"
            return response(self._types, short, code, text)
        if like not in self._likes():
            text = f'nothing is called "{like[:100]}", there are: {", ".join(self._likes())}'
            return response(self._types, short, _NO_RESOURCE, text)
        taken = {path.partition("/")[0] for path in self._context.ports} | {
            v.name for v in self._context.world.vehicles
        }
        if not name and not request.allow_renaming:
            return response(self._types, short, _NAME_INVALID, "give a name, or allow_renaming")
        if not name or (name in taken and request.allow_renaming):
            name = next(new for k in range(1, len(taken) + 2) if (new := f"{name or like}_{k}") not in taken)
        elif name in taken:
            return response(self._types, short, _NOT_UNIQUE, f'there is a "{name}" already')
        if request.entity_namespace.strip("/") not in ("", name):
            return response(
                self._types, short, _NAMESPACE, f"the namespace of an entity is its name: leave it empty, or say {name}"
            )
        try:
            pose = placed(request.initial_pose, request.initial_pose.pose, *FRAMES)
        except BadMessage as bad:
            return response(self._types, short, _INVALID_POSE, str(bad))
        return Errand(partial(self._spawn_now, {"name": name, "like": like, **pose}))

    def _spawn_now(self, args: dict[str, object], conversation: Conversation, answered: Answered) -> None:
        def came(reply: Reply) -> None:
            fault = reply.fault
            if fault is None:
                answered(response(self._types, "SpawnEntity", OK, entity_name=args["name"]), "")
            else:
                code = {"name": _NAME_INVALID, "p_NB": _INVALID_POSE, "q_NB": _INVALID_POSE}.get(fault.where, FAILED)
                answered(response(self._types, "SpawnEntity", code, fault.text), fault.text)

        conversation.call("world/spawn", args, came)


def _state_in(status: Json) -> int:
    if not isinstance(status, dict) or not status.get("paused"):
        return _PLAYING
    return _STOPPED if status.get("t_ns") == 0 else _PAUSED
