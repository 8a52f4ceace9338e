"""The messages of docs/reference/protocol.md in JSON and msgpack: requests are read, and answers and samples are written, without frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import msgspec
from msgspec import Struct

from uwserver.adapter import SampleForm, Undecodable, decode, in_pieces, json_member, msgpack_member
from uwserver.ports import Fault, Sample

TEXT_LIMIT = 2000
"""Longest text in an error, characters: what a peer sent must not come back at full length."""
ID_LIMIT = 256
"""Longest id, characters: it comes back with every progress."""
EXAMPLE = '{"jsonrpc":"2.0","id":1,"method":"describe"}'

RequestId = int | str | None
"""The id of a request; None for a notification, or for a message whose id could not be read."""

# -- reading --------------------------------------------------------------------------------------------------------------------------


class Request(Struct, frozen=True):
    """A well-formed request. Its method and params have not been checked."""

    id: RequestId
    method: str
    params: object = None


class Malformed(Struct, frozen=True):
    """A message that is no request.

    Attributes:
        fault: what is wrong.
        id: id of the message, as far as it could be read.
        fatal: whether the connection must end, because the start of the next message is not known.
    """

    fault: Fault
    id: RequestId = None
    fatal: bool = False


def parse_json(body: bytes) -> Request | Malformed:
    """Return the request in one JSON object."""
    try:
        return _request(decode(body, "json"))
    except Undecodable as error:
        return Malformed(_fault(error, "JSON", "object"), id_of_json(body))


def parse_msgpack(body: bytes | memoryview) -> Request | Malformed:
    """Return the request in one msgpack map, after which nothing may follow."""
    try:
        return _request(decode(body, "msgpack"))
    except Undecodable as error:
        return Malformed(_fault(error, "msgpack", "map"), id_of_msgpack(body))


def id_of_json(text: bytes) -> RequestId:
    """Return the id of a request that cannot be decoded, or of which this is only the beginning; None if it cannot be read."""
    return _checked_id(json_member(text, "id"))


def id_of_msgpack(frame: bytes | memoryview) -> RequestId:
    """Return the same as `id_of_json` from a msgpack message."""
    return _checked_id(msgpack_member(frame, "id"))


def _checked_id(identity: int | str | None) -> RequestId:
    return identity if _is_id(identity) else None


def _fault(error: Undecodable, encoding: str, what: str) -> Fault:
    if error.is_valid:
        return error.fault
    return Fault(error.fault.code, f"this is no {encoding} ({error}); send one {what} at a time, like {EXAMPLE}")


_MEMBERS = ("jsonrpc", "id", "method", "params")


def _request(message: object) -> Request | Malformed:
    if isinstance(message, list):
        return _invalid(None, "batches are not served: send each request on its own")
    if not isinstance(message, dict):
        return _invalid(None, f"a request is a map, like {EXAMPLE}")
    identity = message.get("id")
    if "id" in message and not _is_id(identity):
        return _invalid(None, f'"id" must be an integer of 64 bits or a text of at most {ID_LIMIT} characters')
    unknown = next((key for key in message if key not in _MEMBERS), None)
    if unknown is not None:
        return _invalid(identity, f'a request has no member "{unknown}", only {", ".join(_MEMBERS)}')
    if message.get("jsonrpc", "2.0") != "2.0":
        return _invalid(identity, '"jsonrpc" must be "2.0"')
    method = message.get("method")
    if not isinstance(method, str):
        return _invalid(identity, f'a request names its "method", like {EXAMPLE}')
    return Request(identity, method, message.get("params"))


def _is_id(value: object) -> bool:
    if isinstance(value, str):
        return len(value) <= ID_LIMIT
    return isinstance(value, int) and not isinstance(value, bool) and -(2**63) <= value < 2**64


def _invalid(identity: RequestId, text: str) -> Malformed:
    return Malformed(Fault("invalid_request", text), identity)


# -- writing --------------------------------------------------------------------------------------------------------------------------


class Encoding(NamedTuple):
    """One encoding of the messages.

    Attributes:
        name: its name in the answer to `hello`.
        encode: encodes a message. It raises TypeError, ValueError or OverflowError for a result that has no such encoding.
    """

    name: str
    encode: Callable[[object], bytes]


# Encoders keep nothing between two messages. In JSON msgspec writes every float that is not finite as null.
JSON: Final = Encoding("json", msgspec.json.Encoder().encode)
MSGPACK: Final = Encoding("msgpack", msgspec.msgpack.Encoder().encode)

_NUMBERS: Mapping[str, int] = {
    "parse_error": -32700,
    "invalid_request": -32600,
    "unknown_method": -32601,
    **dict.fromkeys(
        ("bad_argument", "unknown_port", "unknown_service", "out_of_range", "bad_shape", "not_finite"), -32602
    ),
}
_OTHER_NUMBER = -32000


class ResultMessage(Struct, tag_field="jsonrpc", tag="2.0"):
    """The result of a request."""

    id: RequestId
    result: object


class _SampleParams(Struct, gc=False):
    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: object


class Notice(Struct, tag_field="jsonrpc", tag="2.0", gc=False):
    """A message that answers no request: a sample, an event, or progress."""

    method: str
    params: object


def error_message(request: RequestId, fault: Fault) -> Mapping[str, object]:
    """Return the message that refuses a request."""
    error = {
        "code": _NUMBERS.get(fault.code, _OTHER_NUMBER),
        "message": _abridged(fault.text),
        "data": {"code": fault.code, "where": _abridged(fault.where)},
    }
    return {"jsonrpc": "2.0", "id": request, "error": error}


def _abridged(text: str) -> str:
    return text if len(text) <= TEXT_LIMIT else f"{text[:TEXT_LIMIT]}..."


def sample_message(port: str, seq: int, t_ns: int, t_sent_ns: int, valid: bool, value: object) -> Struct:
    """Return the message of a sample. `value` is an object that the encoder writes as a map from field to value."""
    return Notice("sample", _SampleParams(port, seq, t_ns, t_sent_ns, valid, value))


def encoded_sample(encoding: Encoding, form: SampleForm, sample: Sample) -> bytes:
    """Return the message of a sample in an encoding, without a frame."""
    if form.is_long and encoding is JSON:
        value: object = in_pieces(form.value(sample), encoding.encode)
    else:
        value = form.encodable(sample, encoding is MSGPACK)
    return encoding.encode(sample_message(sample.port, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid, value))
