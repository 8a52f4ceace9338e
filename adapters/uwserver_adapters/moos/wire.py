"""The MOOS V10 wire, both sides, without input or output: 32 bytes of hello, then packets of messages, all little-endian.

::

    packet   i32 length (these 4 included) | i32 number of messages | u8 0 | messages
    message  i32 length (these 4 included) | i32 id | u8 type | u8 data type | text src | text src_aux | text community | text key
             | f64 time | f64 number | f64 number2 | text data
    text     i32 length | bytes

Source: behaviour of MOOSDB and its clients, core-moos 10.5.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Literal

from msgspec import Struct

HELLO = b"ELKS CAN'T DANCE 2/8/10".ljust(32, b"\0")
"""What a client sends first."""
PACKET_LIMIT = 1 << 20
"""Longest packet that is taken, bytes: what copies of it cost keeps all other threads waiting."""
MESSAGES_LIMIT = 2048
"""Messages in a packet, at most: C++ clients send a thousand."""
SKIP_LIMIT = 64 << 20
"""Longest packet that is passed over, bytes; what claims more is no packet."""
AT_ONCE = 64
"""Messages that are read in one call: about 0.3 ms."""
NAMES_LIMIT = 1024
"""Longest name in a message: of its variable, its client, its community; bytes."""
TEXT_LIMIT = 64 << 10
"""Longest value that is read as a text where it is not ASCII, bytes; longer ones only pass through."""

NOTIFY = "N"
REGISTER = "R"
UNREGISTER = "U"
WILDCARD_REGISTER = "*"
WILDCARD_UNREGISTER = "/"
DATA = "i"
WELCOME = "W"
POISON = "K"
TIMING = "T"
SERVER_REQUEST = "Q"
NULL = "."
COMMAND = "C"

DOUBLE = "D"
STRING = "S"
BINARY = "B"
KINDS = (DOUBLE, STRING, BINARY)

ASYNCHRONOUS = "asynchronous"
"""Key of a client's first message, and text of the welcome, when packets may come unasked."""
TIMING_KEY = "_async_timing"
SERVER_REQUEST_ID = -2
NO_NUMBER = -1.0
"""In a number field that says nothing."""

_PACKET = struct.Struct("<iiB")
_HEAD = struct.Struct("<iicc")
_LENGTH = struct.Struct("<i")
_NUMBERS = struct.Struct("<ddd")
_SHORTEST = _HEAD.size + _NUMBERS.size + 5 * _LENGTH.size

Kind = Literal["D", "S", "B"]


class Message(Struct, frozen=True, gc=False):
    """One message. Texts are UTF-8 with surrogate escapes, so that any bytes come through unchanged.

    Attributes:
        type: one character, see the constants above.
        key: name of the variable, or what the type needs.
        number, number2: NO_NUMBER where they say nothing.
        data: the value of a string or binary variable.
        kind: DOUBLE, STRING or BINARY; other characters are kept as they come.
        src: client that wrote it.
        src_aux: within that client, who.
        community: where it was first written; "" until the database fills it in.
        time: MOOS time, s.
        id: counts what a client sends; SERVER_REQUEST_ID in requests to the database and their answers.
    """

    type: str
    key: str
    number: float = NO_NUMBER
    data: bytes = b""
    kind: str = DOUBLE
    src: str = ""
    src_aux: str = ""
    community: str = ""
    time: float = 0.0
    number2: float = NO_NUMBER
    id: int = -1

    @property
    def text(self) -> str:
        """`data` as text."""
        return self.data.decode("utf-8", "surrogateescape")

    @property
    def value(self) -> float | str | bytes:
        """What a notification says, by its kind. A long string that is not ASCII is given as bytes: to read it takes too long."""
        if self.kind == DOUBLE:
            return self.number
        is_text = self.kind != BINARY and (len(self.data) <= TEXT_LIMIT or self.data.isascii())
        return self.text if is_text else self.data


class Hello(Struct, frozen=True):
    """The client speaks this wire."""


class Packet(Struct, frozen=True):
    """Messages that came together: they take effect together."""

    messages: tuple[Message, ...]


class Malformed(Struct, frozen=True):
    """The bytes are no MOOS, or more than is taken. Nothing after them can be understood; the text says what is wrong."""

    text: str


class Skipped(Struct, frozen=True):
    """A packet was too long and is thrown away as it comes; the next one can be understood. The text says how long."""

    text: str


class Reading(Struct, frozen=True):
    """A packet of many messages is being read: others may have their turn, then ask again."""


WireEvent = Hello | Packet | Malformed | Skipped | Reading
_READING = Reading()


def notify(key: str, value: float | str | bytes, time: float, src: str = "", id: int = -1) -> Message:
    """A write of a variable: a number, a text, or bytes as a binary string."""
    if isinstance(value, str):
        return Message(NOTIFY, key, data=_bytes(value), kind=STRING, src=src, time=time, id=id)
    if isinstance(value, bytes):
        return Message(NOTIFY, key, data=value, kind=BINARY, src=src, time=time, id=id)
    return Message(NOTIFY, key, number=float(value), src=src, time=time, id=id)


def wildcard(type: str, src: str, time: float, pattern: str, app: str = "*", interval_s: float = 0.0) -> Message:
    """A registration (or its end, by `type`) for all variables that match `pattern`, written by clients that match `app`."""
    text = f"AppPattern={app},VarPattern={pattern},Interval={interval_s:g}"
    return Message(type, src, data=_bytes(text), kind=STRING, src=src, time=time)


def wildcard_of(message: Message) -> tuple[str, str, float]:
    """Patterns of variable and client, and interval (s), of a wildcard registration; what is missing is "" and 0."""
    text = message.data[: 3 * NAMES_LIMIT].decode("utf-8", "surrogateescape")
    found = dict(part.split("=", 1) for part in text.split(",") if "=" in part)
    named = {key.strip().lower(): value.strip() for key, value in found.items()}
    return named.get("varpattern", ""), named.get("apppattern", ""), seconds(named.get("interval", ""))


def seconds(text: str) -> float:
    """A number of seconds in a text: 0 when it is none, or no sensible one."""
    try:
        number = float(text[:64])
    except ValueError:
        return 0.0
    return number if math.isfinite(number) and number > 0.0 else 0.0


def encode(message: Message) -> bytes:
    """The bytes of one message. Raises ValueError when `type` or `kind` is not one ASCII character, or `id` no i32."""
    src, aux = _bytes(message.src), _bytes(message.src_aux)
    community, key = _bytes(message.community), _bytes(message.key)
    data = message.data
    size = _SHORTEST + len(src) + len(aux) + len(community) + len(key) + len(data)
    length = _LENGTH.pack
    try:
        head = _HEAD.pack(size, message.id, message.type.encode("latin-1"), message.kind.encode("latin-1"))
    except (struct.error, UnicodeEncodeError) as error:
        raise ValueError(f"{message.type!r} {message.kind!r} {message.id} cannot be written: {error}") from None
    texts = (src, aux, community, key)
    head += b"".join(length(len(text)) + text for text in texts)
    return head + _NUMBERS.pack(message.time, message.number, message.number2) + length(len(data)) + data


def packet(messages: Sequence[bytes]) -> bytes:
    """A packet of encoded messages."""
    body = b"".join(messages)
    return _PACKET.pack(_PACKET.size + len(body), len(messages), 0) + body


def _bytes(text: str) -> bytes:
    try:
        return text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # half a surrogate pair, as JSON can bring it
        return text.encode("utf-8", "replace")


def readable(text: str) -> str:
    """The text, with U+FFFD for what was no UTF-8: logs and JSON cannot carry it otherwise."""
    return text if text.isascii() else _bytes(text).decode("utf-8", "replace")


class Decoder:
    """Bytes of one connection to events: `receive` stores, `next_event` parses.

    A length that a peer claims costs no memory: bytes are kept as they come, and a packet above the limit ends the connection at once.

    Args:
        expects_hello: the peer is a client, which says hello first.
        limit: longest packet, bytes.
        skips: a packet above the limit is thrown away, and the number of messages has no limit: a database whose client we are sends what
            others wrote.
    """

    def __init__(self, expects_hello: bool = False, limit: int = PACKET_LIMIT, skips: bool = False) -> None:
        self.limit = limit
        self._expects_hello = expects_hello
        self._skips = skips
        self._to_skip = 0
        self._buffer = bytearray()
        self._messages: _Messages | None = None
        self._is_broken = False

    def receive(self, data: bytes) -> None:
        """Store bytes; those after a fault are thrown away."""
        if self._to_skip:
            skipped = min(self._to_skip, len(data))
            self._to_skip -= skipped
            data = data[skipped:]
        if not self._is_broken:
            self._buffer += data

    def next_event(self) -> WireEvent | None:
        """The next packet; None until more bytes come. `Reading` when a packet has more messages than are read at once. After `Malformed`
        nothing comes any more."""
        if self._is_broken:
            return None
        if self._expects_hello:
            return self._hello()
        try:
            if self._messages is None:
                begun = self._begin()
                if begun is not None or self._messages is None:
                    return begun
            if not self._messages.read(AT_ONCE):
                return _READING
            packet = Packet(tuple(self._messages.found))
            self._messages = None
            return packet
        except _Fault as fault:
            return self._fault(str(fault))

    def _begin(self) -> WireEvent | None:
        """Take the next packet out of the buffer, if it is whole. Raises _Fault when it cannot be one."""
        buffer = self._buffer
        if len(buffer) < _LENGTH.size:
            return None
        (size,) = _LENGTH.unpack_from(buffer)
        if size < _PACKET.size:
            raise _Fault(f"a packet of {size} bytes: its header alone has {_PACKET.size}")
        if size > self.limit:
            text = f"a packet of {size} bytes: the longest that is taken has {self.limit}"
            if not self._skips or size > SKIP_LIMIT:
                raise _Fault(text)
            self._to_skip = max(0, size - len(buffer))
            del buffer[:size]
            return Skipped(text)
        if len(buffer) < size:
            return None
        with memoryview(buffer) as whole:  # a slice of it would be a copy more
            data = bytes(whole[:size])
        del buffer[:size]
        self._messages = _Messages(data, math.inf if self._skips else MESSAGES_LIMIT)
        return None

    def _hello(self) -> WireEvent | None:
        buffer = self._buffer
        if not HELLO.startswith(buffer[: len(HELLO)]):
            return self._fault(f"the first bytes are {bytes(buffer[:32])!r}, a MOOS V10 client says {HELLO!r}")
        if len(buffer) < len(HELLO):
            return None
        del buffer[: len(HELLO)]
        self._expects_hello = False
        return Hello()

    def _fault(self, text: str) -> Malformed:
        self._is_broken = True
        self._messages = None
        self._buffer.clear()
        return Malformed(text)


class _Fault(Exception):
    """What is wrong in a packet."""


class _Messages:
    """Reads the messages of a packet, some at a time.

    Attributes:
        found: those read so far.
    """

    def __init__(self, data: bytes, most: float) -> None:
        size, number, compressed = _PACKET.unpack_from(data)
        if compressed:
            raise _Fault("a compressed packet: MOOS V10 has none")
        if not 0 <= number <= (size - _PACKET.size) // _SHORTEST:
            raise _Fault(f"{number} messages in a packet of {size} bytes")
        if number > most:
            raise _Fault(f"{number} messages in a packet: the most that are taken are {most:g}")
        self.found: list[Message] = []
        self._data = data
        self._at = _PACKET.size
        self._number = number

    def read(self, most: int) -> bool:
        """Read so many more; whether these were all. Raises _Fault."""
        for _ in range(min(most, self._number - len(self.found))):
            message, self._at = _message(self._data, self._at)
            self.found.append(message)
        if len(self.found) < self._number:
            return False
        if self._at != len(self._data):
            raise _Fault(f"{len(self._data) - self._at} bytes behind the last of {self._number} messages")
        return True


def _message(data: bytes, start: int) -> tuple[Message, int]:
    if start + _SHORTEST > len(data):
        raise _Fault("the packet ends within a message")
    size, id, type, kind = _HEAD.unpack_from(data, start)
    end = start + size
    if size < _SHORTEST or end > len(data):
        raise _Fault(f"a message of {size} bytes in a packet with {len(data) - start} left")
    at = start + _HEAD.size
    texts = []
    for _ in range(4):
        raw, at = _text(data, at, end)
        if len(raw) > NAMES_LIMIT:
            raise _Fault(f"a name of {len(raw)} bytes: the longest that is taken has {NAMES_LIMIT}")
        texts.append(raw.decode("utf-8", "surrogateescape"))
    if at + _NUMBERS.size > end:
        raise _Fault("a message ends before its numbers")
    time, number, number2 = _NUMBERS.unpack_from(data, at)
    value, at = _text(data, at + _NUMBERS.size, end)
    if at != end:
        raise _Fault(f"a message has {end - at} bytes too many")
    src, aux, community, key = texts
    made = Message(
        type.decode("latin-1"), key, number, value, kind.decode("latin-1"), src, aux, community, time, number2, id
    )
    return made, end


def _text(data: bytes, at: int, end: int) -> tuple[bytes, int]:
    begin = at + _LENGTH.size
    if begin > end:
        raise _Fault("a message ends before a text")
    (length,) = _LENGTH.unpack_from(data, at)
    if not 0 <= length <= end - begin:
        raise _Fault(f"a text of {length} bytes in a message with {end - begin} left")
    return data[begin : begin + length], begin + length
