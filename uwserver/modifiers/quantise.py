"""Errors of a converter: finite resolution and finite range."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from msgspec import UNSET, UnsetType

from uwserver.modifiers.base import ModifierTable, Stream
from uwserver.modifiers.operations import Operation
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.table import Name, Positive

QUANTISE, SATURATE = 7, 8
"""Codes of the operations."""


class Quantise(ModifierTable, tag="quantise", kw_only=True, frozen=True):
    """Rounds each component to a multiple of `step` (field's unit)."""

    field: Name
    step: Positive

    def build(self, stream: Stream) -> Operation:
        """Return the modifier; ValueError as `Stream.index`."""
        # If a whole number of steps makes one unit, the kernel divides by this number: 71 / 500 prints as 0.142, and 71 * 0.002 does not.
        steps = round(1.0 / self.step)
        per_unit = steps if steps and abs(steps * self.step - 1.0) < 1e-12 else 0
        return Operation(QUANTISE, stream, stream.index(self.field), (self.step, per_unit))


@compiled
def quantise(op: Any, row: Array) -> None:
    """Round the components. Parameters: step, and the number of steps in one unit, or 0 if this is not a whole number."""
    for k in range(op.first, op.first + op.count):
        row[k] = np.rint(row[k] * op.p[1]) / op.p[1] if op.p[1] > 0.0 else np.rint(row[k] / op.p[0]) * op.p[0]


class Saturate(ModifierTable, tag="saturate", kw_only=True, frozen=True):
    """Limits each component to `minimum` and `maximum` (field's unit). At least one of them must be given.

    Attributes:
        invalid: whether a reading that exceeds a limit becomes invalid.
    """

    field: Name
    minimum: float | UnsetType = UNSET
    maximum: float | UnsetType = UNSET
    invalid: bool = False

    def __post_init__(self) -> None:
        low, high = self.limits
        if self.minimum is UNSET and self.maximum is UNSET:
            raise ValueError("give minimum, maximum or both")
        if low > high:
            raise ValueError(f"minimum {low:g} is above maximum {high:g}")

    @property
    def limits(self) -> tuple[float, float]:
        """Minimum and maximum; infinite if not given."""
        low = -math.inf if isinstance(self.minimum, UnsetType) else self.minimum
        return low, math.inf if isinstance(self.maximum, UnsetType) else self.maximum

    def build(self, stream: Stream) -> Operation:
        """Return the modifier; ValueError as `Stream.index`."""
        return Operation(SATURATE, stream, stream.index(self.field), (*self.limits, self.invalid))


@compiled
def saturate(op: Any, row: Array, reading: Any) -> None:
    """Limit the components. Parameters: minimum, maximum, whether a reading that exceeds a limit becomes invalid."""
    for k in range(op.first, op.first + op.count):
        if row[k] < op.p[0] or row[k] > op.p[1]:
            row[k] = op.p[0] if row[k] < op.p[0] else op.p[1]
            if op.p[2] != 0.0:
                reading.valid = 0
