"""Payloads and attachments as bytes, without a session. README.md has the tables."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
from msgspec import Struct

from uwserver.adapter import EncodingName, SampleForm, Undecodable, decode, in_pieces, raw_field
from uwserver.adapter.pictures import jpeg, picture_place, pixels
from uwserver.ports import Buffer, Fault, Port, Refused, Sample

PAYLOAD_LIMIT = 1 << 20
"""Longest payload of a command or call, bytes; `decode` may allow less."""
ATTACHMENT_LIMIT = 1024
"""Longest attachment of a request, bytes."""
TEXT_LIMIT = 2000
"""Longest text of a refusal, characters."""
CLIENT_LIMIT = 64
"""Longest client id, characters."""

_MEDIA: dict[EncodingName, str] = {"json": "application/json", "msgpack": "application/msgpack"}
RAW = "application/octet-stream"
"""Encoding of a payload that is the bytes of a port's only field."""
_UNSAID = ("zenoh/bytes", "zenoh/string", "text/plain", "text/json")
"""Encodings that zenoh gives where a client names none; the payload is then taken as JSON."""


class SampleMeta(Struct):
    """Attachment of a sample: everything but the value."""

    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool


class RawMeta(SampleMeta, omit_defaults=True):
    """Attachment of a sample whose payload is the bytes of its only field; for a buffer it has type and shape."""

    field: str
    dtype: str = ""
    shape: tuple[int, ...] = ()


class Caller(Struct, forbid_unknown_fields=True):
    """Attachment of a command or call: the caller, and the number under which it can cancel the call and gets its progress."""

    client: str = ""
    id: int | None = None


class FaultText(Struct, omit_defaults=True):
    """A refusal; `path` is given only for a put."""

    code: str
    message: str
    where: str
    path: str = ""


class Codec:
    """One encoding.

    Attributes:
        name: json or msgpack.
        media: its name as an Encoding of zenoh.
        encode: encodes any of our values; NaN becomes null in JSON.
    """

    def __init__(self, name: EncodingName) -> None:
        self.name: EncodingName = name
        self.media: str = _MEDIA[name]
        self.encode: Callable[[object], bytes] = (
            msgspec.json.Encoder().encode if name == "json" else msgspec.msgpack.Encoder().encode
        )

    def fault(self, fault: Fault) -> bytes:
        """Return the bytes of a refusal. Long texts are cut, as they may hold what the peer sent."""
        return self.encode(FaultText(fault.code, fault.text[:TEXT_LIMIT], fault.where[:TEXT_LIMIT]))

    def sample(self, form: SampleForm, sample: Sample) -> tuple[bytes, str, bytes]:
        """Return payload, encoding and attachment of a sample. A sample whose only field is bytes or a buffer is sent as these bytes."""
        meta = (sample.port, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid)
        if form.raw is not None:
            raw = sample.value[0]
            if isinstance(raw, Buffer):
                return raw.data, RAW, self.encode(RawMeta(*meta, form.raw.name, raw.dtype, raw.shape))
        value = form.value(sample, binary=self.name == "msgpack")
        payload = self.encode(in_pieces(value, self.encode) if form.is_long and self.name == "json" else value)
        return payload, self.media, self.encode(SampleMeta(*meta))

    def picture(self, port: Port, sample: Sample) -> tuple[bytes, bytes] | None:
        """Return JPEG and attachment of the picture in a sample; None where it has no picture."""
        place = picture_place(port)
        shown = pixels(sample.value[place]) if place is not None and place < len(sample.value) else None
        if place is None or shown is None:
            return None
        meta = (sample.port, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid)
        return jpeg(shown), self.encode(RawMeta(*meta, port.fields[place].name, "", ()))


def encoding_of(media: str, default: EncodingName) -> EncodingName:
    """Return the encoding of a request, in which it is also answered; `default` where it has no payload.

    Raises:
        Refused: it is neither JSON nor msgpack.
    """
    kind = media.partition(";")[0].strip().lower()
    names: dict[str, EncodingName] = {"": default, RAW: default, **dict.fromkeys(_UNSAID, "json")}
    names |= {media: name for name, media in _MEDIA.items()}
    if kind in names:
        return names[kind]
    raise Refused(
        "bad_argument", f'encoding "{media[:80]}" is not served: send {" or ".join(_MEDIA.values())}', "encoding"
    )


def decode_map(payload: bytes | None, encoding: EncodingName) -> dict[str, object]:
    """Return the map in a payload; a missing payload is an empty map.

    Raises:
        Refused: the payload is too large, undecodable, too deep, or no map.
    """
    if not payload:
        return {}
    value = _decode(payload, encoding, PAYLOAD_LIMIT, "payload")
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise Refused(
            "invalid_request", 'the payload must be a map from names to values, like {"u": [0.1, 0.1]}', "payload"
        )
    return value


def command_value(port: Port, payload: bytes | None, media: str, encoding: EncodingName) -> dict[str, object]:
    """Return the fields in the payload of a command, which is a map or the bytes of the port's only field.

    Raises:
        Refused: as `decode_map`; or the payload is bytes, and the port has other fields.
    """
    if media.partition(";")[0].strip().lower() != RAW:
        return decode_map(payload, encoding)
    field = raw_field(port)
    if field is None:
        raise Refused(
            "bad_argument", f'"{port.path}" takes a map of fields, as {" or ".join(_MEDIA.values())}', "encoding"
        )
    _check_size(payload or b"", PAYLOAD_LIMIT, "payload")
    return {field.name: payload or b""}


def decode_caller(attachment: bytes | None) -> Caller:
    """Return the caller that an attachment names; without an attachment it is unnamed. The first byte distinguishes JSON from msgpack.

    Raises:
        Refused: the attachment is not as README.md says.
    """
    if not attachment:
        return Caller()
    value = _decode(attachment, "json" if attachment[:1] == b"{" else "msgpack", ATTACHMENT_LIMIT, "attachment")
    try:
        caller = msgspec.convert(value, Caller)
    except msgspec.ValidationError as error:
        text = f'the attachment must be empty or a map {{"client": text, "id": number}}: {error}'
        raise Refused("bad_argument", text, "attachment") from None
    if len(caller.client) > CLIENT_LIMIT or set(caller.client) & set("/*$?#@"):
        raise Refused(
            "bad_argument", f'"client" is a text of at most {CLIENT_LIMIT} characters without / * $ ? # @', "client"
        )
    return caller


def _check_size(data: bytes, limit: int, what: str) -> None:
    if len(data) > limit:
        raise Refused("too_large", f"the {what} holds at most {limit} bytes", what)


def _decode(data: bytes, encoding: EncodingName, limit: int, what: str) -> object:
    _check_size(data, limit, what)
    try:
        return decode(data, encoding)
    except Undecodable as error:
        if error.is_valid:
            raise Refused(error.fault.code, f"the {what}: {error}", what) from None
        raise Refused("parse_error", f"the {what} is no {encoding} ({error})", what) from None
