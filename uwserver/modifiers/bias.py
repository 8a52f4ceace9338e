"""Constant errors of the zero and of the scale: given, or drawn once at the start of a run."""

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
    """Adds `value` (in the field's unit; one number for all components, or one for each) and a turn-on error that is drawn once with `sigma`."""

    field: Name
    value: float | tuple[float, ...] = 0.0
    sigma: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier.

        Raises:
            ValueError: unknown field, or `value` has another number of components than the field.
        """
        return _constant(BIAS, stream, self.field, "value", self.value, self.sigma)


class Scale(ModifierTable, tag="scale", kw_only=True, frozen=True):
    """Multiplies by `factor` (one number for all components, or one for each; with 1.01 the sensor reads 1 % too high) plus an error of the factor
    that is drawn once with `sigma`."""

    field: Name
    factor: float | tuple[float, ...] = 1.0
    sigma: NonNegative = 0.0

    def build(self, stream: Stream) -> Operation:
        """Return the modifier.

        Raises:
            ValueError: unknown field, or `factor` has another number of components than the field.
        """
        return _constant(SCALE, stream, self.field, "factor", self.factor, self.sigma)


class Constants(Memory):
    """The constant of each component.

    Attributes:
        each: bias (field's unit) or factor, drawn errors included.
    """

    each: tuple[Number, ...] = ()


def _constant(
    code: int, stream: Stream, field: str, key: str, given: float | tuple[float, ...], sigma: float
) -> Operation:
    """Return an operation with one constant for each component: what key `key` gives, plus an error that is drawn once."""
    index, each = stream.of_each(field, key, given)
    turn_on = (sigma * draw_normals(stream.key, len(each))).tolist()
    return Operation(code, stream, index, memory=Constants(tuple(g + t for g, t in zip(each, turn_on, strict=True))))


@compiled
def bias(op: Any, numbers: Array, row: Array) -> None:
    """Add the bias. Remembers `Constants`."""
    for k in range(op.count):
        row[op.first + k] += numbers[op.memory + k]


@compiled
def scale(op: Any, numbers: Array, row: Array) -> None:
    """Multiply by the factor. Remembers `Constants`."""
    for k in range(op.count):
        row[op.first + k] *= numbers[op.memory + k]
