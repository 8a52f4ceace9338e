"""Samples as the maps that any self-describing encoding (JSON, msgpack) can write. Shared by adapters."""

from __future__ import annotations

from collections.abc import Sequence

from uwserver.ports import Field, Port, Sample, Value


class SampleForm:
    """How the samples of a port become a map: all its fields, or those selected."""

    def __init__(self, port: Port, selected: Sequence[str] | None = None) -> None:
        picked = [(i, field) for i, field in enumerate(port.fields) if selected is None or field.name in selected]
        self._plain = len(picked) == len(port.fields) and all(len(field.shape) < 2 for field in port.fields)
        self._names = [field.name for field in port.fields]
        self._picked = picked

    def value(self, sample: Sample) -> dict[str, object]:
        """Field name -> number, list, or lists in lists where the field has more than one dimension."""
        if self._plain:
            return dict(zip(self._names, sample.value, strict=True))
        return {field.name: _nested(field, sample.value[i]) for i, field in self._picked}


def _nested(field: Field, value: Value) -> object:
    if not isinstance(value, tuple):
        return value
    rows: list[object] = list(value)
    for extent in reversed(field.shape[1:]):
        rows = [rows[i : i + extent] for i in range(0, len(rows), extent)]
    return rows
