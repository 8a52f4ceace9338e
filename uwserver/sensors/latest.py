"""What a sensor may know of the others of its vehicle."""

from __future__ import annotations

from typing import Protocol

from uwserver.ports import Field, Value


class Latest(Protocol):
    """A sensor as others see it, as one that repeats its readings or hears its sound."""

    @property
    def fields(self) -> tuple[Field, ...]:
        """Of its port."""

    @property
    def held(self) -> tuple[bool, tuple[Value, ...]] | None:
        """Validity and values of its last reading, errors included; None before the first."""

    @property
    def held_ns(self) -> int:
        """When that was."""

    @property
    def stream_numbers(self) -> range:
        """Numbers of its streams in the world, its own first."""

    @property
    def sensor(self) -> object:
        """The sensor itself."""

    @property
    def works(self) -> bool:
        """Whether it reads: it is switched on, and no fault keeps it silent."""
