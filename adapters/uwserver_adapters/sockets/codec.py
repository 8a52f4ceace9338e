"""Byte streams to requests and back, without a socket and without a clock: JSON lines and msgpack frames.

Reading: `receive` only stores, `next_event` parses; a peer's fault is a `Malformed` event, never an exception. Writing: one method a shape,
each returns a whole line or frame. WebSocket is a third stream, in websocket.py.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Final, NamedTuple, Protocol

import msgspec

from uwserver.ports import Event, Fault, Progress, Sample
from uwserver_adapters.sockets.encoding import JSON, MSGPACK, Encoding, RequestId
from uwserver_adapters.sockets.requests import Malformed, Request, parse_json, parse_msgpack
from uwserver_adapters.values import SampleForm

LINE_LIMIT = 1 << 20
"""Longest JSON line or text, bytes."""
FRAME_LIMIT = 16 << 20
"""Longest msgpack frame, bytes."""


class Waiting(Enum):
    """The one value of `NEED_DATA`."""

    NEED_DATA = "need data"


NEED_DATA: Final = Waiting.NEED_DATA
"""`next_event` has nothing until more bytes come."""


class Web(Enum):
    """The one value of `WEB`."""

    WEB = "web"


WEB: Final = Web.WEB
"""The peer speaks HTTP."""


class Control(NamedTuple):
    """What the framing itself owes the peer, and whether the peer has ended the conversation."""

    data: bytes
    ends: bool


class Codec(Protocol):
    """One encoding in one framing.

    Attributes:
        encoding: in which the server speaks.
        frame: makes a body ready for the transport.
        limit: longest message taken, bytes.
    """

    encoding: Encoding
    frame: Callable[[bytes], bytes]
    limit: int

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""

    def next_event(self) -> Request | Malformed | Control | Waiting:
        """The next message in what was received."""

    def reply(self, request: RequestId, result: object) -> bytes:
        """See `Encoding`, here and below."""

    def error(self, request: RequestId, fault: Fault) -> bytes: ...

    def sample(self, form: SampleForm, sample: Sample) -> bytes: ...

    def event(self, event: Event) -> bytes: ...

    def progress(self, request: RequestId, progress: Progress) -> bytes: ...

    def raw(self, result: object) -> msgspec.Raw: ...

    def ending(self, fault: Fault | None) -> bytes:
        """What ends the conversation in this framing, for the reason of a fault or in good order."""


class Framed:
    """The writing half of a codec."""

    def __init__(self, encoding: Encoding, frame: Callable[[bytes], bytes]) -> None:
        self.encoding = encoding
        self.frame = frame

    def reply(self, request: RequestId, result: object) -> bytes:
        return self.frame(self.encoding.reply(request, result))

    def error(self, request: RequestId, fault: Fault) -> bytes:
        return self.frame(self.encoding.error(request, fault))

    def sample(self, form: SampleForm, sample: Sample) -> bytes:
        return self.frame(self.encoding.sample(form, sample))

    def event(self, event: Event) -> bytes:
        return self.frame(self.encoding.event(event))

    def progress(self, request: RequestId, progress: Progress) -> bytes:
        return self.frame(self.encoding.progress(request, progress))

    def raw(self, result: object) -> msgspec.Raw:
        return self.encoding.raw(result)

    def ending(self, fault: Fault | None) -> bytes:
        return b""


class JsonCodec(Framed):
    """JSON-RPC 2.0, one object a line. msgspec writes every float that is not finite as null."""

    def __init__(self) -> None:
        super().__init__(JSON, _line)
        self.limit = LINE_LIMIT
        self._buffer = bytearray()
        self._searched = 0
        self._skipping = False

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
                return parse_json(line)

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


class MsgpackCodec(Framed):
    """u32 big-endian length, then one msgpack map."""

    def __init__(self) -> None:
        super().__init__(MSGPACK, _length_prefixed)
        self.limit = FRAME_LIMIT
        self._buffer = bytearray()
        self._lost = False

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
        return parse_msgpack(frame)


def choose_codec(head: bytes) -> Codec | Web | None:
    """What the first bytes of a connection ask for: a codec, HTTP, or None until more bytes come."""
    if not head:
        return None
    if head[0] == 0:
        return MsgpackCodec()
    if head[:4] == b"GET ":
        return WEB
    return None if b"GET ".startswith(head) else JsonCodec()


def _line(body: bytes) -> bytes:
    return body + b"\n"


def _length_prefixed(body: bytes) -> bytes:
    return len(body).to_bytes(4, "big") + body
