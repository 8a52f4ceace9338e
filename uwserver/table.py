"""Base of every table that a scenario, vehicle or device file holds."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Probability = Annotated[float, Meta(ge=0, le=1)]
Latitude = Annotated[float, Meta(ge=-89.9, le=89.9)]
Vector3 = tuple[float, float, float]
Name = Annotated[str, Meta(min_length=1)]


class Table(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Immutable, and a misspelt key is an error. Keys end in their unit and name their frame."""
