"""The newest sample of a sensor by the names of its fields, and the values of fields as arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwserver.ports import Buffer, Field, Port, Sample, Value
from uwserver.units import NANOSECONDS

_FEW = 9
"""Numbers of a value that a notebook shows."""


class Reading(Mapping[str, Any]):
    """The newest sample of a sensor: ``reading.depth`` or ``reading["depth"]`` is a number, ``reading.f_S`` an array (3,).

    Numbers with a shape are arrays of floats that cannot be written to; other fields are as the sensor gave them: float, int, bool, str, or
    `Buffer`. A missing float is NaN, as in `array`. A field with the name of one of the attributes can only be read by ``reading["..."]``.

    Attributes:
        sample: the sample as it was delivered; its `port`, `seq`, `t_ns`, `t_sent_ns`, `valid` and `value` are attributes of the reading
            too.
    """

    __slots__ = ("_fields", "sample")

    def __init__(self, port: Port, sample: Sample) -> None:
        self.sample = sample
        self._fields: tuple[Field, ...] = port.fields

    @property
    def port(self) -> str:
        """Path of the port."""
        return self.sample.port

    @property
    def seq(self) -> int:
        """Number of the sample: counts what the sensor produced."""
        return self.sample.seq

    @property
    def t_ns(self) -> int:
        """Simulation time at which the sample was true, ns."""
        return self.sample.t_ns

    @property
    def t_s(self) -> float:
        """Simulation time at which the sample was true, s."""
        return self.sample.t_ns / NANOSECONDS

    @property
    def t_sent_ns(self) -> int:
        """Simulation time of its delivery, ns."""
        return self.sample.t_sent_ns

    @property
    def valid(self) -> bool:
        """Whether the sensor could measure."""
        return self.sample.valid

    @property
    def value(self) -> tuple[Value, ...]:
        """One entry for each field of the port, as the sensor gave it: numbers, tuples of numbers; None for what is missing."""
        return self.sample.value

    def array(self, name: str) -> NDArray[Any]:
        """Return a field as an array of its shape: numbers as floats, with NaN for a missing value; a buffer as it is.

        Raises:
            KeyError: no such field.
        """
        field = self._field(name)
        return as_array(field, self._raw(field))

    def __getitem__(self, name: str) -> Any:
        field = self._field(name)
        value = self._raw(field)
        if field.shape and not field.is_packed:
            array = as_array(field, value)
            array.flags.writeable = False
            return array
        return math.nan if value is None and field.type == "float" else value

    def _raw(self, field: Field) -> Value:
        return self.sample.value[self._fields.index(field)]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self]

    def __iter__(self) -> Iterator[str]:
        return (field.name for field in self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    def __eq__(self, other: object) -> bool:
        return self.sample == (other.sample if isinstance(other, Reading) else other)

    def __hash__(self) -> int:
        return hash(self.sample)

    def _repr_png_(self) -> bytes | None:
        """Show the picture of a camera or an imaging sonar in a notebook."""
        shown = (
            value._repr_png_() for value in self.sample.value if isinstance(value, Buffer)
        )  # the protocol of notebooks
        return next((picture for picture in shown if picture is not None), None)

    def _repr_html_(self) -> str | None:
        """Show the values in a notebook, unless there is a picture."""
        if any(isinstance(value, Buffer) for value in self.sample.value):
            return None
        rows = "".join(
            f"<tr><td>{escape(field.name)}</td><td>{escape(_shown(self._raw(field)))}</td><td>{escape(field.unit)}</td>"
            f"<td>{escape(field.doc)}</td></tr>"
            for field in self._fields
        )
        remark = "" if self.valid else ", not valid"
        return f"<table><caption>{escape(self.port)} at {self.t_s:.3f} s{remark}</caption>{rows}</table>"

    def __repr__(self) -> str:
        values = "".join(f", {field.name} = {self._raw(field)!r}" for field in self._fields)
        return f"<{self.port} at {self.t_s:.6f} s{'' if self.valid else ', invalid'}{values}>"

    def _field(self, name: str) -> Field:
        for field in self._fields:
            if field.name == name:
                return field
        raise KeyError(f'{self.port} has no field "{name}"; there are: {", ".join(self)}')


def _shown(value: Value) -> str:
    """Return a value with four digits, and the first of many numbers."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple):
        few = ", ".join(_shown(each) for each in value[:_FEW])
        return f"({few}{f', … {len(value)} values' if len(value) > _FEW else ''})"
    return str(value)


def as_array(field: Field, value: Value) -> NDArray[Any]:
    """Return one value of a field as an array; a missing number is NaN."""
    if isinstance(value, Buffer) and field.type == "buffer":
        return value.array()
    if field.is_packed or field.type == "str":
        found = np.empty((), dtype=object)
        found[()] = value
        return found
    if value is None:
        return np.full(field.shape, np.nan)
    return np.array(value, dtype=float).reshape(field.shape)
