"""Fields of actuators from percentages (DESIRED_THRUST, DESIRED_RUDDER ...). A field is a sum with one column for each variable."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from uwserver.adapter import CannotServe, field_of, port_of
from uwserver.ports import Field, Port
from uwserver_adapters.moos.codec import rad
from uwserver_adapters.moos.config import Target

FULL = 100.0
"""Value of a variable that stands for a target's `full`."""


@dataclass
class _Mixed:
    """One field of an actuator: the sum of the parts of all variables, within its range."""

    field: Field
    zero: tuple[float, ...]
    columns: dict[str, tuple[float, ...]]

    def value(self, given: Mapping[str, float]) -> float | list[float]:
        """Return the field for the present values of the variables."""
        total = list(self.zero)
        for name, column in self.columns.items():
            part = given.get(name, 0.0) / FULL
            total = [sum_ + part * full for sum_, full in zip(total, column, strict=True)]
        low = -math.inf if self.field.minimum is None else self.field.minimum
        high = math.inf if self.field.maximum is None else self.field.maximum
        limited = [min(max(component, low), high) for component in total]
        return limited if self.field.shape else limited[0]


class Mixer:
    """Keeps the last value of each variable, and computes the commands of the actuators.

    Args:
        commands: variable -> its targets.
        ports: those of the context.
        vehicle: vehicle of the actuators.

    Raises:
        CannotServe: a port or field is missing, or `full` or `zero` does not fit it.
    """

    def __init__(self, commands: Mapping[str, Sequence[Target]], ports: Mapping[str, Port], vehicle: str) -> None:
        self._given: dict[str, float] = {}
        self._limits: dict[str, float] = {}
        self._mixed: dict[str, dict[str, _Mixed]] = {}
        self._reached: dict[str, dict[str, None]] = {}
        for name, targets in commands.items():
            for target in targets:
                self._add(name, target, ports, vehicle)

    def _add(self, name: str, target: Target, ports: Mapping[str, Port], vehicle: str) -> None:
        where = f"commands.{name}"
        port = port_of(where, target.port, ports, vehicle, "actuator")
        field = field_of(where, port, target.field)
        mixed = self._mixed.setdefault(port.path, {}).setdefault(field.name, _Mixed(field, (0.0,) * field.size, {}))
        mixed.columns[name] = _column(where, target, field)
        zero = _components(where, "zero", target.zero, field)
        mixed.zero = tuple(sum_ + part for sum_, part in zip(mixed.zero, zero, strict=True))
        self._limits[name] = min(target.limit, self._limits.get(name, math.inf))
        self._reached.setdefault(name, {})[port.path] = None

    @property
    def names(self) -> tuple[str, ...]:
        """Variables that mean something here."""
        return tuple(self._reached)

    def take(self, name: str, value: float) -> list[str]:
        """Keep a value. Returns the paths of the actuators that it changes. Raises ValueError where it is not finite."""
        if not math.isfinite(value):
            raise ValueError(f"{value} is no finite number")
        limit = self._limits[name]
        self._given[name] = min(max(value, -limit), limit)
        return list(self._reached[name])

    def neutral(self) -> list[str]:
        """Forget all values. Returns the paths of all actuators."""
        self._given.clear()
        return list(self._mixed)

    def command(self, path: str) -> dict[str, float | list[float]]:
        """Return all fields of an actuator that variables reach."""
        return {name: mixed.value(self._given) for name, mixed in self._mixed[path].items()}


def _column(where: str, target: Target, field: Field) -> tuple[float, ...]:
    if (target.full is None) == (target.full_deg is None):
        raise CannotServe(f"{where}: give either `full` or `full_deg`, what 100 adds")
    if target.full is not None:
        return _components(where, "full", target.full, field)
    if field.unit != "rad":
        raise CannotServe(f'{where}: "{field.name}" is in {field.unit}: give `full`, not `full_deg`')
    return tuple(map(rad, _components(where, "full", target.full_deg or 0.0, field)))


def _components(where: str, what: str, given: float | tuple[float, ...], field: Field) -> tuple[float, ...]:
    numbers = (float(given),) * field.size if isinstance(given, int | float) else tuple(map(float, given))
    if len(numbers) != field.size:
        raise CannotServe(f'{where}: `{what}` has {len(numbers)} numbers, "{field.name}" has {field.size} components')
    if not all(map(math.isfinite, numbers)):
        raise CannotServe(f"{where}: `{what}` is not finite")
    return numbers
