"""The rows of autopilots (`rows`) as typed records, for Python."""

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


class Form(NamedTuple):
    """Form of a field in a row: `read` makes the value from the number there, and `write` the number from the value."""

    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


class Beside(NamedTuple):
    """Access to a field of a record that is not in its row."""

    get: Callable[[], Any]
    set: Callable[[Any], None]


def _choice(choices: Sequence[Any]) -> Form:
    """Return the form of a field that holds one of `choices`, as its index."""

    def read(code: int) -> Any:
        if not 0 <= code < len(choices):
            raise ValueError(f"{code} is no code of {', '.join(map(repr, choices))}")
        return choices[code]

    return Form(read, choices.index)


def _several(choices: Sequence[str]) -> Form:
    """Return the form of a field that holds some of `choices`, as bits."""

    def read(bits: int) -> tuple[str, ...]:
        if not 0 <= bits < 1 << len(choices):
            raise ValueError(f"{bits} are no bits of {', '.join(choices)}")
        return tuple([name for k, name in enumerate(choices) if bits >> k & 1])

    return Form(read, lambda names: sum(1 << choices.index(name) for name in names))


_FORMS: Mapping[str, Form] = {
    "mode": _choice(MODES),
    "pilot": _choice(PILOTS),
    "frame": _choice(FRAMES),
    "failsafe": _choice(REASONS),
    "given": _several(GIVEN),
    "attitude": Form(lambda q: None if math.isnan(q[0]) else q, lambda q: (NAN,) * 4 if q is None else q),
    **dict.fromkeys(
        ("leak", "armed", "waits", "looks", "blind", "settled", "astray", "entered"), _choice((False, True))
    ),
}

R = TypeVar("R", Estimate, Memory, Orders)


class _Place(NamedTuple):
    """The place of a field in a row: its first number (of 8 bytes); its length, 0 for a single number; whether the numbers are integers; its form."""

    first: int
    size: int
    is_whole: bool
    form: Form | None


@cache
def _places(form: Any) -> Mapping[str, _Place]:
    """Return the places of the fields of a dtype. Fields that are records themselves are left out."""
    places = {}
    for name in form.names:
        kind, offset = form.fields[name]
        if kind.names is None:
            places[name] = _Place(offset // 8, math.prod(kind.shape or (0,)), kind.base == np.int64, _FORMS.get(name))
    return places


class Live:
    """A typed record whose fields are in a row: reading a field gives the present value, and setting it changes the row.

    Fields are accessed by memory views, which refuse numbers of a wrong type or length before anything changes. A field of a numpy record would
    take five times as long.
    """

    __slots__ = ("_beside", "_kind", "_numbers", "_places", "_whole")

    def __init__(self, kind: type[Struct], beside: Mapping[str, Beside]) -> None:
        """Make a record of a type. `beside` gives access to the fields that are not in the row."""
        object.__setattr__(self, "_kind", kind)
        object.__setattr__(self, "_beside", beside)

    def bind_row(self, rows: Any) -> None:
        """Use this array of one row from now on."""
        set_own = partial(object.__setattr__, self)
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

    def write(self, record: Struct) -> None:
        """Set all fields to those of a record."""
        for name in self._kind.__struct_fields__:
            setattr(self, name, getattr(record, name))


def record(kind: type[R], row: Any, beside: Mapping[str, Any]) -> R:
    """Return the typed record of a row, and of the values that are not in the row.

    Raises:
        ValueError: a number is not the code of any value.
    """
    names = row.dtype.names
    plain = map(_value, row.tolist(), map(_FORMS.get, names))
    return kind(**{**dict(zip(names, plain, strict=True)), **beside})


def _value(plain: Any, form: Form | None) -> Any:
    """Return the value of a number, vector or record in a row. Every NaN becomes the object `NAN`, so that equal rows give equal records."""
    if isinstance(plain, np.ndarray):
        plain = plain.tolist()
    if isinstance(plain, list):
        # The sum is NaN if a number is.
        total = sum(plain)
        plain = tuple(plain) if total == total else tuple([NAN if x != x else x for x in plain])
    elif plain != plain:
        plain = NAN
    return plain if form is None else form.read(plain)
