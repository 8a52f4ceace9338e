"""rosbridge v2 without a socket: frames of WebSocket from maps in each compression, and maps from messages of clients."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from typing import Any

import msgspec
import numpy as np
from websockets.frames import Frame, Opcode
from websockets.server import ServerProtocol

from uwserver.adapter import MESSAGE_LIMIT, Undecodable, decode
from uwserver_adapters.native.websocket import WebSocketCodec

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
"""Forms in which a client may ask to get messages."""
_TAGS = {"uint8": 64, "uint16": 69, "uint32": 70, "int8": 72, "int16": 77, "int32": 78, "float32": 85, "float64": 86}
"""CBOR tags of little-endian typed arrays (RFC 8746), of those that roslib knows."""


class Text(bytes):
    """A message of a client, as bytes."""


class MessageCodec(WebSocketCodec):
    """The codec of a WebSocket whose messages come as `Text`."""

    def __init__(self, protocol: ServerProtocol) -> None:
        super().__init__(protocol)
        self._has_heard = True

    def _complete(self, body: bytes, is_text: bool) -> None:
        self._events.append(Text(body))  # type: ignore[arg-type]  # only this adapter reads the events of this codec


def parsed(body: bytes) -> dict[str, Any]:
    """Return the map of a client's message.

    Raises:
        Undecodable: it is no JSON object, or would cost too much.
    """
    value = decode(body, "json")
    if not isinstance(value, dict):
        raise Undecodable("invalid_request", 'a message is a JSON object with an "op"')
    return value


# -- out --------------------------------------------------------------------------------------------------------------------------------------


def _hook(value: object) -> object:
    if isinstance(value, np.ndarray):
        return base64.b64encode(value.tobytes()).decode() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"no JSON of {type(value).__name__}")


_JSON = msgspec.json.Encoder(enc_hook=_hook)


def json_text(value: object) -> bytes:
    """Return the JSON of a value; NaN and infinity become null, and bytes base64."""
    return _JSON.encode(value)


def text_frame(body: bytes) -> bytes:
    """Return the frame of a text message."""
    return Frame(Opcode.TEXT, body).serialize(mask=False)


def binary_frame(body: bytes) -> bytes:
    """Return the frame of a binary message."""
    return Frame(Opcode.BINARY, body).serialize(mask=False)


def published(topic: str, message: object, compression: str) -> bytes:
    """Return the frame of a topic's message, as JSON, as JSON in a picture, or as CBOR."""
    if compression == "cbor":
        return binary_frame(cbor({"op": "publish", "topic": topic, "msg": message}))
    text = b'{"op":"publish","topic":%b,"msg":%b}' % (json_text(topic), json_text(message))
    if compression == "png":
        text = json_text({"op": "png", "data": base64.b64encode(png(text)).decode()})
    return text_frame(text)


def published_raw(topic: str, raw: bytes, t_ns: int) -> bytes:
    """Return the frame of a message that holds its ROS bytes, in CBOR, with the time at which it was sent, ns since 1970."""
    stamp = {"secs": t_ns // 1_000_000_000, "nsecs": t_ns % 1_000_000_000, "bytes": raw}
    return binary_frame(cbor({"op": "publish", "topic": topic, "msg": stamp}))


def fragments(text: bytes, size: int, number: int) -> list[bytes]:
    """Return the frames of a JSON text in pieces of at most `size` characters; `number` is the id of the pieces."""
    whole = text.decode()
    pieces = [whole[i : i + size] for i in range(0, len(whole), size)]
    return [
        text_frame(json_text({"op": "fragment", "id": str(number), "data": piece, "num": k, "total": len(pieces)}))
        for k, piece in enumerate(pieces)
    ]


def png(text: bytes) -> bytes:
    """Return a PNG whose bytes of red, green and blue are the text, padded with line feeds."""
    width = max(1, math.isqrt(len(text) // 3))
    height = -(-len(text) // (3 * width))
    text = text.ljust(3 * width * height, b"\n")
    rows = b"".join(b"\0" + text[3 * width * k : 3 * width * (k + 1)] for k in range(height))

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 1)) + chunk(b"IEND", b"")


def cbor(value: Any) -> bytes:
    """Return the CBOR (RFC 8949) of maps, lists, texts, bytes, numbers and numpy arrays."""
    parts: list[bytes] = []
    _cbor(value, parts)
    return b"".join(parts)


def _cbor(value: Any, parts: list[bytes]) -> None:
    if value is None or isinstance(value, bool | np.bool_):
        parts.append(b"\xf6" if value is None else (b"\xf5" if value else b"\xf4"))
    elif isinstance(value, int | np.integer):
        number, is_negative = int(value), int(value < 0)
        magnitude = -1 - number if is_negative else number
        if magnitude < 1 << 64:
            parts.append(_head(is_negative, magnitude))
        else:  # a bignum
            data = magnitude.to_bytes(-(-magnitude.bit_length() // 8), "big")
            parts += (_head(6, 2 + is_negative), _head(2, len(data)), data)
    elif isinstance(value, float | np.floating):
        parts.append(struct.pack(">Bd", 0xFB, value))
    elif isinstance(value, str):
        text = value.encode()
        parts += (_head(3, len(text)), text)
    elif isinstance(value, bytes | bytearray | memoryview):
        parts += (_head(2, len(value)), bytes(value))
    elif isinstance(value, dict):
        parts.append(_head(5, len(value)))
        for key, entry in value.items():
            _cbor(key, parts)
            _cbor(entry, parts)
    elif isinstance(value, np.ndarray) and value.dtype.name in _TAGS:
        data = value.astype(value.dtype.newbyteorder("<"), copy=False).tobytes()
        parts += (_head(6, _TAGS[value.dtype.name]), _head(2, len(data)), data)
    else:
        items = value.tolist() if isinstance(value, np.ndarray) else value
        parts.append(_head(4, len(items)))
        for item in items:
            _cbor(item, parts)


def _head(major: int, number: int) -> bytes:
    if number < 24:
        return bytes([major << 5 | number])
    for width, (code, form) in {1: (24, ">BB"), 2: (25, ">BH"), 4: (26, ">BI"), 8: (27, ">BQ")}.items():
        if number < 1 << 8 * width:
            return struct.pack(form, major << 5 | code, number)
    raise ValueError(f"{number} is too large for CBOR")


# -- fragments of clients ---------------------------------------------------------------------------------------------------------------------

SETS = 16
"""Most incomplete messages in pieces of one client."""


class Gathered:
    """Collects the messages that a client sends in pieces.

    Their number is bounded, and so is the number of characters and pieces of all together: the oldest incomplete message is dropped first.
    """

    def __init__(self) -> None:
        self._sets: dict[str, tuple[int, dict[int, str]]] = {}
        self._size = 0

    def take(self, message: dict[str, Any]) -> bytes | None:
        """Take a piece; return the message when it is complete.

        Raises:
            Undecodable: it is no piece, or its message is too long.
        """
        name, data, num, total = (message.get(key) for key in ("id", "data", "num", "total"))
        if not (
            isinstance(data, str) and type(num) is int and type(total) is int and 0 <= num < total <= MESSAGE_LIMIT
        ):
            raise Undecodable(
                "invalid_request", "a fragment has an id, data (a text), num and total, with num below total"
            )
        key = str(name)[:200]
        known = self._sets.get(key)
        if known is None or known[0] != total:
            self._drop(key)
            while len(self._sets) >= SETS:
                self._drop(next(iter(self._sets)))
            known = self._sets[key] = (total, {})
        pieces = known[1]
        self._size += _cost(data) - (_cost(pieces[num]) if num in pieces else 0)
        pieces[num] = data
        while self._size > MESSAGE_LIMIT:
            oldest = next(iter(self._sets))
            self._drop(oldest)
            if oldest == key:
                raise Undecodable("too_large", f"a message in fragments holds at most {MESSAGE_LIMIT} characters")
        if len(pieces) < total:
            return None
        self._drop(key)
        return "".join(pieces[k] for k in range(total)).encode()

    def _drop(self, key: str) -> None:
        _, pieces = self._sets.pop(key, (0, {}))
        self._size -= sum(map(_cost, pieces.values()))


def _cost(piece: str) -> int:
    """Return how many characters a piece counts for: an empty one counts for one."""
    return max(len(piece), 1)
