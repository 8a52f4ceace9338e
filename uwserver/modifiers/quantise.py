"""What a converter does to a value: it has a resolution, and ends."""

from __future__ import annotations

import math

from msgspec import UNSET, UnsetType

from uwserver.modifiers.base import Measurement, Modifier, ModifierTable, Stream, mapped
from uwserver.ports import Value
from uwserver.table import Name, Positive


class Quantise(ModifierTable, tag="quantise", kw_only=True, frozen=True):
    """Rounds each component to a multiple of `step` (field's unit)."""

    field: Name
    step: Positive

    def build(self, stream: Stream) -> _Quantise:
        """The modifier; ValueError as `Stream.index`."""
        return _Quantise(self, stream)


class _Quantise(Modifier):
    draws = False

    def __init__(self, config: Quantise, stream: Stream) -> None:
        super().__init__(stream)
        self._index = stream.index(config.field)
        # k / 500 prints as 0.142 where k * 0.002 does not.
        steps = round(1.0 / config.step)
        self._step, self._per_unit = config.step, steps if steps and abs(steps * config.step - 1.0) < 1e-12 else 0

    def apply(self, reading: Measurement) -> None:
        reading.values[self._index] = mapped(reading.values[self._index], self._rounded)

    def _rounded(self, value: float) -> float:
        if self._per_unit:
            return round(value * self._per_unit) / self._per_unit
        return round(value / self._step) * self._step


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


class _Saturate(Modifier):
    draws = False

    def __init__(self, config: Saturate, stream: Stream) -> None:
        super().__init__(stream)
        self._index = stream.index(config.field)
        self._low = -math.inf if isinstance(config.minimum, UnsetType) else config.minimum
        self._high = math.inf if isinstance(config.maximum, UnsetType) else config.maximum
        self._invalid = config.invalid

    def apply(self, reading: Measurement) -> None:
        value = reading.values[self._index]
        held: Value = mapped(value, lambda v: min(max(v, self._low), self._high))
        reading.values[self._index] = held
        if self._invalid and held != value:
            reading.valid = False
