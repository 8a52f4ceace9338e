"""Reads the ports of a recording from the schemas of its channels."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from uwserver.scenario.files.convert import kinds_of
from uwserver.sensors import SensorConfig
from uwserver.sensors.truth import TRUTH

_MESSAGES = {
    **{kind: table.message for kind, table in kinds_of(SensorConfig).items()},
    **{f"truth_{name}": f"True{name.capitalize()}" for name in TRUTH},
    "autopilot": "Estimate",
}
WORDS = ("string", "boolean")
"""JSON types whose values are only compared for equality; there is no distance between them."""


@dataclass(frozen=True)
class Column:
    """One field of a channel.

    Attributes:
        name: name of the field.
        unit: unit of the field; "1" when the port gives none.
        type: JSON type of an item: number, integer, boolean, string, or object for bytes and buffers.
        size: length of an array; 0 for a single value.
    """

    name: str
    unit: str
    type: str
    size: int = 0

    @property
    def is_quaternion(self) -> bool:
        """Return whether the field is an attitude, w x y z."""
        return self.size == 4 and self.name.startswith("q_")

    @property
    def is_word(self) -> bool:
        """Return whether the field is a text, a flag, bytes or a buffer."""
        return self.type in WORDS or self.type == "object"


@dataclass(frozen=True)
class Described:
    """The channel of a port.

    Attributes:
        port: path of the port.
        direction: sensor or actuator.
        columns: fields of the port.
    """

    port: str
    direction: str
    columns: tuple[Column, ...]


def message_of(about: Mapping[str, str]) -> str:
    """Return the standard message that the fields of a sensor fit; "" for none. An earlier recording names no message, so its kind decides."""
    return (
        about.get("message", _MESSAGES.get(about["kind"], "")) if about.get("direction", "sensor") == "sensor" else ""
    )


def described(topic: str, metadata: Mapping[str, str], schema: bytes) -> Described | None:
    """Return the port of a channel; None for a channel without a port, such as those of requests, hashes and events."""
    direction = metadata.get("direction", "")
    if direction not in ("sensor", "actuator"):
        return None
    try:
        fields = msgspec.json.decode(schema)["properties"]["value"]["properties"]
        columns = tuple(_column(str(name), node) for name, node in fields.items())
    except (msgspec.MsgspecError, KeyError, TypeError, AttributeError, IndexError):
        return None
    return Described(topic, direction, columns)


def _column(name: str, node: Mapping[str, Any]) -> Column:
    """Return a field from its node in the JSON schema."""
    unit = re.search(r"; unit ([^;]*)", str(node.get("description", "")))
    items = node.get("items")
    kinds = (node if items is None else items)["type"]
    size = 0 if items is None else int(node.get("maxItems", 1))
    return Column(name, unit[1] if unit else "1", kinds if isinstance(kinds, str) else kinds[0], size)
