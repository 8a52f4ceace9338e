"""Parameters in ROS terms: settings of sensors, actuators and autopilots that can be read and changed while the world runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from uwserver.ports import Argument, Service
from uwserver_adapters.ros.messages.ros_port import ros_name
from uwserver_adapters.ros.messages.services import Ask
from uwserver_adapters.ros.messages.types import BadMessage

NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
BOOL_ARRAY, INTEGER_ARRAY, DOUBLE_ARRAY, STRING_ARRAY = range(6, 10)
"""Numbers of rcl_interfaces/ParameterType."""
_TYPES = {"bool": BOOL, "int": INTEGER, "float": DOUBLE, "str": STRING}
_ARRAY = 5
"""Difference between the number of a list type and that of its items' type."""
_WORDS = {BOOL: "a boolean", INTEGER: "an integer", DOUBLE: "a number", STRING: "a text"}


@dataclass(frozen=True)
class Setting:
    """A parameter.

    Attributes:
        name: levels with dots between them.
        type: number of rcl_interfaces/ParameterType.
        doc: description, with the unit.
        source: service that reads it.
        key: its key in the result of that service.
        change: turns a new value into the call that sets it.
        argument: the argument of the service that sets it; None for a switch.
    """

    name: str
    type: int
    doc: str
    source: str
    key: str
    change: Callable[[object], Ask]
    argument: Argument | None = None

    def checked(self, value: object) -> object:
        """Return a value that this parameter may have; a whole number may come for a float.

        Raises:
            BadMessage: it is of another type, or no finite number.
        """
        if self.type < _ARRAY:
            return self._one(value, self.type)
        if not isinstance(value, list | tuple):
            raise BadMessage(f"{self.name} must be a list")
        return [self._one(part, self.type - _ARRAY) for part in value]

    def _one(self, value: object, kind: int) -> object:
        if kind == DOUBLE and isinstance(value, int | float) and not isinstance(value, bool):
            if not -1e300 < value < 1e300:
                raise BadMessage(f"{self.name} must be a finite number")
            return float(value)
        if type(value) is not {BOOL: bool, INTEGER: int, STRING: str}.get(kind):
            raise BadMessage(f"{self.name} must be {_WORDS[kind]}")
        return value

    def told(self, result: object) -> object | None:
        """Return its value from a result of `source`; None where there is none."""
        value = result.get(self.key) if isinstance(result, Mapping) else None
        try:
            return None if value is None else self.checked(value)
        except BadMessage:
            return None


def settings(services: Iterable[Service]) -> Iterator[Setting]:
    """Yield all parameters of a world."""
    known = {service.path: service for service in services}
    for path, service in known.items():
        above, _, verb = path.rpartition("/")
        name = ros_name(above).replace("/", ".")
        if verb == "set" and f"{above}/get" in known:
            for argument in service.arguments:
                if argument.type in _TYPES:
                    yield _property(name, above, argument)
        elif verb == "activate" and {f"{above}/get", f"{above}/deactivate"} <= known.keys():
            yield Setting(f"{name}.active", BOOL, "whether it works", f"{above}/get", "active", _switch(above))
        elif verb == "set_gain" and f"{above}/get_gains" in known:
            value = next(argument for argument in service.arguments if argument.name == "value")
            for gain in service.arguments[0].choices:
                change = _gain(path, gain)
                yield Setting(
                    f"{name}.{gain}", DOUBLE, "gain, limit or time-out", f"{above}/get_gains", gain, change, value
                )


def _property(name: str, above: str, argument: Argument) -> Setting:
    kind = _TYPES[argument.type] + (_ARRAY if argument.shape else 0)
    doc = argument.doc if argument.unit in ("", "1") else f"{argument.doc} ({argument.unit})"
    return Setting(
        f"{name}.{argument.name}", kind, doc, f"{above}/get", argument.name,
        lambda value: Ask(f"{above}/set", {argument.name: value}), argument,
    )  # fmt: skip


def _switch(above: str) -> Callable[[object], Ask]:
    return lambda value: Ask(f"{above}/activate" if value else f"{above}/deactivate", {})


def _gain(service: str, gain: str) -> Callable[[object], Ask]:
    return lambda value: Ask(service, {"name": gain, "value": value})


def bounds(setting: Setting) -> tuple[float, float]:
    """Return the least and the greatest value of a number; infinite where there is no bound."""
    argument = setting.argument
    low, high = (None, None) if argument is None else (argument.minimum, argument.maximum)
    return -math.inf if low is None else low, math.inf if high is None else high
