"""Base class of all tables in scenario, vehicle and device files."""

from __future__ import annotations

from typing import Annotated, TypeVar

from msgspec import Meta, Struct, structs

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Probability = Annotated[float, Meta(ge=0, le=1)]
Latitude = Annotated[float, Meta(ge=-89.9, le=89.9)]
Vector3 = tuple[float, float, float]
Name = Annotated[str, Meta(min_length=1)]
Count = Annotated[int, Meta(ge=1)]
PortNumber = Annotated[int, Meta(ge=0, le=65535)]
"""A TCP or UDP port. Where a table gives the port at which to listen, 0 takes a free one."""


class Table(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """An immutable table in which unknown keys are errors. Keys end in their unit and name their frame."""


T = TypeVar("T", bound=Table)


def with_shared_defaults(table: T) -> T:
    """Return an equal table in which each value that equals its default is the default object of the class.

    Encoders leave defaults out by identity. So equal tables give equal bytes, whether a file writes a default or not.
    """
    fields = structs.fields(type(table))
    return structs.replace(table, **{f.name: f.default for f in fields if getattr(table, f.name) == f.default})
