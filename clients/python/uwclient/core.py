"""The protocol without a socket and without a clock: bytes in, messages out; requests in, bytes out.

The schema is in docs/reference/protocol.md. Both encodings carry the same maps.
"""

from __future__ import annotations

import importlib
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, Union, cast

from uwclient import wire
from uwclient.buffers import as_binary, as_text
from uwclient.errors import CallRefused, ProtocolError, UwError, install_command
from uwclient.ports import Event, Progress, Sample
from uwclient.wire import RequestId

LINE_LIMIT = 512 << 10
"""Longest JSON line that the server accepts, bytes."""
FRAME_LIMIT = 2 << 20
"""Longest frame that the server accepts, bytes."""
ANSWER_LIMIT = 16 << 20
"""Longest frame or JSON line that is accepted from the server, bytes."""
_LENGTH = struct.Struct(">I")


@dataclass(frozen=True)
class Reply:
    """The answer to the request `id`. If `id` is None, it reports the failure of a notification."""

    id: RequestId | None
    result: object = None
    error: CallRefused | None = None


Message = Union[Reply, Sample, Event, Progress]


class Framing(Protocol):
    """One encoding of one connection. It keeps the bytes of an unfinished message."""

    def encode(self, message: Mapping[str, object]) -> bytes:
        """Return a framed message. Raises CallRefused if it cannot be sent."""
        ...

    def feed(self, data: bytes) -> list[object]:
        """Take in bytes, and return the messages that they complete. Raises ProtocolError."""
        ...


class JsonLines:
    """A JSON object on each line, in UTF-8, with LF or CRLF."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def encode(self, message: Mapping[str, object]) -> bytes:
        """Return one line. Raises CallRefused (`not_finite`, `bad_argument`, `too_large`)."""
        try:
            line = json.dumps(message, allow_nan=False, separators=(",", ":"), default=as_text).encode("ascii") + b"\n"
        except ValueError as error:
            raise CallRefused(f"not a finite number in the request ({error})", code="not_finite") from None
        except TypeError as error:
            raise CallRefused(f"the request cannot be sent as JSON: {error}", code="bad_argument") from None
        return _within(line, LINE_LIMIT, "a JSON line")

    def feed(self, data: bytes) -> list[object]:
        """Take in bytes, and return the objects of the lines that they complete. Raises ProtocolError."""
        self._rest += data
        if len(self._rest) > ANSWER_LIMIT and b"\n" not in self._rest:
            raise ProtocolError(f"the server sent a line of more than {ANSWER_LIMIT} bytes", code="protocol")
        if b"\n" not in data:
            return []
        *lines, self._rest = self._rest.split(b"\n")
        return [_parse_line(bytes(line)) for line in lines if line.strip()]


def _parse_line(line: bytes) -> object:
    try:
        return cast("object", json.loads(line.decode("utf-8")))
    except (ValueError, RecursionError):
        start = line[:60].decode("utf-8", "replace")
        raise ProtocolError(
            f"what answers is not uwserver: it sent {start!r}; check host and port", code="protocol"
        ) from None


class _Msgpack(Protocol):
    def packb(self, message: object, default: Callable[[object], object]) -> bytes: ...

    def unpackb(self, data: bytes) -> object: ...


class MsgpackFrames:
    """Frames of a u32 big-endian length and one msgpack map. Needs the `msgpack` package."""

    def __init__(self) -> None:
        try:
            self._msgpack = cast(_Msgpack, importlib.import_module("msgpack"))
        except ImportError:
            raise UwError(
                f'encoding="msgpack" needs the msgpack package: {install_command("uwclient[msgpack]")} (or use "json")',
                code="missing_package",
            ) from None
        self._rest = bytearray()

    def encode(self, message: Mapping[str, object]) -> bytes:
        """Return one frame. Raises CallRefused (`bad_argument`, `too_large`)."""
        try:
            body = self._msgpack.packb(message, default=as_binary)
        except (TypeError, ValueError, OverflowError) as error:
            raise CallRefused(f"the request cannot be sent as msgpack: {error}", code="bad_argument") from None
        # The first byte of the length must be 0, because it tells the server that this connection is binary.
        _within(body, FRAME_LIMIT, "a frame")
        return _LENGTH.pack(len(body)) + body

    def feed(self, data: bytes) -> list[object]:
        """Take in bytes, and return the maps of the frames that they complete. Raises ProtocolError."""
        self._rest += data
        messages: list[object] = []
        start = 0
        while len(self._rest) - start >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._rest, start)
            if length > ANSWER_LIMIT:
                raise ProtocolError(
                    f"what answers is not uwserver: it announced a frame of {length} bytes; check host and port",
                    code="protocol",
                )
            end = start + _LENGTH.size + length
            if len(self._rest) < end:
                break
            messages.append(self._unpack(bytes(self._rest[start + _LENGTH.size : end])))
            start = end
        del self._rest[:start]
        return messages

    def _unpack(self, body: bytes) -> object:
        try:
            return self._msgpack.unpackb(body)
        except (ValueError, TypeError, RecursionError) as error:
            raise ProtocolError(f"the server sent a frame that is no msgpack: {error}", code="protocol") from None


def framing(encoding: str) -> Framing:
    """Return new framing for "json" or "msgpack". Raises UwError for any other encoding."""
    if encoding == "json":
        return JsonLines()
    if encoding == "msgpack":
        return MsgpackFrames()
    raise UwError(f'unknown encoding "{encoding}"; it is "json" or "msgpack"', code="bad_argument", where="encoding")


class Wire:
    """The requests and messages of one client over any number of consecutive connections.

    Request ids count up during the life of the client, so a late reply is never taken for another one.
    """

    def __init__(self, encoding: str = "json") -> None:
        self._encoding = encoding
        self._framing = framing(encoding)
        self._last_id = 0

    def restart(self) -> None:
        """Forget an unfinished message, because a new connection begins."""
        self._framing = framing(self._encoding)

    def request(self, method: str, params: Mapping[str, object]) -> tuple[int, bytes]:
        """Return id and bytes of a request. Raises CallRefused if its params cannot be sent."""
        self._last_id += 1
        message = {"jsonrpc": "2.0", "id": self._last_id, "method": method, "params": dict(params)}
        return self._last_id, self._framing.encode(message)

    def notification(self, method: str, params: Mapping[str, object]) -> bytes:
        """Return the bytes of a request that gets no reply. Raises CallRefused if its params cannot be sent."""
        return self._framing.encode({"jsonrpc": "2.0", "method": method, "params": dict(params)})

    def receive(self, data: bytes) -> list[Message]:
        """Take in bytes in pieces of any size, and return the messages that they complete. Raises ProtocolError."""
        messages = [_message(entry) for entry in self._framing.feed(data)]
        return [message for message in messages if message is not None]


def _message(entry: object) -> Message | None:
    data = wire.as_map(entry, "a message")
    method = data.get("method")
    if method == "sample":
        return Sample.from_wire(data.get("params"))
    if method == "event":
        return Event.from_wire(data.get("params"))
    if method == "progress":
        return Progress.from_wire(data.get("params"))
    if method is not None:
        return None  # a notification of a later server, which is ignored
    if "error" in data:
        return Reply(wire.request_id(data), error=_refusal(data["error"]))
    if "result" in data:
        return Reply(wire.request_id(data), data["result"])
    raise ProtocolError(
        "what answers is not uwserver: a message is neither reply nor notification; check host and port",
        code="protocol",
    )


def _refusal(value: object) -> CallRefused:
    error = wire.as_map(value, "an error")
    detail = error.get("data")
    data = wire.as_map(detail, "error data") if detail is not None else {}
    return CallRefused(
        wire.text(error, "message", "refused without a reason"),
        code=wire.text(data, "code", str(error.get("code", "error"))),
        where=wire.text(data, "where", ""),
    )


def _within(data: bytes, limit: int, what: str) -> bytes:
    if len(data) > limit:
        raise CallRefused(f"the request is too large: {len(data)} bytes, {what} holds {limit}", code="too_large")
    return data
