"""The shapes of docs/reference/protocol.md in their two encodings, not yet framed for a transport."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import msgspec
from msgspec import Struct

from uwserver.adapter import SampleForm, in_pieces
from uwserver.ports import ErrorCode, Event, Fault, Json, Progress, Sample

TEXT_LIMIT = 2000
"""Longest text in an error, characters: what a peer sent must not come back at full length."""

RequestId = int | str | None
"""None: a notification, or a message whose id could not be read."""

_NUMBERS: Mapping[str, int] = {
    "parse_error": -32700,
    "invalid_request": -32600,
    "unknown_method": -32601,
    **dict.fromkeys(
        ("bad_argument", "unknown_port", "unknown_service", "out_of_range", "bad_shape", "not_finite"), -32602
    ),
}
_OTHER_NUMBER = -32000


class _Reply(Struct, tag_field="jsonrpc", tag="2.0"):
    id: RequestId
    result: object


class _ErrorDetail(Struct):
    code: ErrorCode
    where: str


class _ErrorBody(Struct):
    code: int
    message: str
    data: _ErrorDetail


class _Error(Struct, tag_field="jsonrpc", tag="2.0"):
    id: RequestId
    error: _ErrorBody


class _Sample(Struct, gc=False):
    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: object


class _Progress(Struct):
    id: RequestId
    fraction: float
    t_ns: int


class _Notice(Struct, tag_field="jsonrpc", tag="2.0", gc=False):
    method: str
    params: _Sample | _Progress | Event


def sample_notice(port: str, seq: int, t_ns: int, t_sent_ns: int, valid: bool, value: object) -> Struct:
    """The message of a sample, for an encoder; `value`: by field, for that encoder too."""
    return _Notice("sample", _Sample(port, seq, t_ns, t_sent_ns, valid, value))


class Encoding:
    """One encoding of the shapes that the server says.

    Attributes:
        name: as `hello` tells it.
        encode: an object, not framed.
    """

    def __init__(self, name: str, encode: Callable[[object], bytes]) -> None:
        self.name = name
        self.encode = encode
        self._is_binary = name == "msgpack"

    def reply(self, request: RequestId, result: object) -> bytes:
        """The answer to a request; raises TypeError, ValueError or OverflowError for a result that has no such encoding."""
        return self.encode(_Reply(request, result))

    def error(self, request: RequestId, fault: Fault) -> bytes:
        """The refusal of a request."""
        detail = _ErrorDetail(fault.code, _abridged(fault.where))
        body = _ErrorBody(_NUMBERS.get(fault.code, _OTHER_NUMBER), _abridged(fault.text), detail)
        return self.encode(_Error(request, body))

    def sample(self, form: SampleForm, sample: Sample) -> bytes:
        """What a sensor said."""
        if form.is_long and not self._is_binary:
            value: object = in_pieces(form.value(sample), self.encode)
        else:
            value = form.encodable(sample, self._is_binary)
        return self.encode(sample_notice(sample.port, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid, value))

    def event(self, event: Event) -> bytes:
        """What every client should know."""
        return self.encode(_Notice("event", event))

    def notice(self, method: str, params: dict[str, Json]) -> bytes:
        """What a server says unasked besides."""
        return self.encode({"jsonrpc": "2.0", "method": method, "params": params})

    def progress(self, request: RequestId, progress: Progress) -> bytes:
        """How far a call has come."""
        return self.encode(_Notice("progress", _Progress(request, progress.fraction, progress.t_ns)))

    def raw(self, result: object) -> msgspec.Raw:
        """A result encoded once, to be given to `reply` any number of times."""
        return msgspec.Raw(self.encode(result))


# Encoders keep nothing between two messages; msgspec writes every float that is not finite as null in JSON.
JSON: Final = Encoding("json", msgspec.json.Encoder().encode)
MSGPACK: Final = Encoding("msgpack", msgspec.msgpack.Encoder().encode)


def _abridged(text: str) -> str:
    return text if len(text) <= TEXT_LIMIT else f"{text[:TEXT_LIMIT]}..."
