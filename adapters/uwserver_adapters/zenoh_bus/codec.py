"""Bytes of payloads and attachments, without a session. README.md has the tables."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
from msgspec import Struct

from uwserver.adapter import EncodingName, SampleForm, Undecodable, decode, in_pieces, raw_field
from uwserver.adapter.pictures import jpeg, picture_place, pixels
from uwserver.ports import Buffer, Fault, Port, Refused, Sample

PAYLOAD_LIMIT = 1 << 20
"""Longest payload of a command or call, bytes; `decode` may take less."""
ATTACHMENT_LIMIT = 1024
"""Longest attachment taken, bytes."""
TEXT_LIMIT = 2000
CLIENT_LIMIT = 64
"""Longest client id, characters."""

_MEDIA: dict[EncodingName, str] = {"json": "application/json", "msgpack": "application/msgpack"}
RAW = "application/octet-stream"
"""Of a payload that is the one value of a port, bytes or a buffer, as it is."""
_UNSAID = ("", "zenoh/bytes", "zenoh/string", "text/plain", "text/json")
"""What a client that says nothing of its encoding sends: taken as JSON."""


class SampleMeta(Struct):
    """Attachment of a sample: all of it but the value."""

    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool


class RawMeta(SampleMeta, omit_defaults=True):
    """Attachment of a sample whose payload is the bytes of its one field; of a buffer with type and shape."""

    field: str
    dtype: str = ""
    shape: tuple[int, ...] = ()


class Caller(Struct, forbid_unknown_fields=True):
    """Attachment of a command or call: who asks, and the number under which it can be cancelled and hears of progress."""

    client: str = ""
    id: int | None = None


class FaultText(Struct, omit_defaults=True):
    """What a refusal says; `path` only where a put was refused."""

    code: str
    message: str
    where: str
    path: str = ""


class Codec:
    """One encoding.

    Attributes:
        name: json or msgpack.
        media: as zenoh's Encoding says it.
        encode: any value of ours to bytes; JSON has no NaN, msgspec writes null.
    """

    def __init__(self, name: EncodingName) -> None:
        self.name: EncodingName = name
        self.media: str = _MEDIA[name]
        self.encode: Callable[[object], bytes] = (
            msgspec.json.Encoder().encode if name == "json" else msgspec.msgpack.Encoder().encode
        )

    def fault(self, fault: Fault) -> bytes:
        """A refusal. What the peer sent does not come back at full length."""
        return self.encode(FaultText(fault.code, fault.text[:TEXT_LIMIT], fault.where[:TEXT_LIMIT]))

    def sample(self, form: SampleForm, sample: Sample) -> tuple[bytes, str, bytes]:
        """Payload, encoding and attachment of a sample. One that is bytes or a buffer and nothing else goes as it is."""
        meta = (sample.port, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid)
        if form.raw is not None:
            raw = sample.value[0]
            if isinstance(raw, Buffer):
                return raw.data, RAW, self.encode(RawMeta(*meta, form.raw.name, raw.dtype, raw.shape))
        value = form.value(sample, binary=self.name == "msgpack")
        payload = self.encode(in_pieces(value, self.encode) if form.is_long and self.name == "json" else value)
        return payload, self.media, self.encode(SampleMeta(*meta))

    def picture(self, port: Port, sample: Sample) -> tuple[bytes, bytes] | None:
        """JPEG and attachment of the picture in a sample; None where there is none."""
        place = picture_place(port)
        shown = pixels(sample.value[place]) if place is not None and place < len(sample.value) else None
        if place is None or shown is None:
            return None
        meta = (sample.port, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid)
        return jpeg(shown), self.encode(RawMeta(*meta, port.fields[place].name, "", ()))


def encoding_of(media: str, default: EncodingName) -> EncodingName:
    """The encoding in which a request came, and in which it is answered; `default` where it brought no payload.

    Raises:
        Refused: something else than JSON or msgpack.
    """
    kind = media.partition(";")[0].strip().lower()
    if kind in _UNSAID:
        return default if not kind else "json"
    if kind == RAW:
        return default
    for name, known in _MEDIA.items():
        if kind == known:
            return name
    raise Refused(
        "bad_argument", f'encoding "{media[:80]}" is not served: send {" or ".join(_MEDIA.values())}', "encoding"
    )


def decode_map(payload: bytes | None, encoding: EncodingName) -> dict[str, object]:
    """The map in a payload; none at all is an empty map.

    Raises:
        Refused: too large, undecodable, too deep, or no map.
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
    """The fields in the payload of a command: a map, or the bytes of the one field that there is.

    Raises:
        Refused: as `decode_map`; or bytes for a port of other fields.
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
    """Who asks; its first byte tells JSON from msgpack. None at all is an unnamed caller.

    Raises:
        Refused: the attachment is not as README.md says.
    """
    if not attachment:
        return Caller()
    value = _decode(attachment, "json" if attachment[:1] == b"{" else "msgpack", ATTACHMENT_LIMIT, "attachment")
    try:
        caller = msgspec.convert(value, Caller)
    except msgspec.ValidationError as error:
        raise Refused(
            "bad_argument",
            f'the attachment must be empty or a map {{"client": text, "id": number}}: {error}',
            "attachment",
        ) from None
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
