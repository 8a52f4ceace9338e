"""Bodies of messages to requests: the same checks for every framing; a peer's fault is a `Malformed`, never an exception."""

from __future__ import annotations

from msgspec import Struct

from uwserver.adapter import Undecodable, decode, json_member, msgpack_member
from uwserver.ports import Fault
from uwserver_adapters.native.encoding import RequestId

ID_LIMIT = 256
"""Longest id, characters: it comes back with every progress."""
EXAMPLE = '{"jsonrpc":"2.0","id":1,"method":"describe"}'


class Request(Struct, frozen=True):
    """A well-formed request; whether its method and params make sense is not the codec's to know."""

    id: RequestId
    method: str
    params: object = None


class Malformed(Struct, frozen=True):
    """A message that is no request. `fatal`: what follows cannot be told apart any more, the connection ends."""

    fault: Fault
    id: RequestId = None
    fatal: bool = False


def parse_json(body: bytes) -> Request | Malformed:
    """One JSON object."""
    try:
        return _request(decode(body, "json"))
    except Undecodable as error:
        return Malformed(_fault(error, "JSON", "object"), id_of_json(body))


def parse_msgpack(body: bytes | memoryview) -> Request | Malformed:
    """One msgpack map, and nothing after it."""
    try:
        return _request(decode(body, "msgpack"))
    except Undecodable as error:
        return Malformed(_fault(error, "msgpack", "map"), id_of_msgpack(body))


def id_of_json(text: bytes) -> RequestId:
    """The id of a request that cannot be decoded, or of which this is only the beginning; None where it cannot be read."""
    return _known(json_member(text, "id"))


def id_of_msgpack(frame: bytes | memoryview) -> RequestId:
    """The same of msgpack."""
    return _known(msgpack_member(frame, "id"))


def _known(identity: int | str | None) -> RequestId:
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
