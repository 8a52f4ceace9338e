"""The MOOS V10 wire, both sides, without input or output: 32 bytes of greeting, then packets of messages, all little-endian.

::

    packet   i32 length (these 4 included) | i32 number of messages | u8 0 | messages
    message  i32 length (these 4 included) | i32 id | u8 type | u8 data type | text src | text src_aux | text community | text key
             | f64 time | f64 number | f64 number2 | text data
    text     i32 length | bytes

Source: the behaviour of MOOSDB and its clients, core-moos 10.5.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence

from msgspec import Struct

HELLO = b"ELKS CAN'T DANCE 2/8/10".ljust(32, b"\0")
"""The first bytes of a client."""
PACKET_LIMIT = 1 << 20
"""Longest packet that is taken, bytes: copies of it keep all other threads waiting."""
MESSAGES_LIMIT = 2048
"""Most messages in a packet. C++ clients send a thousand."""
SKIP_LIMIT = 64 << 20
"""Longest packet that is passed over, bytes. What claims more is no packet."""
AT_ONCE = 64
"""Messages that are read in one call, which takes about 0.3 ms."""
NAMES_LIMIT = 1024
"""Longest name in a message (of its variable, client or community), bytes."""
TEXT_LIMIT = 64 << 10
"""Longest value with other characters than ASCII that is read as a text, bytes. Longer ones only pass through."""

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

DOUBLE = "D"
STRING = "S"
BINARY = "B"
KINDS = (DOUBLE, STRING, BINARY)

ASYNCHRONOUS = "asynchronous"
"""Key of a client's first message, and text of the welcome, where packets may come unasked."""
TIMING_KEY = "_async_timing"
SERVER_REQUEST_ID = -2
"""Id of requests to the database itself, and of their answers."""
NO_NUMBER = -1.0
"""Stands in a number field without a meaning."""

_PACKET = struct.Struct("<iiB")
_HEAD = struct.Struct("<iicc")
_LENGTH = struct.Struct("<i")
_NUMBERS = struct.Struct("<ddd")
_SHORTEST = _HEAD.size + _NUMBERS.size + 5 * _LENGTH.size


class MoosMessage(Struct, frozen=True, gc=False):
    """One message. Texts are UTF-8 with surrogate escapes, so that any bytes come through unchanged.

    Attributes:
        type: one character, see the constants above.
        key: name of the variable; some types use it otherwise.
        number, number2: NO_NUMBER where they mean nothing.
        data: the value of a string or binary variable.
        kind: DOUBLE, STRING or BINARY; other characters are kept as they come.
        src: client that wrote it.
        src_aux: part of that client that wrote it.
        community: community where it was written; "" until the database fills it in.
        time: MOOS time, s.
        id: counts the messages of a client; SERVER_REQUEST_ID in requests to the database and their answers.
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
        """The value of a notification, by its kind. A long string with other characters than ASCII stays bytes: to read it takes too long."""
        if self.kind == DOUBLE:
            return self.number
        is_text = self.kind != BINARY and (len(self.data) <= TEXT_LIMIT or self.data.isascii())
        return self.text if is_text else self.data


class Hello(Struct, frozen=True):
    """The greeting of a client."""


class Packet(Struct, frozen=True):
    """Messages that came together, and take effect together."""

    messages: tuple[MoosMessage, ...]


class Malformed(Struct, frozen=True):
    """The bytes are no MOOS, or more than is taken; the text says what is wrong. Nothing after them can be understood."""

    text: str


class Skipped(Struct, frozen=True):
    """A packet was too long and is thrown away as it comes; the text says how long. The next one can be understood."""

    text: str


class Reading(Struct, frozen=True):
    """A packet of many messages is being read. Others may have their turn before the decoder is asked again."""


WireEvent = Hello | Packet | Malformed | Skipped | Reading
_READING = Reading()


def notify(key: str, value: float | str | bytes, time: float, src: str = "", id: int = -1) -> MoosMessage:
    """Return a write of a variable: a number, a text, or bytes as a binary string."""
    if isinstance(value, str):
        return MoosMessage(NOTIFY, key, data=_bytes(value), kind=STRING, src=src, time=time, id=id)
    if isinstance(value, bytes):
        return MoosMessage(NOTIFY, key, data=value, kind=BINARY, src=src, time=time, id=id)
    return MoosMessage(NOTIFY, key, number=float(value), src=src, time=time, id=id)


def wildcard(type: str, src: str, time: float, pattern: str, app: str = "*", interval_s: float = 0.0) -> MoosMessage:
    """Return a registration (or, by `type`, its end) for all variables that match `pattern`, written by clients that match `app`."""
    text = f"AppPattern={app},VarPattern={pattern},Interval={interval_s:g}"
    return MoosMessage(type, src, data=_bytes(text), kind=STRING, src=src, time=time)


def wildcard_of(message: MoosMessage) -> tuple[str, str, float]:
    """Return the patterns of variable and client, and the interval (s), of a wildcard registration; "" and 0 for what is missing."""
    text = message.data[: 3 * NAMES_LIMIT].decode("utf-8", "surrogateescape")
    found = dict(part.split("=", 1) for part in text.split(",") if "=" in part)
    named = {key.strip().lower(): value.strip() for key, value in found.items()}
    return named.get("varpattern", ""), named.get("apppattern", ""), seconds(named.get("interval", ""))


def seconds(text: str) -> float:
    """Return the number of seconds in a text; 0 where it is none, or not above 0."""
    try:
        number = float(text[:64])
    except ValueError:
        return 0.0
    return number if math.isfinite(number) and number > 0.0 else 0.0


def encode(message: MoosMessage) -> bytes:
    """Return the bytes of one message. Raises ValueError when `type` or `kind` is not one ASCII character, or `id` no i32."""
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
    """Return a packet of encoded messages."""
    body = b"".join(messages)
    return _PACKET.pack(_PACKET.size + len(body), len(messages), 0) + body


def _bytes(text: str) -> bytes:
    try:
        return text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # half a surrogate pair, as JSON can bring it
        return text.encode("utf-8", "replace")


def readable(text: str) -> str:
    """Return the text with U+FFFD for what was no UTF-8, as logs and JSON need it."""
    return text if text.isascii() else _bytes(text).decode("utf-8", "replace")


class Decoder:
    """Turns the bytes of one connection into events: `receive` stores, `next_event` parses.

    A length that a peer claims costs no memory: bytes are kept as they come, and a packet above the limit ends the connection at once.

    Args:
        expects_hello: the peer is a client, which greets first.
        limit: longest packet, bytes.
        skips: pass over packets above the limit, and allow any number of messages in a packet. For a client of a database, which sends what
            all others wrote.
    """

    def __init__(self, expects_hello: bool = False, limit: int = PACKET_LIMIT, skips: bool = False) -> None:
        self._buffer = bytearray()
        self._events = _events(self._buffer, expects_hello, limit, skips)
        self._is_broken = False

    def receive(self, data: bytes) -> None:
        """Store bytes; those after a fault are thrown away."""
        if not self._is_broken:
            self._buffer += data

    def next_event(self) -> WireEvent | None:
        """Return the next packet; None until more bytes come.

        `Reading` stands for a part of a packet with more messages than are read at once. After `Malformed` nothing comes any more.
        """
        event = next(self._events, None)
        if isinstance(event, Malformed):
            self._is_broken = True
            self._buffer.clear()
        return event


class _Fault(Exception):
    """Says what is wrong in a packet."""


def _events(buffer: bytearray, expects_hello: bool, limit: int, skips: bool) -> Iterator[WireEvent | None]:
    """Parse the bytes that are added to a buffer. Yields None until more of them come."""
    try:
        while expects_hello and not buffer.startswith(HELLO):
            if not HELLO.startswith(buffer[: len(HELLO)]):
                raise _Fault(f"the first bytes are {bytes(buffer[:32])!r}, a MOOS V10 client says {HELLO!r}")
            yield None
        if expects_hello:
            del buffer[: len(HELLO)]
            yield Hello()
        while True:
            while len(buffer) < _LENGTH.size:
                yield None
            (size,) = _LENGTH.unpack_from(buffer)
            if size < _PACKET.size:
                raise _Fault(f"a packet of {size} bytes: its header alone has {_PACKET.size}")
            if size <= limit:
                yield from _packet_of(buffer, size, math.inf if skips else MESSAGES_LIMIT)
                continue
            text = f"a packet of {size} bytes: the longest that is taken has {limit}"
            if not skips or size > SKIP_LIMIT:
                raise _Fault(text)
            yield Skipped(text)
            while size:
                skipped = min(size, len(buffer))
                del buffer[:skipped]
                size -= skipped
                if size:
                    yield None
    except _Fault as fault:
        yield Malformed(str(fault))


def _packet_of(buffer: bytearray, size: int, most: float) -> Iterator[WireEvent | None]:
    """Take a packet of this size out of the buffer, once it is complete. Raises _Fault when it is none."""
    while len(buffer) < size:
        yield None
    with memoryview(buffer) as whole:  # a slice of the buffer would be one more copy
        data = bytes(whole[:size])
    del buffer[:size]
    _, number, compressed = _PACKET.unpack_from(data)
    if compressed:
        raise _Fault("a compressed packet: MOOS V10 has none")
    if not 0 <= number <= (size - _PACKET.size) // _SHORTEST:
        raise _Fault(f"{number} messages in a packet of {size} bytes")
    if number > most:
        raise _Fault(f"{number} messages in a packet: the most that are taken are {most:g}")
    found: list[MoosMessage] = []
    at = _PACKET.size
    while len(found) < number:
        message, at = _message(data, at)
        found.append(message)
        if len(found) % AT_ONCE == 0 and len(found) < number:
            yield _READING
    if at != size:
        raise _Fault(f"{size - at} bytes behind the last of {number} messages")
    yield Packet(tuple(found))


def _message(data: bytes, start: int) -> tuple[MoosMessage, int]:
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
    made = MoosMessage(
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
