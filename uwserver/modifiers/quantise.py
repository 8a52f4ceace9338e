"""What a converter does to a value: it has a resolution, and ends."""

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

    def build(self, stream: Stream) -> _Quantise:
        """The modifier; ValueError as `Stream.index`."""
        return _Quantise(self, stream)


class _Quantise(Operation):
    code = QUANTISE

    def __init__(self, config: Quantise, stream: Stream) -> None:
        # k / 500 prints as 0.142 where k * 0.002 does not.
        steps = round(1.0 / config.step)
        per_unit = steps if steps and abs(steps * config.step - 1.0) < 1e-12 else 0
        super().__init__(stream, stream.index(config.field), (config.step, per_unit))


@compiled
def quantise(op: Any, row: Array) -> None:
    """Parameters: step, and how many of them make one unit; 0 where that is no whole number."""
    for k in range(op.first, op.first + op.count):
        row[k] = np.rint(row[k] * op.p[1]) / op.p[1] if op.p[1] > 0.0 else np.rint(row[k] / op.p[0]) * op.p[0]


class Saturate(ModifierTable, tag="saturate", kw_only=True, frozen=True):
    """Holds each component between `minimum` and `maximum` (field's unit); at least one is given.

    Attributes:
        invalid: a reading that had to be held is not valid.
    """

    field: Name
    minimum: float | UnsetType = UNSET
    maximum: float | UnsetType = UNSET
    invalid: bool = False

    def __post_init__(self) -> None:
        low, high = self.minimum, self.maximum
        if isinstance(low, UnsetType) and isinstance(high, UnsetType):
            raise ValueError("give minimum, maximum or both")
        if not isinstance(low, UnsetType) and not isinstance(high, UnsetType) and low > high:
            raise ValueError(f"minimum {low:g} is above maximum {high:g}")

    def build(self, stream: Stream) -> _Saturate:
        """The modifier; ValueError as `Stream.index`."""
        return _Saturate(self, stream)


class _Saturate(Operation):
    code = SATURATE

    def __init__(self, config: Saturate, stream: Stream) -> None:
        low = -math.inf if isinstance(config.minimum, UnsetType) else config.minimum
        high = math.inf if isinstance(config.maximum, UnsetType) else config.maximum
        super().__init__(stream, stream.index(config.field), (low, high, config.invalid))


@compiled
def saturate(op: Any, row: Array, reading: Any) -> None:
    """Parameters: lowest, highest, whether what had to be held is not valid."""
    for k in range(op.first, op.first + op.count):
        if row[k] < op.p[0] or row[k] > op.p[1]:
            row[k] = op.p[0] if row[k] < op.p[0] else op.p[1]
            if op.p[2] != 0.0:
                reading.valid = 0
