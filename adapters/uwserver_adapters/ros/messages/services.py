"""Services in ROS terms: std_srvs where they fit, and generated types for all others."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from uwserver.adapter import Conversation, Undecodable, decode
from uwserver.ports import Argument, Fault, Json, Service
from uwserver_adapters.ros.messages.generated import camel
from uwserver_adapters.ros.messages.ros_port import ros_name
from uwserver_adapters.ros.messages.types import BadMessage, Types

TRIGGER, SET_BOOL, CALL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool", "uwserver_msgs/srv/Call"
_BASES = {"float": "float64", "int": "int64", "bool": "bool", "str": "string", "json": "string"}


@dataclass(frozen=True)
class Ask:
    """A call of one of our services."""

    service: str
    args: Mapping[str, object]


Answered = Callable[[object, str], None]
"""Gets the response and the reason why something failed; the reason is "" where nothing failed."""


@dataclass(frozen=True)
class Errand:
    """A request that is not exactly one call.

    Attributes:
        begin: starts it and passes on the response once. Raises `Refused` or `BadMessage` where it cannot start.
    """

    begin: Callable[[Conversation, Answered], None]


@dataclass(frozen=True)
class Offer:
    """A ROS service.

    Attributes:
        name: name of the service.
        type: ``package/srv/Name``.
        ask: turns a request into an `Ask` or an `Errand`, or into the response where it is known at once. Raises `BadMessage`.
        answer: makes the response from a result or a fault.
    """

    name: str
    type: str
    ask: Callable[[Any], object]
    answer: Callable[[Json, Fault | None], object]


def offers(types: Types, services: Iterable[Service]) -> Iterator[Offer]:
    """Yield all services of a world except those of simulation_interfaces.

    Args:
        types: message types of the distribution.
        services: our services.
    """
    known = {service.path: service for service in services}
    for service in known.values():
        yield _generic(types, service)
        yield from _short_names(types, service)
    yield Offer("/uwserver/call", CALL, _any_call, _answer(types, CALL))


def _generic(types: Types, service: Service) -> Offer:
    name = "/" + ros_name(service.path)
    if not service.arguments:
        return Offer(name, TRIGGER, lambda _: Ask(service.path, {}), _answer(types, TRIGGER))
    type_name = f"uwserver_msgs/srv/{camel(service.path.split('/', 1)[-1])}"
    request = "\n".join(_field(argument) for argument in service.arguments)
    if types.has_service(type_name) and types.generated.get(type_name) != request:
        type_name = f"uwserver_msgs/srv/{camel(service.path)}"
    if not types.has_service(type_name):
        types.register_service(type_name, request, "bool success\nstring message\nstring result")
        types.generated[type_name] = request

    def ask(message: Any) -> Ask:
        return Ask(service.path, dict(_given(service.arguments, message)))

    return Offer(name, type_name, ask, _answer(types, type_name))


def _field(argument: Argument) -> str:
    """Return the line of an argument in a .srv file. An optional argument is a list of at most one item."""
    many = "[]" if argument.shape else ("" if argument.required else "[<=1]")
    return f"{_BASES[argument.type]}{many} {argument.name.lower()}"


def _given(arguments: Iterable[Argument], message: Any) -> Iterator[tuple[str, object]]:
    for argument in arguments:
        value = getattr(message, argument.name.lower())
        if hasattr(value, "tolist"):
            value = value.tolist()
        if not argument.required:
            if not value:
                continue
            value = value if argument.shape else value[0]
        yield argument.name, json_value(value, argument.name) if argument.type == "json" else value


def json_value(text: str, where: str) -> object:
    """Return the value of a field that holds JSON.

    Raises:
        BadMessage: it is no JSON, or would cost too much to read; the text begins with `where`.
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


def _answer(types: Types, type_name: str) -> Callable[[Json, Fault | None], object]:
    """Return what makes a response. The result is JSON in the field `result`, or in `message` where the type has no such field."""
    has_result = "result" in dict(types.fields(f"{type_name}_Response"))

    def answer(result: Json, fault: Fault | None) -> object:
        made = {"success": fault is None, "message": "" if fault is None else fault.text}
        if has_result:
            made["result"] = json.dumps(result) if fault is None else ""
        elif fault is None and result is not None:
            made["message"] = json.dumps(result)
        return types.make(f"{type_name}_Response", **made)

    return answer


def _short_names(types: Types, service: Service) -> Iterator[Offer]:
    """Yield the services under the short names that ROS users expect of an autopilot."""
    levels = service.path.split("/")
    vehicle = "/" + ros_name(levels[0])
    if levels[1:] == ["autopilot", "arm"]:
        disarm = "/".join((*levels[:2], "disarm"))
        yield Offer(
            f"{vehicle}/arm", SET_BOOL, lambda m: Ask(service.path if m.data else disarm, {}), _answer(types, SET_BOOL)
        )
    elif levels[1:] == ["autopilot", "set_mode"]:
        for mode in service.arguments[0].choices:
            yield Offer(
                f"{vehicle}/mode/{ros_name(mode)}", TRIGGER, lambda _, mode=mode: Ask(service.path, {"mode": mode}),  # type: ignore[misc]
                _answer(types, TRIGGER),
            )  # fmt: skip
