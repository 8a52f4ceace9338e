"""Makes the JSON schemas of the channels of a recording, with units and frames."""

from __future__ import annotations

from typing import Any

import msgspec

from uwserver.ports import Field, Port

_JSON_TYPES = {
    "float": "number",
    "int": "integer",
    "bool": "boolean",
    "str": "string",
    "bytes": "object",
    "buffer": "object",
}


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
