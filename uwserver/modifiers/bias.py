"""Constant errors, known or drawn once at the start of a run: of the zero, and of the scale."""

from __future__ import annotations

from typing import Any

from uwserver.modifiers.base import Memory, ModifierTable, Number, Stream
from uwserver.modifiers.operations import Operation
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import draw_normals
from uwserver.table import Name, NonNegative

BIAS, SCALE = 4, 5
"""Codes of the operations."""


class Bias(ModifierTable, tag="bias", kw_only=True, frozen=True):
    """Adds `value` (one number for all components, or one a component, field's unit) and a turn-on error drawn once with `sigma`."""

    field: Name
    value: float | tuple[float, ...] = 0.0
    sigma: NonNegative = 0.0

    def build(self, stream: Stream) -> _Bias:
        """The modifier.

        Raises:
            ValueError: unknown field, or `value` has another number of components than the field.
        """
        return _Bias(stream, self.field, "value", self.value, self.sigma)


class Constants(Memory):
    """Attributes:
    each: of each component, field's unit or factor; drawn errors included."""

    each: tuple[Number, ...] = ()


class _Drawn(Operation):
    """Keeps, for each component of a field, what key `key` gives and an error of it drawn once."""

    def __init__(self, stream: Stream, field: str, key: str, given: float | tuple[float, ...], sigma: float) -> None:
        index, each = stream.of_each(field, key, given)
        turn_on = (sigma * draw_normals(stream.key, len(each))).tolist()
        super().__init__(stream, index, (), Constants(tuple(g + t for g, t in zip(each, turn_on, strict=True))))


class _Bias(_Drawn):
    code = BIAS


@compiled
def bias(op: Any, numbers: Array, row: Array) -> None:
    """Remembers `Constants`."""
    for k in range(op.count):
        row[op.first + k] += numbers[op.memory + k]


class Scale(ModifierTable, tag="scale", kw_only=True, frozen=True):
    """Multiplies by `factor` (one number for all components, or one a component; 1.01 shows 1 % too much) plus an error of it drawn once with
    `sigma` (relative)."""

    field: Name
    factor: float | tuple[float, ...] = 1.0
    sigma: NonNegative = 0.0

    def build(self, stream: Stream) -> _Scale:
        """The modifier.

        Raises:
            ValueError: unknown field, or `factor` has another number of components than the field.
        """
        return _Scale(stream, self.field, "factor", self.factor, self.sigma)


class _Scale(_Drawn):
    code = SCALE


@compiled
def scale(op: Any, numbers: Array, row: Array) -> None:
    """Remembers `Constants`."""
    for k in range(op.count):
        row[op.first + k] *= numbers[op.memory + k]
