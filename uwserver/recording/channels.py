"""The JSON schemas of the channels of a recording, with units and frames: makes them from ports, and reads ports from them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec

from uwserver.ports import Field, Port
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

Whole = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
"""A number that MCAP and the times of a simulation can have."""
_JSON_TYPES = {
    "float": "number",
    "int": "integer",
    "bool": "boolean",
    "str": "string",
    "bytes": "object",
    "buffer": "object",
}


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


class SampleMessage(msgspec.Struct):
    """A message on the channel of a sensor."""

    seq: Whole
    t_ns: Whole
    t_sent_ns: Whole
    valid: bool
    value: dict[str, Any]


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


def port_schema(port: Port) -> dict[str, Any]:
    """Return the JSON schema of the messages on a port's channel."""
    value = {"type": "object", "properties": {field.name: _field_schema(field) for field in port.fields}}
    integer = {"type": "integer"}
    properties: dict[str, Any] = {"tick": integer, "source": {"type": "string"}, "value": value}
    if port.direction == "sensor":
        times = {"seq": integer, "t_ns": integer, "t_sent_ns": integer}
        properties = {**times, "valid": {"type": "boolean"}, "value": value}
    return {"title": port.path, "description": port.doc, "type": "object", "properties": properties}


def _field_schema(field: Field) -> dict[str, Any]:
    about = f"{field.doc}; unit {field.unit}" + (f"; frame {field.frame}" if field.frame else "")
    # A sensor without a value writes null.
    scalar: dict[str, Any] = {"type": [_JSON_TYPES[field.type], "null"]}
    if field.is_packed:
        base64: dict[str, Any] = {"base64": {"type": "string", "contentEncoding": "base64"}}
        if field.buffer:
            about += f"; {field.buffer}, row-major, little-endian"
            base64 |= {"dtype": {"const": field.buffer.dtype}, "shape": {"type": "array", "items": {"type": "integer"}}}
        return {**scalar, "properties": base64, "description": about}
    if not field.shape:
        return {**scalar, "description": about}
    if len(field.shape) > 1:
        about += f"; row-major, shape {'x'.join(map(str, field.shape))}"
    return {
        "type": ["array", "null"],
        "items": scalar,
        "minItems": field.size,
        "maxItems": field.size,
        "description": about,
    }


def schema_of(type_: type) -> dict[str, Any]:
    """Return the JSON schema of a Struct without references, which some viewers do not follow."""
    known = msgspec.json.schema(type_)["$defs"]

    def flat(node: Any) -> Any:
        if isinstance(node, list):
            return [flat(entry) for entry in node]
        if not isinstance(node, dict):
            return node
        return flat(known[node["$ref"].rpartition("/")[2]]) if "$ref" in node else {k: flat(v) for k, v in node.items()}

    found: dict[str, Any] = flat(known[type_.__name__])
    return found
