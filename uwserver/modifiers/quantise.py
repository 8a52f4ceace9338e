"""Resolution of an analogue-to-digital converter or of a printed figure."""

from __future__ import annotations

from uwserver.modifiers.base import Measurement, Stream, mapped
from uwserver.table import Name, Positive, Table


class Quantise(Table, tag="quantise", tag_field="kind", kw_only=True, frozen=True):
    """Rounds each component to a multiple of `step` (field's unit)."""

    field: Name
    step: Positive

    def build(self, stream: Stream) -> _Quantise:
        """The modifier; ValueError as `Stream.index`."""
        return _Quantise(self, stream)


class _Quantise:
    def __init__(self, config: Quantise, stream: Stream) -> None:
        self.stream, self.memory = stream, list[float]()
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
