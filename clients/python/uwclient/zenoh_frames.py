"""Turns what comes from zenoh into frames of the native protocol, and frames into requests. No zenoh here, and no input or output.

The value of a sample is not decoded for that: its bytes are put into the frame, which the session then decodes once.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Union, cast

from uwclient import wire
from uwclient.buffers import unpacked
from uwclient.core import framing
from uwclient.errors import ProtocolError, UwError

RAW = "application/octet-stream"
"""Media type of a sample whose payload is its only value, bytes or a buffer. Field, dtype and shape are in the attachment."""
MEDIA = {"json": "application/json", "msgpack": "application/msgpack"}
_JSON_SAMPLE = b'{"port":'
_MSGPACK_SAMPLE = b"\x85\xa4port"
"""First bytes of the attachment of a sample: a map of five entries, of which the first is `port`. That of a raw sample has more entries."""
_RAW_MSGPACK = (b"\x86\xa4port", b"\x88\xa4port")

RequestId = Union[int, str]


class Frames:
    """Makes and reads frames of one encoding."""

    def __init__(self, encoding: str) -> None:
        self.encoding = encoding
        self.media = MEDIA.get(encoding, "")
        self._framing = framing(encoding)

    def requests(self, data: bytes) -> list[dict[str, object]]:
        """Return the requests in whole frames."""
        return [wire.as_map(entry, "a request") for entry in self._framing.feed(data)]

    def payload(self, value: object) -> bytes:
        """Encode the payload of a command or call. Raises CallRefused."""
        frame = self._framing.encode(cast("Mapping[str, object]", value))
        return frame[4:] if self.encoding == "msgpack" else frame[:-1]

    def result(self, identity: RequestId, value: object) -> bytes:
        """Return the frame of a reply."""
        return self._framing.encode({"jsonrpc": "2.0", "id": identity, "result": value})

    def refusal(self, identity: RequestId | None, code: str, message: str, where: str = "") -> bytes:
        """Return the frame of a refusal."""
        error = {"code": -32000, "message": message, "data": {"code": code, "where": where}}
        return self._framing.encode({"jsonrpc": "2.0", "id": identity, "error": error})

    def refused(self, identity: RequestId | None, payload: bytes, media: str) -> bytes:
        """Return the frame of a refusal that the server sent as the error of a query or of a put."""
        try:
            fault = wire.as_map(self.decoded(payload, media), "an error")
            return self.refusal(
                identity, wire.text(fault, "code"), wire.text(fault, "message"), wire.text(fault, "where", "")
            )
        except UwError:
            return self.refusal(identity, "error", payload[:200].decode("utf-8", "replace"))

    def notice(self, method: str, payload: bytes, media: str) -> bytes:
        """Return the frame of an event or of progress; b"" if the payload is none."""
        try:
            return self._framing.encode(
                {"jsonrpc": "2.0", "method": method, "params": wire.as_map(self.decoded(payload, media), method)}
            )
        except UwError:
            return b""

    def decoded(self, payload: bytes, media: str) -> object:
        """Decode a payload of either encoding. Raises ProtocolError."""
        if media == MEDIA["msgpack"]:
            entries = framing("msgpack").feed(len(payload).to_bytes(4, "big") + payload)
            if not entries:
                raise ProtocolError("the server sent a payload that is no msgpack", code="protocol")
            return entries[0]
        try:
            return cast("object", json.loads(payload))
        except (ValueError, RecursionError) as error:
            raise ProtocolError(f"the server sent a payload that is no JSON: {error}", code="protocol") from None

    def sample(self, payload: bytes, attachment: bytes, media: str) -> bytes:
        """Return the frame of a sample; b"" if it is none, such as a command of another client, which has no such attachment."""
        if media != self.media:
            return self._transcoded(payload, attachment, media)
        if self.encoding == "json":
            if not attachment.startswith(_JSON_SAMPLE) or b"\n" in payload or b"\n" in attachment:
                return b""
            head = b'{"jsonrpc":"2.0","method":"sample","params":'
            return b"".join((head, attachment[:-1], b',"value":', payload, b"}}\n"))
        if not attachment.startswith(_MSGPACK_SAMPLE):
            return b""
        params = b"\x86" + attachment[1:] + b"\xa5value" + payload
        body = b"\x82\xa6method\xa6sample\xa6params" + params
        return len(body).to_bytes(4, "big") + body

    def _transcoded(self, payload: bytes, attachment: bytes, media: str) -> bytes:
        if media not in (RAW, *MEDIA.values()):
            return b""
        return self.selected(payload, attachment, media, None)

    def meta(self, attachment: bytes, media: str) -> dict[str, object]:
        """Return the attachment of a sample as a map; {} if it is none."""
        if not attachment.startswith((_JSON_SAMPLE, _MSGPACK_SAMPLE, *_RAW_MSGPACK)):
            return {}
        if media == RAW:
            media = MEDIA["json" if attachment.startswith(_JSON_SAMPLE) else "msgpack"]
        try:
            return wire.as_map(self.decoded(attachment, media), "an attachment")
        except UwError:
            return {}

    def selected(self, payload: bytes, attachment: bytes, media: str, fields: Sequence[str] | None) -> bytes:
        """Return the frame of a sample with these fields only (None for all), decoded and encoded again."""
        meta = self.meta(attachment, media)
        if not meta:
            return b""
        try:
            value = _raw(payload, meta) if media == RAW else wire.as_map(self.decoded(payload, media), "a value")
            value = {name: unpacked(entry) for name, entry in value.items()}
            if fields is not None:
                value = {name: entry for name, entry in value.items() if name in fields}
            return self._framing.encode(
                {"jsonrpc": "2.0", "method": "sample", "params": {**meta, "value": _null(value)}}
            )
        except UwError:
            return b""


def _raw(payload: bytes, meta: dict[str, object]) -> dict[str, object]:
    """Return the value of a raw sample, and leave in `meta` only what every sample has."""
    form: dict[str, object] = {key: meta.pop(key) for key in ("dtype", "shape") if key in meta}
    return {str(meta.pop("field", "")): {**form, "data": payload}}


def _null(value: object) -> object:
    """Return `value` with None in place of NaN and infinities, which JSON does not have."""
    if isinstance(value, float) and value - value != 0.0:
        return None
    if isinstance(value, list):
        return [_null(entry) for entry in cast("list[object]", value)]
    if isinstance(value, dict):
        return {name: _null(entry) for name, entry in cast("dict[str, object]", value).items()}
    return value
