"""Constant error, known or drawn once at the start of a run."""

from __future__ import annotations

from uwserver.modifiers.base import Measurement, Stream, shifted
from uwserver.table import Name, NonNegative, Table


class Bias(Table, tag="bias", tag_field="kind", kw_only=True, frozen=True):
    """Adds `value` (one number for all components, or one a component, field's unit) and a turn-on error drawn once with `sigma`."""

    field: Name
    value: float | tuple[float, ...] = 0.0
    sigma: NonNegative = 0.0

    def build(self, stream: Stream) -> _Bias:
        """The modifier.

        Raises:
            ValueError: unknown field, or `value` has another number of components than the field.
        """
        return _Bias(self, stream)


class _Bias:
    def __init__(self, config: Bias, stream: Stream) -> None:
        self.stream = stream
        self._index = stream.index(config.field)
        size = stream.fields[self._index].size
        value = config.value if isinstance(config.value, tuple) else (config.value,) * size
        if len(value) != size:
            raise ValueError(f'"value" needs one number or {size}, one for each component of "{config.field}"')
        turn_on = stream.rng.normal(0.0, config.sigma, size).tolist()
        self.memory = [v + t for v, t in zip(value, turn_on, strict=True)]

    def apply(self, reading: Measurement) -> None:
        reading.values[self._index] = shifted(reading.values[self._index], self.memory)
