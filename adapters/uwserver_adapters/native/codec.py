"""Byte streams to requests and back, without a socket and without a clock: JSON lines and msgpack frames.

Reading: `receive` only stores, `next_event` parses; a peer's fault is a `Malformed` event, never an exception. Writing: one method a shape,
each returns a whole line or frame. WebSocket is a third stream, in websocket.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from typing import Final, NamedTuple

import msgspec

from uwserver.adapter import Frames, Lines, SampleForm, TooLong, frame, line
from uwserver.ports import Event, Fault, Progress, Refused, Sample
from uwserver_adapters.native.encoding import JSON, MSGPACK, Encoding, RequestId
from uwserver_adapters.native.requests import Malformed, Request, id_of_json, id_of_msgpack, parse_json, parse_msgpack

LINE_LIMIT = 512 << 10
"""Longest JSON line or text, bytes: what `decode` takes at most, with texts in base64."""
FRAME_LIMIT = 2 << 20
"""Longest msgpack frame, bytes: more than `decode` takes at most, with texts and binary values."""


_lines: Final = msgspec.json.Encoder().encode_lines


class Waiting(Enum):
    """The one value of `NEED_DATA`."""

    NEED_DATA = "need data"


NEED_DATA: Final = Waiting.NEED_DATA
"""`next_event` has nothing until more bytes come."""


class Control(NamedTuple):
    """What the framing itself owes the peer, and whether the peer has ended the conversation."""

    data: bytes
    ends: bool


class Codec:
    """One encoding in one framing; a derived class says how bytes become requests.

    Args:
        encoding: in which the server speaks.
        frame: makes a body ready for the transport.

    Attributes:
        encoding, frame: as given.
        limit: longest message taken, bytes.
    """

    limit: int

    def __init__(self, encoding: Encoding, frame: Callable[[bytes], bytes]) -> None:
        self.encoding = encoding
        self.frame = frame

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        raise NotImplementedError

    def next_event(self) -> Request | Malformed | Control | Waiting:
        """The next message in what was received."""
        raise NotImplementedError

    def reply(self, request: RequestId, result: object) -> bytes:
        """See `Encoding`, here and below."""
        return self.frame(self.encoding.reply(request, result))

    def error(self, request: RequestId, fault: Fault) -> bytes:
        return self.frame(self.encoding.error(request, fault))

    def sample(self, form: SampleForm, sample: Sample) -> bytes:
        return self.frame(self.encoding.sample(form, sample))

    def together(self, messages: Sequence[msgspec.Struct]) -> bytes:
        """Messages for the encoder of this one, one behind the other, each in its frame."""
        encode, frame = self.encoding.encode, self.frame
        return b"".join([frame(encode(message)) for message in messages])

    def event(self, event: Event) -> bytes:
        return self.frame(self.encoding.event(event))

    def progress(self, request: RequestId, progress: Progress) -> bytes:
        return self.frame(self.encoding.progress(request, progress))

    def raw(self, result: object) -> msgspec.Raw:
        return self.encoding.raw(result)

    def ending(self, fault: Fault | None) -> bytes:
        """What ends the conversation in this framing, for the reason of a fault or in good order."""
        return b""


class JsonCodec(Lines, Codec):
    """JSON-RPC 2.0, one object a line. msgspec writes every float that is not finite as null."""

    def __init__(self) -> None:
        Lines.__init__(self, LINE_LIMIT)
        Codec.__init__(self, JSON, line)

    def next_event(self) -> Request | Malformed | Waiting:
        """The next line; blank ones count for nothing."""
        try:
            body = self.next_line()
        except TooLong as refused:
            return Malformed(refused.fault, id_of_json(refused.head))
        return NEED_DATA if body is None else parse_json(body)

    def together(self, messages: Sequence[msgspec.Struct]) -> bytes:
        """See `Codec.together`; in one go."""
        return _lines(messages)


class MsgpackCodec(Frames, Codec):
    """u32 big-endian length, then one msgpack map."""

    def __init__(self) -> None:
        Frames.__init__(self, FRAME_LIMIT)
        Codec.__init__(self, MSGPACK, frame)

    def next_event(self) -> Request | Malformed | Waiting:
        """The next frame."""
        try:
            body = self.next_frame()
        except Refused as refused:
            return Malformed(refused.fault, id_of_msgpack(self.head), fatal=True)
        return NEED_DATA if body is None else parse_msgpack(body)


def choose_codec(head: bytes) -> Codec:
    """What the first bytes of a connection, one at least, ask for: frames are shorter than 2^24 bytes, and begin with their length."""
    return MsgpackCodec() if head[0] == 0 else JsonCodec()
