"""What a message may cost, found out before a decoder sees it: a decoder keeps all other threads waiting until it is done.

Nothing here takes longer than the message is long, recurses, or reserves what a message only claims. The limits were measured so that no
decoder takes more than 1 ms (`uwserver bench hostile`); what is refused here costs far less.
"""

from __future__ import annotations

from uwserver.ports import ErrorCode

STRANGER_LIMIT = 4 << 10
"""Longest message of a peer that has not been let in yet, bytes."""
MESSAGE_LIMIT = 64 << 10
"""Longest message, bytes; binary values and plain texts do not count."""
PLAIN_TEXT = 1 << 10
"""Length from which a text of ASCII without backslashes (base64, say) is plain, bytes: it costs no more than its copy."""
MAX_PLAIN = 512 << 10
"""Longest JSON message with its plain texts, and bytes in all plain texts of a msgpack message."""
MAX_BINARY = 1 << 20
"""Bytes in all binary values of one msgpack message: a decoder copies them at once, 0.6 ms into fresh memory."""
LONG_NUMBER = 17
"""Digits from which a number is long. Decoders are slow with what lies half-way between two doubles, which takes 17 digits or an exponent."""
FEW = 16
"""Exponents and long numbers that any decoder may have to do with."""
LONG_NUMBERS_LIMIT = 16 << 10
"""Longest JSON message with more of them, bytes."""
HUGE_LIMIT = 8 << 10
"""Longest JSON message with more of them, bytes, where they have exponents of three digits: these take twice as long as any others."""
MAX_DIGITS = 400
"""Digits of a number in JSON: more than any double needs."""
MAX_DEPTH = 32
"""Maps and lists within each other."""
MAX_CONTAINERS = 1536
"""Maps and lists in one message."""
MAX_VALUES = 6144
"""Values in one message, keys of maps included."""
MAX_TEXTS = 4096
"""Texts in one JSON message, keys of maps included."""

_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))
_ONE_KIND = bytes.maketrans(b"{}", b"[]")
# Every digit becomes 0 and every point goes, so that a number is a row of zeros and an exponent "0e".
_NUMBERS = bytes.maketrans(b"123456789E", b"000000000e")
_HUGE = (b"e000", b"e+000", b"e-000")
_EXPONENT, _LONG_ROW, _ENDLESS_ROW = b"0e", b"0" * LONG_NUMBER, b"0" * (MAX_DIGITS + 1)


class Excess(Exception):
    """A message would cost too much; the text says why and what to do.

    Attributes:
        code: `too_large`, or `invalid_request` where its size is not the cause.
    """

    def __init__(self, text: str, code: ErrorCode = "invalid_request") -> None:
        super().__init__(text)
        self.code: ErrorCode = code


def weigh_json(text: bytes) -> bool:
    """Whether a JSON text has more than a few exponents and long numbers. What is no JSON is the decoder's to say.

    Raises:
        Excess: it is not to be decoded.
    """
    if len(text) <= MESSAGE_LIMIT:
        # Nearly all there are; what stands in texts is counted too, which does not matter below the limits.
        separators = text.count(b",") + text.count(b":")
        brackets = text.count(b"[") + text.count(b"{")
        if separators < MAX_VALUES and brackets <= MAX_DEPTH and not _has_costly_numbers(text):
            return False
    outside = _outside(text)
    if outside.count(b",") + outside.count(b":") >= MAX_VALUES:
        raise _too_many(MAX_VALUES, "values")
    _check_brackets(outside)
    if not _has_costly_numbers(outside):
        return False
    shape = outside.translate(_NUMBERS, b".")
    if _ENDLESS_ROW in shape:
        raise Excess(f"a number has at most {MAX_DIGITS} digits")
    advice = "write fewer digits, or send a buffer"
    if len(text) > LONG_NUMBERS_LIMIT:
        what = f"more than {FEW} numbers with an exponent, or of {LONG_NUMBER} digits and more"
        raise Excess(f"{what}, in a message of more than {LONG_NUMBERS_LIMIT} bytes: {advice}", "too_large")
    if len(text) > HUGE_LIMIT and sum(map(shape.count, _HUGE)) > FEW:
        what = f"more than {FEW} numbers with an exponent of three digits"
        raise Excess(f"{what}, in a message of more than {HUGE_LIMIT} bytes: {advice}", "too_large")
    return True


def _has_costly_numbers(text: bytes) -> bool:
    shape = text.translate(_NUMBERS, b".")
    return shape.count(_EXPONENT) + shape.count(_LONG_ROW) > FEW or _ENDLESS_ROW in shape


def _outside(text: bytes) -> bytes:
    """What stands outside of the texts of a JSON message; of each text, its quotes."""
    is_larger = len(text) > MESSAGE_LIMIT
    if is_larger and (len(text) > MAX_PLAIN or b"\\" in text or not text.isascii()):
        raise _too_large()
    bare = text
    if b"\\" in text:
        bare = text.replace(b"\\\\", b"").replace(b'\\"', b"")
    if bare.count(b'"') > 2 * MAX_TEXTS:
        raise _too_many(MAX_TEXTS, "texts")
    pieces = bare.split(b'"')
    if is_larger:
        plain = sum(len(piece) for piece in pieces[1::2] if len(piece) >= PLAIN_TEXT)
        if len(text) - plain > MESSAGE_LIMIT:
            raise _too_large()
    return b'"'.join(pieces[::2])


def _check_brackets(outside: bytes) -> None:
    brackets = outside.translate(None, _NO_BRACKETS)
    if brackets.count(b"[") + brackets.count(b"{") > MAX_CONTAINERS:
        raise _too_many(MAX_CONTAINERS, "maps and lists")
    # If there are more, then one is closed that was not opened.
    brackets = brackets[: 2 * MAX_CONTAINERS].translate(_ONE_KIND)
    for _ in range(MAX_DEPTH):
        brackets = brackets.replace(b"[]", b"")  # the innermost: each round takes one level of nesting away
    # Of brackets that fit each other only deeper ones are left; of others, no decoder goes deeper than these rounds and what is left open.
    if b"[]" in brackets or brackets.count(b"[") > MAX_DEPTH:
        raise _too_deep()


def weigh_msgpack(frame: bytes | memoryview) -> None:
    """Let a msgpack frame pass that is exactly one complete value of maps, lists, texts, bytes and numbers.

    Raises:
        Excess: it is not to be decoded.
    """
    try:
        position, binary, plain = _walked(frame)
    except IndexError:
        raise Excess("the frame ends within a value") from None
    end = len(frame)
    if position != end:
        raise Excess("the length of the frame does not fit its value")
    if binary > MAX_BINARY:
        raise Excess(f"more than {MAX_BINARY} bytes in binary values: send several messages", "too_large")
    if plain > MAX_PLAIN or end - binary - plain > MESSAGE_LIMIT:
        raise _too_large()


def _walked(frame: bytes | memoryview) -> tuple[int, int, int]:
    """Where the value ends, and how many bytes are in its binary values and plain texts. IndexError where the frame is too short."""
    position = binary = plain = values = containers = 0
    open_containers: list[int] = []  # values that each enclosing container still waits for
    awaited = 1
    while True:
        while awaited:  # what a message costs is this loop
            size = SIZES[frame[position]]
            if size < 0:
                break
            position += size
            awaited -= 1
        else:
            if not open_containers:
                return position, binary, plain
            awaited = open_containers.pop()
            continue
        awaited -= 1
        if size == REFUSED:
            text = "is not part of the schema: send maps, lists, texts, bytes, numbers, booleans and nil"
            raise Excess(f"type byte 0x{frame[position]:02x} {text}")
        count, position = length_at(frame, position)
        if size in (TEXT, BINARY):
            if size == BINARY:
                binary += count
            elif count >= PLAIN_TEXT and bytes(frame[position : position + count]).isascii():
                plain += count
            position += count
            continue
        count *= -size  # a map holds a key and a value for each entry
        values += count
        containers += 1
        if values > MAX_VALUES:
            raise _too_many(MAX_VALUES, "values")
        if containers > MAX_CONTAINERS:
            raise _too_many(MAX_CONTAINERS, "maps and lists")
        open_containers.append(awaited)
        awaited = count
        if len(open_containers) > MAX_DEPTH:
            raise _too_deep()


def length_at(frame: bytes | memoryview, position: int) -> tuple[int, int]:
    """Of the map, list, text or binary value that begins at a position: how many values or bytes it holds, and where these begin."""
    width = _WIDTHS[frame[position]]
    # Of a one-byte header the low bits count: 4 for maps and lists (texts so short are in SIZES).
    count = int.from_bytes(frame[position + 1 : position + 1 + width], "big") if width else frame[position] & 0x0F
    return count, position + 1 + width


def _too_deep() -> Excess:
    return Excess(f"nested deeper than {MAX_DEPTH} levels: flatten the message")


def _too_many(most: int, what: str) -> Excess:
    return Excess(f"more than {most} {what} in one message: send several, or a buffer")


def _too_large() -> Excess:
    rest = f"up to {MAX_PLAIN} bytes of plain texts (base64) and {MAX_BINARY} in binary values of msgpack do not count"
    return Excess(f"a message holds at most {MESSAGE_LIMIT} bytes; {rest}: send a buffer, or pieces", "too_large")


LIST, MAP, TEXT, BINARY, REFUSED = -1, -2, -3, -4, -5


def _sizes() -> tuple[tuple[int, ...], tuple[int, ...]]:
    """By type byte: bytes of a whole scalar or short text, else what it begins; and the width of its length field."""
    sizes, widths = [1] * 256, [0] * 256
    for lead in range(0x80, 0x90):
        sizes[lead] = MAP
    for lead in range(0x90, 0xA0):
        sizes[lead] = LIST
    for lead in range(0xA0, 0xC0):
        sizes[lead] = 1 + (lead & 0x1F)
    for lead in (0xC1, *range(0xC7, 0xCA), *range(0xD4, 0xD9)):  # unused, extensions
        sizes[lead] = REFUSED
    for lead, size in zip(range(0xCA, 0xD4), (5, 9, 2, 3, 5, 9, 2, 3, 5, 9), strict=True):  # floats, then integers
        sizes[lead] = size
    for lead, (size, width) in zip(
        (*range(0xC4, 0xC7), *range(0xD9, 0xE0)),
        (
            *((BINARY, n) for n in (1, 2, 4)),
            *((TEXT, n) for n in (1, 2, 4)),
            (LIST, 2),
            (LIST, 4),
            (MAP, 2),
            (MAP, 4),
        ),
        strict=True,
    ):
        sizes[lead], widths[lead] = size, width
    return tuple(sizes), tuple(widths)


SIZES, _WIDTHS = _sizes()
"""By type byte of msgpack: bytes of a whole scalar or short text, else LIST, MAP, TEXT, BINARY or REFUSED."""
