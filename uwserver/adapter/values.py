"""Turns samples into the maps that any self-describing encoding (JSON, msgpack) can write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import itemgetter

import msgspec

from uwserver.ports import Field, Port, Sample, Value, binary_form

LONG = 2048
"""Numbers of a field that are encoded in one call."""


def raw_field(port: Port) -> Field | None:
    """Return the only field of a port if it holds bytes or a buffer, or else None."""
    return port.fields[0] if len(port.fields) == 1 and port.fields[0].is_packed else None


class SampleForm:
    """Turns the samples of a port into maps with all fields, or with selected ones.

    Attributes:
        is_long: whether a field may hold more than `LONG` numbers.
        record: makes what `encodable` returns from the values of a sample; None if that needs the sample.
        raw: the only field of the port if it holds bytes or a buffer, which a wire may carry as they are; or else None.
    """

    def __init__(self, port: Port, selected: Sequence[str] | None = None) -> None:
        picked = [(i, field) for i, field in enumerate(port.fields) if selected is None or field.name in selected]
        names = tuple([field.name for field in port.fields])
        # A plain form writes all fields as they are, with rows for those of more than one dimension.
        self._plain = len(picked) == len(names) and not any(field.is_packed for field in port.fields)
        self._names = names
        self._picked = picked
        self._deep = [(i, field) for i, field in picked if len(field.shape) > 1]
        record = _record_of(names) if self._plain and all(map(str.isidentifier, names)) else None
        splits = [(i, _splitter(field)) for i, field in self._deep]
        self.record = _nesting(record, splits) if record is not None and splits else record
        self.is_long = any(field.size > LONG for _, field in picked)
        self.raw = raw_field(port)

    def value(self, sample: Sample, binary: bool = False) -> dict[str, object]:
        """Return for each field name a number or a list, or lists in lists if the field has more than one dimension.

        With `binary`, buffers are in their form for binary encodings.
        """
        if self._plain:
            value: dict[str, object] = dict(zip(self._names, sample.value, strict=True))
            for i, field in self._deep:
                value[field.name] = _nested(field, sample.value[i])
            return value
        shaped = {field.name: _nested(field, sample.value[i]) for i, field in self._picked}
        return {name: binary_form(value) for name, value in shaped.items()} if binary else shaped

    def encodable(self, sample: Sample, binary: bool = False) -> object:
        """Return what an encoder of msgspec writes as the same bytes as `value`; numbers and texts take half the time of a map."""
        return self.value(sample, binary) if self.record is None else self.record(*sample.value)


def _nesting(
    record: Callable[..., object], nest: Sequence[tuple[int, Callable[[Value], object]]]
) -> Callable[..., object]:
    """Return `record` for values of which some have more than one dimension, and are split into rows first."""

    def nested(*values: Value) -> object:
        rows: list[object] = list(values)
        for i, split in nest:
            if values[i] is not None:
                rows[i] = split(values[i])
        return record(*rows)

    return nested


@lru_cache(maxsize=1024)
def _record_of(names: tuple[str, ...]) -> Callable[..., msgspec.Struct]:
    """Return a type of records with these names on the wire. To define one takes 0.1 ms, so ports with the same fields share it."""
    inside = [f"f{k}" for k in range(len(names))]
    return msgspec.defstruct("Value", inside, rename=dict(zip(inside, names, strict=True)), gc=False)


def _splitter(field: Field) -> Callable[[Value], object]:
    """Return a function that splits the components of a value with more than one dimension into rows."""
    rows, width = field.shape[0], field.size // field.shape[0] if field.shape[0] else 0
    if len(field.shape) > 2 or rows < 2:
        return lambda value: _nested(field, value)
    cut: Callable[[Value], object] = itemgetter(*[slice(k * width, (k + 1) * width) for k in range(rows)])  # type: ignore[assignment]  # tuples
    return cut


def _nested(field: Field, value: Value) -> object:
    if not isinstance(value, tuple):
        return value
    rows: list[object] = list(value)
    for extent in reversed(field.shape[1:]):
        rows = [rows[i : i + extent] for i in range(0, len(rows), extent)]
    return rows


def in_pieces(value: dict[str, object], encode: Callable[[object], bytes]) -> dict[str, object]:
    """Return a map for a JSON encoder whose long lists are encoded already, piece by piece.

    An encoder holds up all other threads until it is done. It takes 5 ms, more than a tick, for a megabyte of numbers, so it gets a few thousand
    numbers at a time.
    """
    return {name: _joined(entry, encode) if isinstance(entry, list | tuple) else entry for name, entry in value.items()}


def _joined(entry: Sequence[object], encode: Callable[[object], bytes]) -> object:
    row = entry[0] if entry else None
    if isinstance(row, list):
        parts = [encode(_joined(item, encode) if isinstance(item, list) else item) for item in entry]
    elif len(entry) > LONG:
        parts = [encode(entry[i : i + LONG])[1:-1] for i in range(0, len(entry), LONG)]
    else:
        return entry
    return msgspec.Raw(b"[" + b",".join(parts) + b"]")
