"""What a modifier is: a seeded change of one sensor's stream, between the ideal value and the sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from uwserver.ports import Field, Value


@dataclass(slots=True)
class Measurement:
    """A reading on its way through the chain of its sensor; private to the chain, turned into an immutable Sample at its end.

    Attributes:
        values: one entry per field of the port.
        valid: the sensor could measure.
        delay_ns: simulated time from the instant to which the reading belongs until the device delivers.
        dropped: the reading is lost.
        since_ns: how long ago that instant was.
    """

    values: list[Value]
    valid: bool
    delay_ns: int = 0
    dropped: bool = False
    since_ns: int = 0


@dataclass(slots=True)
class Stream:
    """What a modifier knows of the stream it changes: its fields, its sample interval (s), and the random numbers of its own path."""

    fields: tuple[Field, ...]
    dt: float
    rng: np.random.Generator

    def index(self, name: str) -> int:
        """Position of a field that errors may be added to.

        Raises:
            ValueError: no such field, or it holds no floats, or a rotation, which no error of components leaves one; the text lists those
                that can be modified.
        """
        floats = [field.name for field in self.fields if field.type == "float" and not field.is_rotation]
        if name not in floats:
            raise ValueError(f'no field "{name}" to modify here, there are: {", ".join(floats)}')
        return next(i for i, field in enumerate(self.fields) if field.name == name)


class Modifier(Protocol):
    """One change of a stream. `memory` is all that it remembers from sample to sample, plain numbers, so that it can be saved."""

    stream: Stream
    memory: list[float]

    def apply(self, reading: Measurement) -> None:
        """Change the reading in place."""


def shifted(value: Value, offsets: Sequence[float]) -> Value:
    """A scalar or tuple plus one offset a component; missing components stay missing."""
    if isinstance(value, tuple):
        return tuple(None if v is None else v + o for v, o in zip(value, offsets, strict=True))  # type: ignore[operator]
    return None if value is None else value + offsets[0]  # type: ignore[operator]


def mapped(value: Value, function: Any) -> Value:
    """A function of each component; missing components stay missing."""
    if isinstance(value, tuple):
        return tuple(None if v is None else function(v) for v in value)
    return None if value is None else function(value)
