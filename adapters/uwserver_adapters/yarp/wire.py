"""Connections of YARP, both sides, without sockets: the carriers text, text_ack, tcp and fast_tcp.

As in robotology/yarp (`AbstractCarrier`, `TextCarrier`, `PortCommand`, `PortCoreInputUnit`), read in its source and tried with its tools. A
connection begins with eight bytes that name the carrier, and with the sender's name. Messages follow: a command of one letter, sometimes with an
envelope, and for some commands a bottle.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Literal, NamedTuple, cast

from uwserver.ports import Refused
from uwserver_adapters.yarp.bottle import Value, from_binary, from_text, to_binary, to_text

Carrier = Literal["tcp", "fast_tcp", "text", "text_ack"]
CARRIERS: tuple[Carrier, ...] = ("tcp", "fast_tcp", "text", "text_ack")

MESSAGE_LIMIT = 1 << 20
"""Longest binary message that is read, bytes."""
LINE_LIMIT = 1 << 12
"""Longest line, bytes: reading one of escaped characters takes a millisecond."""
NAME_LIMIT = 1000
"""Longest name of a sender, bytes, as in YARP itself."""
_MAGIC = 7777
_TCP, _ACKS = 3, 128
_I32 = struct.Struct("<i")
_INDEX = 10
_WORDS = {b"CONNECT ": "text", b"CONNACK ": "text_ack"}
_WITH_BOTTLE = ("d", "D", "a")
"""Commands that are followed by a bottle."""


class Hello(NamedTuple):
    """The beginning of a connection."""

    carrier: Carrier
    sender: str


class YarpMessage(NamedTuple):
    """One message.

    Attributes:
        key: the command: d (data), D (data without an answer), a (administration), r (reverse), q (quit), /, !, ~ (connections), * or ?.
        text: the whole command, with an envelope or the name of a port.
        values: values of the bottle; empty where the command has none.
        fault: why the bottle cannot be read; None where it can.
    """

    key: str
    text: str
    values: Sequence[Value]
    fault: Refused | None = None


# -- writing ------------------------------------------------------------------------------------------------------------------------------


def is_text(carrier: Carrier) -> bool:
    """Return whether a carrier sends lines of text."""
    return carrier in ("text", "text_ack")


def _number(value: int) -> bytes:
    return b"YA" + _I32.pack(value) + b"RP"


def hello(carrier: Carrier, sender: str) -> bytes:
    """Return the first bytes that the connecting side sends."""
    if is_text(carrier):
        return (b"CONNECT " if carrier == "text" else b"CONNACK ") + sender.encode() + b"\r\n"
    name = sender.encode() + b"\0"
    return _number(_MAGIC + _TCP + (_ACKS if carrier == "tcp" else 0)) + _I32.pack(len(name)) + name


def welcome(carrier: Carrier, sender: str, port: int) -> bytes:
    """Return the answer to the hello; `port` is our TCP port."""
    return f"Welcome {sender}\r\n".encode() if is_text(carrier) else _number(port)


def payload(text: bool, values: Sequence[Value]) -> bytes:
    """Return a bottle as it stands in messages and answers.

    Args:
        text: whether the carrier sends lines.
        values: the bottle.
    """
    return to_text(values).encode("utf-8", "replace") + b"\r\n" if text else to_binary(values)


def message(text: bool, command: str, body: bytes = b"") -> bytes:
    """Return a message.

    Args:
        text: whether the carrier sends lines.
        command: one letter, or more.
        body: a `payload`, where the command has one.
    """
    if text:
        return command.encode() + b"\r\n" + body
    if len(command) == 1:
        blocks = [_I32.pack(0) + b"~" + command.encode() + b"\0\1"]
    else:
        words = command.encode() + b"\0"
        blocks = [_I32.pack(len(words)) + b"~\0\0\1", words]
    if body:
        blocks.append(body)
    lengths = b"".join(_I32.pack(len(block)) for block in blocks)
    return _number(_INDEX) + bytes((len(blocks), 1)) + b"\xff" * 8 + lengths + _I32.pack(0) + b"".join(blocks)


def acknowledgement(carrier: Carrier) -> bytes:
    """Return the acknowledgement of a message; it is empty on carriers without acknowledgements."""
    return {"tcp": _number(0), "text_ack": b"<ACK>\r\n"}.get(carrier, b"")


# -- reading ------------------------------------------------------------------------------------------------------------------------------


class Decoder:
    """Splits the bytes of a peer that connects to us: first a `Hello`, then messages. `receive` stores, `next_event` parses."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._searched = 0
        self._command = ""
        self._hello: Hello | None = None

    @property
    def waiting(self) -> int:
        """Number of stored bytes."""
        return len(self._buffer)

    def receive(self, data: bytes) -> None:
        """Store bytes in pieces of any size."""
        self._buffer += data

    def next_event(self) -> Hello | YarpMessage | None:
        """Return the next event; None until more bytes come.

        Raises:
            Refused: the bytes are no YARP, or too long. The connection must be ended.
        """
        if self._hello is None:
            self._hello = self._first()
            return self._hello
        return self._next_command() if is_text(self._hello.carrier) else self._next_message()

    # -- the beginning --------------------------------------------------------------------------------------------------------------------

    def _first(self) -> Hello | None:
        buffer = self._buffer
        if len(buffer) < 8:
            return None
        magic = bytes(buffer[:8])
        if magic in _WORDS:
            line = self._line(NAME_LIMIT + 8)
            return None if line is None else Hello(cast(Carrier, _WORDS[magic]), line[8:].strip())
        kind = self._number_at(0) - _MAGIC
        if kind < 0 or kind % 16 != _TCP:
            raise Refused("invalid_request", f"this port takes the carriers {', '.join(CARRIERS)}, and no others")
        if len(buffer) < 12:
            return None
        (size,) = _I32.unpack_from(buffer, 8)
        if not 1 <= size <= NAME_LIMIT:
            raise Refused("too_large", f"a sender's name has 1 to {NAME_LIMIT} bytes, not {size}")
        if len(buffer) < 12 + size:
            return None
        name = bytes(buffer[12 : 12 + size]).rstrip(b"\0").decode("utf-8", "replace")
        del buffer[: 12 + size]
        return Hello("tcp" if kind & _ACKS else "fast_tcp", name)

    def _line(self, limit: int) -> str | None:
        """Return the next line, without its end; None until more bytes come."""
        buffer = self._buffer
        end = buffer.find(b"\n", self._searched)
        self._searched = len(buffer)
        if (len(buffer) if end < 0 else end) > limit:
            raise Refused("too_large", f"a line has at most {limit} bytes here")
        if end < 0:
            return None
        line = bytes(memoryview(buffer)[:end]).decode("utf-8", "replace").strip()
        del buffer[: end + 1]
        self._searched = 0
        return line

    def _number_at(self, at: int) -> int:
        """Return the number in eight bytes of YARP; -1 where they hold none."""
        data = self._buffer
        if data[at : at + 2] != b"YA" or data[at + 6 : at + 8] != b"RP":
            return -1
        found: int = _I32.unpack_from(data, at + 2)[0]
        return found

    # -- messages -------------------------------------------------------------------------------------------------------------------------

    def _next_command(self) -> YarpMessage | None:
        while (line := self._line(LINE_LIMIT)) is not None:
            if self._command:
                command, self._command = self._command, ""
                return _with_bottle(command, line)
            if line[:1] in _WITH_BOTTLE:
                self._command = line
            elif line:
                return YarpMessage(line[0], line, ())
        return None

    def _next_message(self) -> YarpMessage | None:
        buffer = self._buffer
        if len(buffer) < 8 + _INDEX:
            return None
        if self._number_at(0) != _INDEX:
            raise Refused("parse_error", "a message begins with an index of ten bytes: YA 0A 00 00 00 RP")
        blocks = buffer[8] + buffer[9]
        start = 8 + _INDEX + 4 * blocks
        if len(buffer) < start:
            return None
        sizes = struct.unpack_from(f"<{blocks}i", buffer, 8 + _INDEX)
        size = sum(sizes)
        if any(each < 0 for each in sizes) or size > MESSAGE_LIMIT:
            raise Refused("too_large", f"a message claims {size} bytes, at most {MESSAGE_LIMIT} are read")
        if len(buffer) < start + size:
            return None
        body = bytes(memoryview(buffer)[start : start + size])
        del buffer[: start + size]
        return _of_binary(body)


def _of_binary(body: bytes) -> YarpMessage:
    if len(body) < 8 or body[4] != ord("~"):
        raise Refused("parse_error", "a message begins with a command of eight bytes: length, ~, letter, 0, 1")
    if body[5]:
        return _with_bottle(chr(body[5]), body[8:])
    end = body.find(b"\0", 8)
    if end < 0:
        raise Refused("parse_error", "the text of a command has no end")
    return _with_bottle(body[8:end].decode("utf-8", "replace"), body[end + 1 :])


def _with_bottle(command: str, body: str | bytes) -> YarpMessage:
    key = command[:1]
    if key not in _WITH_BOTTLE:
        return YarpMessage(key, command, ())
    try:
        return YarpMessage(key, command, from_text(body) if isinstance(body, str) else from_binary(body))
    except Refused as refused:
        return YarpMessage(key, command, (), refused)
