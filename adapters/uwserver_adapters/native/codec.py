"""Streams of bytes to requests and back, without a socket and without a clock: JSON lines and msgpack frames.

`receive` only stores bytes, and `next_event` parses them. A mistake of a peer is a `Malformed` event, never an exception. WebSocket is a third
kind of stream, in websocket.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import msgspec

from uwserver.adapter import Frames, Lines, TooLong, frame, line
from uwserver.ports import Fault, Refused
from uwserver_adapters.native.messages import (
    JSON,
    MSGPACK,
    Encoding,
    Malformed,
    Request,
    id_of_json,
    id_of_msgpack,
    parse_json,
    parse_msgpack,
)

LINE_LIMIT = 512 << 10
"""Longest JSON line or text, bytes: the most that `decode` takes, with texts in base64."""
FRAME_LIMIT = 2 << 20
"""Longest msgpack frame, bytes: more than the most that `decode` takes, with texts and binary values."""

_encode_lines: Final = msgspec.json.Encoder().encode_lines


class Control(NamedTuple):
    """Bytes that the framing itself must send to the peer, and whether the peer has ended the conversation."""

    data: bytes
    ends: bool


class Codec:
    """One encoding in one framing. A derived class says how bytes become requests.

    Args:
        encoding: the encoding in which the server answers.
        frame: puts a message into its frame.

    Attributes:
        encoding, frame: as given.
        limit: longest message that is read, bytes.
    """

    limit: int

    def __init__(self, encoding: Encoding, frame: Callable[[bytes], bytes]) -> None:
        self.encoding = encoding
        self.frame = frame

    def receive(self, data: bytes) -> None:
        """Store bytes, in pieces of any size."""
        raise NotImplementedError

    def next_event(self) -> Request | Malformed | Control | None:
        """Return the next message of the stored bytes, or None until more bytes come."""
        raise NotImplementedError

    def message(self, message: object) -> bytes:
        """Return an encoded message in its frame. Raises like `Encoding.encode`."""
        return self.frame(self.encoding.encode(message))

    def together(self, messages: Sequence[msgspec.Struct]) -> bytes:
        """Return several messages, one after the other, each in its frame."""
        return b"".join(map(self.message, messages))

    def ending(self, fault: Fault | None) -> bytes:
        """Return the bytes that end the conversation in this framing, because of a fault or in good order."""
        return b""


class JsonCodec(Lines, Codec):
    """JSON-RPC 2.0, one object in each line. msgspec writes every float that is not finite as null."""

    def __init__(self) -> None:
        Lines.__init__(self, LINE_LIMIT)
        Codec.__init__(self, JSON, line)

    def next_event(self) -> Request | Malformed | None:
        """Return the message in the next line that is not blank."""
        try:
            body = self.next_line()
        except TooLong as refused:
            return Malformed(refused.fault, id_of_json(refused.head))
        return None if body is None else parse_json(body)

    def together(self, messages: Sequence[msgspec.Struct]) -> bytes:
        """Return several messages. The encoder writes all lines in one call."""
        return _encode_lines(messages)


class MsgpackCodec(Frames, Codec):
    """Frames of a length, u32 big-endian, and one msgpack map."""

    def __init__(self) -> None:
        Frames.__init__(self, FRAME_LIMIT)
        Codec.__init__(self, MSGPACK, frame)

    def next_event(self) -> Request | Malformed | None:
        """Return the message in the next frame."""
        try:
            body = self.next_frame()
        except Refused as refused:
            return Malformed(refused.fault, id_of_msgpack(self.head), fatal=True)
        return None if body is None else parse_msgpack(body)


def choose_codec(head: bytes) -> Codec:
    """Return the codec for a connection that begins with these bytes, at least one. A frame is shorter than 2^24 bytes, so it begins with 0."""
    return MsgpackCodec() if head[0] == 0 else JsonCodec()
