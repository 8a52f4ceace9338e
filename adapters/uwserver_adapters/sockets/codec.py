"""Bytes and messages of docs/reference/protocol.md, without a socket and without a clock.

Reading: `receive` only stores, `next_event` parses; a peer's fault is a `Malformed` event, never an exception. Writing: one method a shape,
each returns a whole line or frame. The two codecs differ in their framing and encoder alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import Final, Protocol

import msgspec
from msgspec import Struct

from uwserver.ports import ErrorCode, Event, Fault, Field, Port, Progress, Sample, Value
from uwserver_adapters.sockets.nesting import json_fault, msgpack_fault

LINE_LIMIT = 1 << 20
"""Longest JSON line, bytes."""
FRAME_LIMIT = 16 << 20
"""Longest msgpack frame, bytes."""
TEXT_LIMIT = 2000
"""Longest text in an error, characters: what a peer sent must not come back at full length."""
ID_LIMIT = 256
"""Longest id, characters: it comes back with every progress."""
EXAMPLE = '{"jsonrpc":"2.0","id":1,"method":"describe"}'

HTTP_ANSWER = (
    b"HTTP/1.1 426 Upgrade Required\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n\r\n"
    b"This is uwserver: it speaks JSON lines and msgpack frames here, HTTP and WebSocket are not served.\n"
    b"Try: printf '" + EXAMPLE.encode() + b"\\n' | nc HOST PORT\n"
)

_NUMBERS: Mapping[str, int] = {
    "parse_error": -32700,
    "invalid_request": -32600,
    "unknown_method": -32601,
    **dict.fromkeys(
        ("bad_argument", "unknown_port", "unknown_service", "out_of_range", "bad_shape", "not_finite"), -32602
    ),
}
_OTHER_NUMBER = -32000

RequestId = int | str | None
"""None: a notification, or a message whose id could not be read."""


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


class Waiting(Enum):
    """The one value of `NEED_DATA`."""

    NEED_DATA = "need data"


NEED_DATA: Final = Waiting.NEED_DATA
"""`next_event` has nothing until more bytes come."""


class SampleForm:
    """How the samples of a port become a map: all its fields, or those selected."""

    def __init__(self, port: Port, selected: Sequence[str] | None = None) -> None:
        picked = [(i, field) for i, field in enumerate(port.fields) if selected is None or field.name in selected]
        self._plain = len(picked) == len(port.fields) and all(len(field.shape) < 2 for field in port.fields)
        self._names = [field.name for field in port.fields]
        self._picked = picked

    def value(self, sample: Sample) -> dict[str, object]:
        """Field name -> number, list, or lists in lists where the field has more than one dimension."""
        if self._plain:
            return dict(zip(self._names, sample.value, strict=True))
        return {field.name: _nested(field, sample.value[i]) for i, field in self._picked}


def _nested(field: Field, value: Value) -> object:
    if not isinstance(value, tuple):
        return value
    rows: list[object] = list(value)
    for extent in reversed(field.shape[1:]):
        rows = [rows[i : i + extent] for i in range(0, len(rows), extent)]
    return rows


class Codec(Protocol):
    """One encoding of one connection.

    Attributes:
        name: as `hello` tells it.
        limit: longest message taken, bytes.
    """

    name: str
    limit: int

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""

    def next_event(self) -> Request | Malformed | Waiting:
        """The next message in what was received."""

    def reply(self, request: RequestId, result: object) -> bytes:
        """The answer to a request; raises TypeError, ValueError or OverflowError for a result that has no such encoding."""

    def error(self, request: RequestId, fault: Fault) -> bytes:
        """The refusal of a request."""

    def sample(self, form: SampleForm, sample: Sample) -> bytes:
        """What a sensor said."""

    def event(self, event: Event) -> bytes:
        """What every client should know."""

    def progress(self, request: RequestId, progress: Progress) -> bytes:
        """How far a call has come."""

    def raw(self, result: object) -> msgspec.Raw:
        """A result encoded once, to be given to `reply` any number of times."""


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


class _Sample(Struct):
    port: str
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    value: dict[str, object]


class _Progress(Struct):
    id: RequestId
    fraction: float
    t_ns: int


class _Notice(Struct, tag_field="jsonrpc", tag="2.0"):
    method: str
    params: _Sample | _Progress | Event


class _Writer:
    """The shapes that both codecs write."""

    def __init__(self, encode: Callable[[object], bytes], frame: Callable[[bytes], bytes]) -> None:
        self._encode = encode
        self._frame = frame

    def reply(self, request: RequestId, result: object) -> bytes:
        return self._frame(self._encode(_Reply(request, result)))

    def error(self, request: RequestId, fault: Fault) -> bytes:
        detail = _ErrorDetail(fault.code, _abridged(fault.where))
        body = _ErrorBody(_NUMBERS.get(fault.code, _OTHER_NUMBER), _abridged(fault.text), detail)
        return self._frame(self._encode(_Error(request, body)))

    def sample(self, form: SampleForm, sample: Sample) -> bytes:
        params = _Sample(sample.port, sample.seq, sample.t_ns, sample.t_sent_ns, sample.valid, form.value(sample))
        return self._frame(self._encode(_Notice("sample", params)))

    def event(self, event: Event) -> bytes:
        return self._frame(self._encode(_Notice("event", event)))

    def progress(self, request: RequestId, progress: Progress) -> bytes:
        return self._frame(self._encode(_Notice("progress", _Progress(request, progress.fraction, progress.t_ns))))

    def raw(self, result: object) -> msgspec.Raw:
        return msgspec.Raw(self._encode(result))


class JsonCodec(_Writer):
    """JSON-RPC 2.0, one object a line. msgspec writes every float that is not finite as null."""

    def __init__(self) -> None:
        super().__init__(msgspec.json.Encoder().encode, _line)
        self.name = "json"
        self.limit = LINE_LIMIT
        self._buffer = bytearray()
        self._searched = 0
        self._skipping = False
        self._decoder = msgspec.json.Decoder()

    def receive(self, data: bytes) -> None:
        """Store bytes; the rest of a line that is too long is thrown away here, so it takes no memory."""
        if self._skipping:
            end = data.find(b"\n")
            if end < 0:
                return
            self._skipping = False
            data = data[end + 1 :]
        self._buffer += data

    def next_event(self) -> Request | Malformed | Waiting:
        """The next line; blank ones count for nothing."""
        while True:
            end = self._buffer.find(b"\n", self._searched)
            if end < 0:
                return self._unfinished()
            line = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            self._searched = 0
            if end > self.limit:
                return self._too_large()
            line = line.strip()
            if line:
                return self._parse(line)

    def _unfinished(self) -> Malformed | Waiting:
        self._searched = len(self._buffer)
        if self._searched <= self.limit:
            return NEED_DATA
        self._buffer.clear()
        self._searched = 0
        self._skipping = True
        return self._too_large()

    def _too_large(self) -> Malformed:
        return Malformed(Fault("too_large", f"a line holds at most {self.limit} bytes: the rest of it is skipped"))

    def _parse(self, line: bytes) -> Request | Malformed:
        reason = json_fault(line)
        if reason is not None:
            return Malformed(Fault("invalid_request", reason))
        try:
            message = self._decoder.decode(line)
        except (msgspec.MsgspecError, ValueError) as error:  # ValueError: no UTF-8, or a number of thousands of digits
            return Malformed(
                Fault("parse_error", f"this line is no JSON ({error}); send one object a line, like {EXAMPLE}")
            )
        return _request(message)


class MsgpackCodec(_Writer):
    """u32 big-endian length, then one msgpack map."""

    def __init__(self) -> None:
        super().__init__(msgspec.msgpack.Encoder().encode, _length_prefixed)
        self.name = "msgpack"
        self.limit = FRAME_LIMIT
        self._buffer = bytearray()
        self._lost = False
        self._decoder = msgspec.msgpack.Decoder()

    def receive(self, data: bytes) -> None:
        """Store bytes; after a frame that is too long nothing is taken any more."""
        if not self._lost:
            self._buffer += data

    def next_event(self) -> Request | Malformed | Waiting:
        """The next frame. Nothing is reserved for a length that was only claimed."""
        if len(self._buffer) < 4:
            return NEED_DATA
        length = int.from_bytes(self._buffer[:4], "big")
        if length > self.limit:
            self._lost = True
            self._buffer.clear()
            text = f"a frame holds at most {self.limit} bytes, this one claims {length}; it begins with its length as u32 big-endian"
            return Malformed(Fault("too_large", text), fatal=True)
        if len(self._buffer) < 4 + length:
            return NEED_DATA
        frame = bytes(self._buffer[4 : 4 + length])
        del self._buffer[: 4 + length]
        reason = msgpack_fault(frame)
        if reason is not None:
            return Malformed(Fault("invalid_request", reason))
        try:
            message = self._decoder.decode(frame)
        except (msgspec.MsgspecError, ValueError) as error:  # ValueError: a text that is no UTF-8
            return Malformed(
                Fault("parse_error", f"this frame is no msgpack ({error}); send one map a frame, like {EXAMPLE}")
            )
        return _request(message)


def choose_codec(head: bytes) -> Codec | bytes | None:
    """What the first bytes of a connection ask for: a codec, a last answer to a web browser, or None until more bytes come."""
    if not head:
        return None
    if head[0] == 0:
        return MsgpackCodec()
    if head[:4] == b"GET ":
        return HTTP_ANSWER
    return None if b"GET ".startswith(head) else JsonCodec()


def _line(body: bytes) -> bytes:
    return body + b"\n"


def _length_prefixed(body: bytes) -> bytes:
    return len(body).to_bytes(4, "big") + body


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


def _abridged(text: str) -> str:
    return text if len(text) <= TEXT_LIMIT else f"{text[:TEXT_LIMIT]}..."
