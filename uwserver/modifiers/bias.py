"""Constant errors, known or drawn once at the start of a run: of the zero, and of the scale."""

from __future__ import annotations

from uwserver.modifiers.base import Measurement, Memory, Modifier, ModifierTable, Number, Stream, mapped, shifted
from uwserver.table import Name, NonNegative


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


class _Drawn(Modifier):
    """Keeps, for each component of a field, what key `key` gives and an error of it drawn once."""

    memory: Constants
    draws = False

    def __init__(self, stream: Stream, field: str, key: str, given: float | tuple[float, ...], sigma: float) -> None:
        super().__init__(stream)
        self._index, each = stream.of_each(field, key, given)
        turn_on = stream.rng.normal(0.0, sigma, len(each)).tolist()
        self.memory = Constants(tuple(g + t for g, t in zip(each, turn_on, strict=True)))


class _Bias(_Drawn):
    def apply(self, reading: Measurement) -> None:
        reading.values[self._index] = shifted(reading.values[self._index], self.memory.each)


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
    def apply(self, reading: Measurement) -> None:
        value = reading.values[self._index]
        if isinstance(value, tuple):
            scaled = (None if v is None else v * f for v, f in zip(value, self.memory.each, strict=True))  # type: ignore[operator]
            reading.values[self._index] = tuple(scaled)
        else:
            reading.values[self._index] = mapped(value, lambda v: v * self.memory.each[0])
