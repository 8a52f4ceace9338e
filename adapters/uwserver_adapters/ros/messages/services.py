"""Services in ROS' words: std_srvs where they say it, simulation_interfaces for the world, a generated type for all others."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from uwserver.adapter import Undecodable, decode
from uwserver.ports import Argument, Fault, Json, Service
from uwserver_adapters.ros.messages.generated import camel
from uwserver_adapters.ros.messages.source import ros_name
from uwserver_adapters.ros.messages.types import BadMessage, Types

OK, _UNSUPPORTED, _NOT_FOUND, _WRONG_STATE, FAILED = 1, 0, 2, 3, 4
_PLAYING, _PAUSED = 1, 2
_FEATURES = (1, 20, 22, 24, 25, 26, 31, 32)
"""Of SimulatorFeatures: deleting, reset (and of the state), state getting, setting, pause, stepping single and multiple."""

TRIGGER, SET_BOOL, CALL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool", "uwserver_msgs/srv/Call"


@dataclass(frozen=True)
class Ask:
    """A call of one of our services."""

    service: str
    args: Mapping[str, object]


@dataclass(frozen=True)
class Offer:
    """A ROS service.

    Attributes:
        name: of the service.
        type: ``package/srv/Name``.
        ask: what a request asks for; or the response, where it is known at once. Raises `BadMessage`.
        answer: the response to a result or a fault.
    """

    name: str
    type: str
    ask: Callable[[Any], object]
    answer: Callable[[Json, Fault | None], object]


def offers(types: Types, services: Iterable[Service], vehicles: Callable[[], Collection[str]]) -> Iterator[Offer]:
    """All services of a world.

    Args:
        types: of the distribution.
        services: ours.
        vehicles: names of those that are there, when asked.
    """
    known = {service.path: service for service in services}
    for service in known.values():
        yield _generic(types, service)
        yield from _spellings(types, service)
    yield Offer("/uwserver/call", CALL, _any_call, _json_answer(types, CALL))
    yield from _simulation(types, known, vehicles)


def _generic(types: Types, service: Service) -> Offer:
    name = "/" + ros_name(service.path)
    if not service.arguments:
        return Offer(name, TRIGGER, lambda _: Ask(service.path, {}), _plain_answer(types, TRIGGER))
    type_name = f"uwserver_msgs/srv/{camel(service.path.split('/', 1)[-1])}"
    request = "\n".join(_field(argument) for argument in service.arguments)
    if types.has_service(type_name) and types.generated.get(type_name) != request:
        type_name = f"uwserver_msgs/srv/{camel(service.path)}"
    if not types.has_service(type_name):
        types.register_service(type_name, request, "bool success\nstring message\nstring result")
        types.generated[type_name] = request

    def ask(message: Any) -> Ask:
        return Ask(service.path, dict(_given(service.arguments, message)))

    return Offer(name, type_name, ask, _json_answer(types, type_name))


_BASES = {"float": "float64", "int": "int64", "bool": "bool", "str": "string", "json": "string"}


def _field(argument: Argument) -> str:
    """What may be left out is a list of at most one."""
    many = "[]" if argument.shape else ("" if argument.required else "[<=1]")
    return f"{_BASES[argument.type]}{many} {argument.name.lower()}"


def _given(arguments: Iterable[Argument], message: Any) -> Iterator[tuple[str, object]]:
    for argument in arguments:
        value = getattr(message, argument.name.lower())
        if hasattr(value, "tolist"):
            value = value.tolist()
        if argument.shape:
            if not value and not argument.required:
                continue
        elif not argument.required:
            if not value:
                continue
            value = value[0]
        yield argument.name, json_value(value, argument.name) if argument.type == "json" else value


def json_value(text: str, where: str) -> object:
    """A value that a field holds as JSON.

    Raises:
        BadMessage: it is none.
    """
    try:
        return decode(text.encode(), "json")
    except Undecodable as error:
        raise BadMessage(f"{where} is no JSON that is taken: {error.fault.text[:200]}") from None
    except UnicodeEncodeError:
        raise BadMessage(f"{where} is no JSON: half a surrogate pair") from None


def _any_call(message: Any) -> Ask:
    args = json_value(message.arguments, "arguments") if message.arguments else {}
    if not isinstance(args, dict):
        raise BadMessage('arguments must be a JSON object, as {"n": 10}')
    return Ask(message.service.strip("/"), args)


def _plain_answer(types: Types, type_name: str) -> Callable[[Json, Fault | None], object]:
    """success and message, in which a result is JSON."""

    def answer(result: Json, fault: Fault | None) -> object:
        text = fault.text if fault is not None else ("" if result is None else json.dumps(result))
        return types.make(f"{type_name}_Response", success=fault is None, message=text)

    return answer


def _json_answer(types: Types, type_name: str) -> Callable[[Json, Fault | None], object]:
    def answer(result: Json, fault: Fault | None) -> object:
        return types.make(
            f"{type_name}_Response", success=fault is None, message="" if fault is None else fault.text,
            result="" if fault is not None else json.dumps(result),
        )  # fmt: skip

    return answer


def _spellings(types: Types, service: Service) -> Iterator[Offer]:
    """The short names that ROS users expect of an autopilot."""
    levels = service.path.split("/")
    vehicle = "/" + ros_name(levels[0])
    if levels[1:] == ["autopilot", "arm"]:
        disarm = "/".join((*levels[:2], "disarm"))
        yield Offer(
            f"{vehicle}/arm", SET_BOOL, lambda m: Ask(service.path if m.data else disarm, {}), _plain_answer(types, SET_BOOL)
        )  # fmt: skip
    elif levels[1:] == ["autopilot", "set_mode"]:
        for mode in service.arguments[0].choices:
            yield Offer(
                f"{vehicle}/mode/{ros_name(mode)}", TRIGGER, lambda _, mode=mode: Ask(service.path, {"mode": mode}),  # type: ignore[misc]
                _plain_answer(types, TRIGGER),
            )  # fmt: skip


# -- simulation_interfaces --------------------------------------------------------------------------------------------------------------------


def _simulation(types: Types, known: Mapping[str, Service], vehicles: Callable[[], Collection[str]]) -> Iterator[Offer]:
    package = "simulation_interfaces/srv/"

    def result(code: int, text: str = "") -> object:
        return types.make("simulation_interfaces/msg/Result", result=code, error_message=text)

    def told(name: str) -> Callable[[Json, Fault | None], object]:
        def answer(_: Json, fault: Fault | None) -> object:
            code = OK if fault is None else RESULT_CODES.get(fault.code, FAILED)
            return types.make(f"{package}{name}_Response", result=result(code, fault.text if fault else ""))

        return answer

    def features(_: object) -> object:
        made = types.make(
            "simulation_interfaces/msg/SimulatorFeatures", features=list(_FEATURES), custom_info="uwserver"
        )
        return types.make(f"{package}GetSimulatorFeatures_Response", features=made)

    def entities(request: Any) -> object:
        if request.filters.filter or len(request.filters.categories) or request.filters.tags.tags:
            return types.make(
                f"{package}GetEntities_Response", result=result(_UNSUPPORTED, "there are no filters: send none")
            )
        return types.make(f"{package}GetEntities_Response", result=result(OK), entities=sorted(vehicles()))

    def state(status: Json, fault: Fault | None) -> object:
        paused = isinstance(status, dict) and bool(status.get("paused"))
        return types.make(
            f"{package}GetSimulationState_Response", result=result(OK if fault is None else FAILED),
            state=types.make("simulation_interfaces/msg/SimulationState", state=_PAUSED if paused else _PLAYING),
        )  # fmt: skip

    def set_state(request: Any) -> object:
        services = {_PLAYING: "world/resume", _PAUSED: "world/pause"}
        if request.state.state in services:
            return Ask(services[request.state.state], {})
        text = f"state {request.state.state} is not supported, but playing (1) and paused (2)"
        return types.make(f"{package}SetSimulationState_Response", result=result(_UNSUPPORTED, text))

    def reset(request: Any) -> object:
        if request.scope in (0, 255):
            return Ask("world/reset", {})
        text = f"scope {request.scope} is not supported: all is reset at once (0 or 255)"
        return types.make(f"{package}ResetSimulation_Response", result=result(_UNSUPPORTED, text))

    table: tuple[tuple[str, str, str, Callable[[Any], object], Callable[[Json, Fault | None], object]], ...] = (
        ("", "get_simulator_features", "GetSimulatorFeatures", features, lambda *_: None),
        ("", "get_entities", "GetEntities", entities, lambda *_: None),
        ("world/status", "get_simulation_state", "GetSimulationState", lambda _: Ask("world/status", {}), state),
        ("world/pause", "set_simulation_state", "SetSimulationState", set_state, told("SetSimulationState")),
        ("world/step", "step_simulation", "StepSimulation", lambda m: Ask("world/step", {"n": m.steps}), told("StepSimulation")),
        ("world/reset", "reset_simulation", "ResetSimulation", reset, told("ResetSimulation")),
        ("world/remove", "delete_entity", "DeleteEntity", lambda m: Ask("world/remove", {"name": m.entity}), told("DeleteEntity")),
    )  # fmt: skip
    for needed, name, short, ask, answer in table:
        if not needed or needed in known:
            yield Offer(f"/uwserver/{name}", package + short, ask, answer)


RESULT_CODES = {"unknown_port": _NOT_FOUND, "unknown_service": _NOT_FOUND, "busy": _WRONG_STATE}
"""Fault of the world -> simulation_interfaces/Result; all others are failed operations."""
