"""Parameters of the node: the services that ``ros2 param`` and rqt_reconfigure call, and /parameter_events. Loop thread."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from uwserver_adapters.ros.messages.settings import (
    BOOL,
    BOOL_ARRAY,
    DOUBLE,
    DOUBLE_ARRAY,
    INTEGER,
    INTEGER_ARRAY,
    NOT_SET,
    STRING,
    STRING_ARRAY,
    Setting,
    bounds,
)
from uwserver_adapters.ros.messages.types import BadMessage, Types
from uwserver_adapters.ros.parameters import AT_ONCE, Parameters, listed
from uwserver_adapters.ros2.carrier import Answer, Host, serve

EVENTS = "/parameter_events"
_EVENT = "rcl_interfaces/msg/ParameterEvent"
_VALUE, _RESULT = "rcl_interfaces/msg/ParameterValue", "rcl_interfaces/msg/SetParametersResult"
_FIELDS = {
    BOOL: "bool_value", INTEGER: "integer_value", DOUBLE: "double_value", STRING: "string_value", 5: "byte_array_value",
    BOOL_ARRAY: "bool_array_value", INTEGER_ARRAY: "integer_array_value", DOUBLE_ARRAY: "double_array_value",
    STRING_ARRAY: "string_array_value",
}  # fmt: skip
_LARGEST = 1.7976931348623157e308


def value_of(message: Any) -> object:
    """Return the value of a ParameterValue; None where it is not set."""
    field = _FIELDS.get(message.type)
    value: Any = None if field is None else getattr(message, field)
    return value.tolist() if hasattr(value, "tolist") else value


def value_message(types: Types, setting: Setting | None, value: object | None) -> object:
    """Return a ParameterValue."""
    if setting is None or value is None:
        return types.make(_VALUE, type=NOT_SET)
    field = _FIELDS[setting.type]
    return types.make(_VALUE, type=setting.type, **{field: types.filled(_VALUE, field, value)})


class ParameterServer:
    """Serves the parameters of a node.

    Args:
        node: the node.
        name: its absolute name.
    """

    def __init__(self, node: Host, name: str) -> None:
        self._node, self._name = node, name
        self._parameters = Parameters(node.conversation, lambda: node.feed.catalogue.settings)
        self._is_heard = False
        self._events = node.carrier.advertise(EVENTS, _EVENT, False, self._hearing)
        services: dict[str, tuple[str, Callable[[Any, Answer], None]]] = {
            "describe_parameters": ("DescribeParameters", self._describe),
            "get_parameter_types": ("GetParameterTypes", self._types),
            "get_parameters": ("GetParameters", self._get),
            "list_parameters": ("ListParameters", self._list),
            "set_parameters": ("SetParameters", self._set),
            "set_parameters_atomically": ("SetParametersAtomically", self._set_together),
        }
        for short, (kind, act) in services.items():
            serve(node, f"{name}/{short}", f"rcl_interfaces/srv/{kind}", partial(_limited, act))

    def _hearing(self, _: str, is_heard: bool) -> None:
        self._is_heard = is_heard

    # -- names and descriptions -------------------------------------------------------------------------------------------------------------

    def _list(self, request: Any, answer: Answer) -> None:
        names, prefixes = listed(list(self._node.feed.catalogue.settings), request.prefixes, request.depth)
        answer(result=self._node.types.make("rcl_interfaces/msg/ListParametersResult", names=names, prefixes=prefixes))

    def _describe(self, request: Any, answer: Answer) -> None:
        known = self._node.feed.catalogue.settings
        answer(descriptors=[self._descriptor(name, known.get(name)) for name in request.names])

    def _descriptor(self, name: str, setting: Setting | None) -> object:
        types, kind = self._node.types, "rcl_interfaces/msg/ParameterDescriptor"
        if setting is None:
            return types.make(kind, name=name, type=NOT_SET)
        low, high = bounds(setting)
        told: dict[str, object] = {}
        if setting.type == DOUBLE and (math.isfinite(low) or math.isfinite(high)):
            span = {"from_value": max(low, -_LARGEST), "to_value": min(high, _LARGEST)}
            told["floating_point_range"] = [types.make("rcl_interfaces/msg/FloatingPointRange", **span)]
        if setting.argument is not None and setting.argument.choices and setting.type == STRING:
            told["additional_constraints"] = f"one of: {', '.join(setting.argument.choices)}"
        return types.make(kind, name=name, type=setting.type, description=setting.doc, **told)

    def _types(self, request: Any, answer: Answer) -> None:
        types, known = self._node.types, self._node.feed.catalogue.settings
        found = [known[name].type if name in known else NOT_SET for name in request.names]
        answer(types=types.filled("rcl_interfaces/srv/GetParameterTypes_Response", "types", found))

    # -- values -----------------------------------------------------------------------------------------------------------------------------

    def _get(self, request: Any, answer: Answer) -> None:
        known, names, types = self._node.feed.catalogue.settings, request.names, self._node.types

        def came(values: list[object | None]) -> None:
            answer(
                values=[value_message(types, known.get(name), value) for name, value in zip(names, values, strict=True)]
            )

        self._parameters.get(names, came)

    def _set(self, request: Any, answer: Answer) -> None:
        wanted = [(one.name, value_of(one.value)) for one in request.parameters]

        def came(reasons: list[str]) -> None:
            answer(results=[self._result(reason) for reason in reasons])
            self._tell([one for one, reason in zip(wanted, reasons, strict=True) if not reason])

        self._parameters.set(wanted, came)

    def _set_together(self, request: Any, answer: Answer) -> None:
        wanted = [(one.name, value_of(one.value)) for one in request.parameters]

        def came(reason: str) -> None:
            answer(result=self._result(reason))
            self._tell([] if reason else wanted)

        self._parameters.set_together(wanted, came)

    def _result(self, reason: str) -> object:
        if reason:
            self._node.refuse("parameter", f"{self._name}: {reason}")
        return self._node.types.make(_RESULT, successful=not reason, reason=reason)

    def _tell(self, changed: Sequence[tuple[str, object]]) -> None:
        """Publish what has changed."""
        if not changed or not self._is_heard:
            return
        types, known = self._node.types, self._node.feed.catalogue.settings
        told = [
            types.make("rcl_interfaces/msg/Parameter", name=name, value=value_message(types, known[name], known[name].checked(value)))
            for name, value in changed
            if name in known
        ]  # fmt: skip
        stamp = types.stamp(self._node.feed.now_ns())
        event = types.make(_EVENT, stamp=stamp, node=self._name, changed_parameters=told)
        self._node.send(EVENTS, self._events, types.cdr(event))


def _limited(act: Callable[[Any, Answer], None], request: Any, answer: Answer) -> None:
    """Carry out a request unless it is for too many parameters.

    Raises:
        BadMessage: it is.
    """
    names = getattr(request, "names", getattr(request, "parameters", ()))
    if len(names) > AT_ONCE:
        raise BadMessage(f"{len(names)} parameters at once, at most {AT_ONCE} are taken")
    act(request, answer)
