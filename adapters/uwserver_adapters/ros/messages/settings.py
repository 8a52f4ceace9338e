"""Parameters in ROS' words: what of sensors, actuators and autopilots can be read and changed while the world runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from uwserver.ports import Argument, Service
from uwserver_adapters.ros.messages.services import Ask
from uwserver_adapters.ros.messages.source import ros_name
from uwserver_adapters.ros.messages.types import BadMessage

NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
BOOL_ARRAY, INTEGER_ARRAY, DOUBLE_ARRAY, STRING_ARRAY = range(6, 10)
"""Of rcl_interfaces/ParameterType."""
_TYPES = {"bool": BOOL, "int": INTEGER, "float": DOUBLE, "str": STRING}
_ARRAY = 5
"""Between the type of a value and that of a list of such."""
_WORDS = {BOOL: "a boolean", INTEGER: "an integer", DOUBLE: "a number", STRING: "a text"}


@dataclass(frozen=True)
class Setting:
    """A parameter.

    Attributes:
        name: levels with dots between them.
        type: of rcl_interfaces/ParameterType.
        doc: what it is, with its unit.
        source: service that tells it.
        key: under which its result has it.
        change: what a new value asks for.
        argument: of the service that changes it; None for a switch.
    """

    name: str
    type: int
    doc: str
    source: str
    key: str
    change: Callable[[object], Ask]
    argument: Argument | None = None

    def checked(self, value: object) -> object:
        """A value that it may be given; a whole number may come for a float.

        Raises:
            BadMessage: it is of another type, or no finite number.
        """
        kind = self.type - _ARRAY if self.type > _ARRAY else self.type
        if self.type > _ARRAY:
            if not isinstance(value, list | tuple):
                raise BadMessage(f"{self.name} must be a list")
            return [self._one(part, kind) for part in value]
        return self._one(value, kind)

    def _one(self, value: object, kind: int) -> object:
        if kind == DOUBLE and isinstance(value, int | float) and not isinstance(value, bool):
            if not -1e300 < value < 1e300:
                raise BadMessage(f"{self.name} must be a finite number")
            return float(value)
        if type(value) is not {BOOL: bool, INTEGER: int, STRING: str}.get(kind):
            raise BadMessage(f"{self.name} must be {_WORDS[kind]}")
        return value

    def told(self, result: object) -> object | None:
        """Its value in a result of its source; None where it has none."""
        value = result.get(self.key) if isinstance(result, Mapping) else None
        try:
            return None if value is None else self.checked(value)
        except BadMessage:
            return None


def settings(services: Iterable[Service]) -> Iterator[Setting]:
    """All parameters of a world."""
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
    """What a number must lie between."""
    argument = setting.argument
    if argument is None:
        return -math.inf, math.inf
    low, high = argument.minimum, argument.maximum
    return -math.inf if low is None else low, math.inf if high is None else high
