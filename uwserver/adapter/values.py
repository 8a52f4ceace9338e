"""Samples as the maps that any self-describing encoding (JSON, msgpack) can write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import itemgetter

import msgspec

from uwserver.ports import Field, Port, Sample, Value, binary_form

LONG = 2048
"""Numbers of a field that are encoded in one call."""


def raw_field(port: Port) -> Field | None:
    """The field of a port that has no other, where it holds bytes or a buffer."""
    return port.fields[0] if len(port.fields) == 1 and port.fields[0].is_packed else None


class SampleForm:
    """How the samples of a port become a map: all its fields, or those selected.

    Attributes:
        is_long: a field may hold more than `LONG` numbers.
        record: makes of the values of a sample what `encodable` gives; None where that takes more.
        raw: the field of a port that has no other, and that holds bytes or a buffer: a wire may carry these as they are.
    """

    def __init__(self, port: Port, selected: Sequence[str] | None = None) -> None:
        picked = [(i, field) for i, field in enumerate(port.fields) if selected is None or field.name in selected]
        self._plain = len(picked) == len(port.fields) and not any(field.is_packed for field in port.fields)
        self._deep = [(field.name, field) for _, field in picked if len(field.shape) > 1]
        self._names = [field.name for field in port.fields]
        self._picked = picked
        self._nest = tuple([(i, _splitter(field)) for i, field in picked if len(field.shape) > 1])
        is_quick = self._plain and all(map(str.isidentifier, self._names))
        record = _record_of(tuple(self._names)) if is_quick else None
        self.record = _nesting(record, self._nest) if record is not None and self._nest else record
        self.is_long = any(field.size > LONG for _, field in picked)
        self.raw = raw_field(port)

    def value(self, sample: Sample, binary: bool = False) -> dict[str, object]:
        """Field name -> number, list, or lists in lists where the field has more than one dimension; buffers in the form of
        binary encodings where that is asked for."""
        if self._plain:
            value: dict[str, object] = dict(zip(self._names, sample.value, strict=True))
            for name, field in self._deep:
                value[name] = _nested(field, value[name])  # type: ignore[arg-type]  # as the sample has it
            return value
        shaped = {field.name: _nested(field, sample.value[i]) for i, field in self._picked}
        return {name: binary_form(value) for name, value in shaped.items()} if binary else shaped

    def encodable(self, sample: Sample, binary: bool = False) -> object:
        """What an encoder of msgspec writes as the bytes of `value`: of numbers and texts in half the time of a map."""
        return self.value(sample, binary) if self.record is None else self.record(*sample.value)


def _nesting(
    record: Callable[..., object], nest: Sequence[tuple[int, Callable[[Value], object]]]
) -> Callable[..., object]:
    """The same of values of which some have more than one dimension."""

    def nested(*values: Value) -> object:
        rows: list[object] = list(values)
        for i, split in nest:
            if values[i] is not None:
                rows[i] = split(values[i])
        return record(*rows)

    return nested


@lru_cache(maxsize=1024)
def _record_of(names: tuple[str, ...]) -> Callable[..., msgspec.Struct]:
    """Makes records whose fields stand under these names on a wire. It takes 0.1 ms to define one, so ports with the same fields share it."""
    inside = [f"f{k}" for k in range(len(names))]
    return msgspec.defstruct("Value", inside, rename=dict(zip(inside, names, strict=True)), gc=False)


def _splitter(field: Field) -> Callable[[Value], object]:
    """Makes rows of the components of a value, which has more than one dimension."""
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
    """The same map for a JSON encoder, its long lists encoded already, piece by piece.

    An encoder keeps all other threads waiting until it is done. A megabyte of numbers takes it 5 ms, more than a tick; so it gets a few
    thousand at a time.
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
