"""The ports of a recording as the schemas of its channels tell them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

WORDS = ("string", "boolean")
"""JSON types of values that are equal or not, without a distance."""


@dataclass(frozen=True)
class Column:
    """One field of a channel.

    Attributes:
        name: of the field.
        unit: as the port tells it; "1" where it tells none.
        type: of an item in JSON: number, integer, boolean, string, or object for bytes and buffers.
        size: of an array; 0 for one value.
    """

    name: str
    unit: str
    type: str
    size: int = 0

    @property
    def is_quaternion(self) -> bool:
        """Whether it is an attitude, w x y z."""
        return self.size == 4 and self.name.startswith("q_")

    @property
    def is_word(self) -> bool:
        """Whether it is a text, a flag, bytes or a buffer."""
        return self.type in WORDS or self.type == "object"


@dataclass(frozen=True)
class Described:
    """A channel of a port.

    Attributes:
        port: its path.
        direction: sensor or actuator.
        columns: its fields.
    """

    port: str
    direction: str
    columns: tuple[Column, ...]


def described(topic: str, metadata: Mapping[str, str], schema: bytes) -> Described | None:
    """The port of a channel; None for a channel that is none of a port, as those of requests, hashes and events."""
    direction = metadata.get("direction", "")
    if direction not in ("sensor", "actuator"):
        return None
    try:
        told = msgspec.json.decode(schema)["properties"]["value"]["properties"]
        columns = tuple(_column(str(name), about) for name, about in told.items())
    except (msgspec.MsgspecError, KeyError, TypeError, AttributeError, IndexError):
        return None
    return Described(topic, direction, columns)


def _column(name: str, told: Mapping[str, Any]) -> Column:
    unit = re.search(r"; unit ([^;]*)", str(told.get("description", "")))
    items = told.get("items")
    item = told if items is None else items
    kinds = item["type"]
    size = 0 if items is None else int(told.get("maxItems", 1))
    return Column(name, unit[1] if unit else "1", kinds if isinstance(kinds, str) else kinds[0], size)
