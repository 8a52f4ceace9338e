"""Bytes of payloads and attachments, without a session. README.md has the tables."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
from msgspec import Struct

from uwserver.adapter import EncodingName, SampleForm, Undecodable, decode, in_pieces
from uwserver.ports import Fault, Refused, Sample

PAYLOAD_LIMIT = 1 << 20
"""Longest payload of a command or call, bytes."""
ATTACHMENT_LIMIT = 1024
"""Longest attachment taken, bytes."""
TEXT_LIMIT = 2000
CLIENT_LIMIT = 64
"""Longest client id, characters."""

_MEDIA: dict[EncodingName, str] = {"json": "application/json", "msgpack": "application/msgpack"}
_UNSAID = ("", "zenoh/bytes", "zenoh/string", "text/plain", "text/json")
"""What a client that says nothing of its encoding sends: taken as JSON."""


class SampleMeta(Struct):
    """Attachment of a sample: all of it but the value."""

    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool


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

    def payload(self, form: SampleForm, sample: Sample) -> bytes:
        """The values of a sample."""
        value = form.value(sample)
        return self.encode(in_pieces(value, self.encode) if form.is_long and self.name == "json" else value)

    def attachment(self, sample: Sample) -> bytes:
        """What goes with the payload of a sample."""
        return self.encode(SampleMeta(sample.port, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid))


def encoding_of(media: str, default: EncodingName) -> EncodingName:
    """The encoding in which a request came, and in which it is answered; `default` where it brought no payload.

    Raises:
        Refused: something else than JSON or msgpack.
    """
    kind = media.partition(";")[0].strip().lower()
    if kind in _UNSAID:
        return default if not kind else "json"
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


def _decode(data: bytes, encoding: EncodingName, limit: int, what: str) -> object:
    if len(data) > limit:
        raise Refused("too_large", f"the {what} holds at most {limit} bytes, this one has {len(data)}", what)
    try:
        return decode(data, encoding)
    except Undecodable as error:
        if error.is_valid:
            raise Refused("invalid_request", f"the {what}: {error}", what) from None
        raise Refused("parse_error", f"the {what} is no {encoding} ({error})", what) from None
