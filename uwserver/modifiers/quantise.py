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
        self._step = config.step

    def apply(self, reading: Measurement) -> None:
        step = self._step
        reading.values[self._index] = mapped(reading.values[self._index], lambda v: round(v / step) * step)
