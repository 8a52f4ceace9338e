"""Rows of autopilots (`rows`) as typed records, for Python."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from msgspec import Struct

from uwserver.autopilot.rows import FRAMES, MODES, PILOTS
from uwserver.autopilot.state import GIVEN, NAN, REASONS, Estimate, Memory, Orders
from uwserver.frames import Quat


class Form(NamedTuple):
    """How a field of a record stands in a row: what `read` makes of the number there, and `write` of the value."""

    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


class Beside(NamedTuple):
    """A field of a record that lies elsewhere."""

    get: Callable[[], Any]
    set: Callable[[Any], None]


def _choice(choices: Sequence[Any]) -> Form:
    """One of some values, as its place."""

    def read(code: int) -> Any:
        if not 0 <= code < len(choices):
            raise ValueError(f"{code} is no code of {', '.join(map(repr, choices))}")
        return choices[code]

    return Form(read, choices.index)


def _several(choices: Sequence[str]) -> Form:
    """Some of some texts, as bits."""

    def read(bits: int) -> tuple[str, ...]:
        if not 0 <= bits < 1 << len(choices):
            raise ValueError(f"{bits} are no bits of {', '.join(choices)}")
        return tuple([name for k, name in enumerate(choices) if bits >> k & 1])

    return Form(read, lambda names: sum(1 << choices.index(name) for name in names))


def _read_attitude(q: Quat) -> Quat | None:
    return None if math.isnan(q[0]) else q


_TRUTH = _choice((False, True))
_FORMS: Mapping[str, Form] = {
    "mode": _choice(MODES),
    "pilot": _choice(PILOTS),
    "frame": _choice(FRAMES),
    "failsafe": _choice(REASONS),
    "given": _several(GIVEN),
    "attitude": Form(_read_attitude, lambda q: (NAN,) * 4 if q is None else q),
    **dict.fromkeys(("leak", "armed", "waits", "looks", "blind", "settled", "astray", "entered"), _TRUTH),
}

R = TypeVar("R", Estimate, Memory, Orders)


class _Place(NamedTuple):
    """Where a field of a record begins, in numbers of 8 bytes; how many it has, 0 for a single one; whether they are integers; and its form."""

    first: int
    size: int
    is_whole: bool
    form: Form | None


@cache
def _places(record: Any) -> Mapping[str, _Place]:
    """Of the fields of a type of records, but for those that are records themselves."""
    places = {}
    for name in record.names:
        kind, offset = record.fields[name]
        size = math.prod(kind.shape) if kind.shape else 0
        if kind.names is None:
            places[name] = _Place(offset // 8, size, kind.base == np.int64, _FORMS.get(name))
    return places


class Live:
    """A typed record that lies in a row: reading a field gives what stands there now, setting it changes that.

    It looks at the numbers themselves, which are not changed by what does not fit: numpy takes five times as long for a field of a record.
    """

    __slots__ = ("_beside", "_kind", "_numbers", "_places", "_row", "_whole")

    def __init__(self, kind: type[Struct], beside: Mapping[str, Beside]) -> None:
        """Of a kind of records, some of whose fields lie beside the row."""
        object.__setattr__(self, "_kind", kind)
        object.__setattr__(self, "_beside", beside)

    def lie(self, rows: Any) -> None:
        """It lies in this array of one row from now on."""
        set_own = partial(object.__setattr__, self)
        set_own("_row", rows[0])
        set_own("_places", _places(rows.dtype))
        set_own("_numbers", memoryview(rows.view(np.float64)))
        set_own("_whole", memoryview(rows.view(np.int64)))

    def __getattr__(self, name: str) -> Any:
        place = self._places.get(name)
        if place is None:
            return self._find(name).get()
        first, size, is_whole, form = place
        numbers = self._whole if is_whole else self._numbers
        return _value(numbers[first : first + size].tolist() if size else numbers[first], form)

    def __setattr__(self, name: str, value: Any) -> None:
        place = self._places.get(name)
        if place is None:
            self._find(name).set(value)
            return
        first, size, is_whole, form = place
        numbers, plain = self._whole if is_whole else self._numbers, value if form is None else form.write(value)
        if size:
            numbers[first : first + size] = array(numbers.format, plain)
        else:
            numbers[first] = plain

    def _find(self, name: str) -> Any:
        if name not in self._beside:
            raise AttributeError(f"{self._kind.__name__} has no {name}")
        return self._beside[name]

    def read(self) -> Any:
        """A copy, as a record of its kind."""
        return record(self._kind, self._row, {name: other.get() for name, other in self._beside.items()})

    def write(self, record: Struct) -> None:
        """Put another one in its place."""
        for name in self._kind.__struct_fields__:
            setattr(self, name, getattr(record, name))


def record(kind: type[R], row: Any, beside: Mapping[str, Any]) -> R:
    """What stands in a row, and beside it, as a typed record.

    Raises:
        ValueError: a number in it is the code of nothing.
    """
    names = row.dtype.names
    plain = map(_value, row.tolist(), map(_FORMS.get, names))
    return kind(**{**dict(zip(names, plain, strict=True)), **beside})


def _value(plain: Any, form: Form | None) -> Any:
    """A number, vector or record of a row as a value; all that is no number is `NAN` itself, so that equal rows give equal records."""
    kind = type(plain)
    if kind is np.ndarray:
        plain, kind = plain.tolist(), list
    if kind is list:
        total = sum(plain)
        plain = tuple(plain) if total == total else tuple([NAN if x != x else x for x in plain])
    elif plain != plain:
        plain = NAN
    return plain if form is None else form.read(plain)
