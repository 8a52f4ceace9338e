"""Bounds the cost of a message before a decoder sees it, because a decoder holds up all other threads until it is done.

All functions take time in proportion to the length of the message, do not recurse, and reserve no memory for sizes that a message only
claims. The limits were measured so that no decoder takes more than 1 ms (`uwserver bench hostile`); to refuse a message costs far less.
"""

from __future__ import annotations

from uwserver.ports import ErrorCode

STRANGER_LIMIT = 4 << 10
"""Longest message of a peer that is not admitted yet, bytes."""
MESSAGE_LIMIT = 64 << 10
"""Longest message, bytes, not counting binary values and plain texts."""
PLAIN_TEXT = 1 << 10
"""Length in bytes from which an ASCII text without backslashes, such as base64, counts as plain: to decode it costs no more than to copy it."""
MAX_PLAIN = 512 << 10
"""Longest JSON message including its plain texts, and the most bytes in all plain texts of a msgpack message."""
MAX_BINARY = 1 << 20
"""Most bytes in all binary values of a msgpack message. A decoder copies them at once, which takes 0.6 ms into fresh memory."""
LONG_NUMBER = 17
"""Digits from which a number is long. Decoders are slow with numbers half-way between two doubles, which need 17 digits or an exponent."""
FEW = 16
"""Exponents and long numbers in a message that any decoder may get."""
LONG_NUMBERS_LIMIT = 16 << 10
"""Longest JSON message with more of them, bytes."""
HUGE_LIMIT = 8 << 10
"""Longest JSON message with more of them, bytes, if they have exponents of three digits, which take twice as long as others."""
MAX_DIGITS = 400
"""Most digits of a number in JSON, more than any double needs."""
MAX_DEPTH = 32
"""Deepest nesting of maps and lists."""
MAX_CONTAINERS = 1536
"""Most maps and lists in a message."""
MAX_VALUES = 6144
"""Most values in a message, including keys of maps."""
MAX_TEXTS = 4096
"""Most texts in a JSON message, including keys of maps."""

_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))
_ONE_KIND = bytes.maketrans(b"{}", b"[]")
# Every digit becomes 0 and points are removed, so that a number becomes a row of zeros, and a number with an exponent has "0e" in it.
_NUMBERS = bytes.maketrans(b"123456789E", b"000000000e")
_HUGE = (b"e000", b"e+000", b"e-000")
_EXPONENT, _LONG_ROW, _ENDLESS_ROW = b"0e", b"0" * LONG_NUMBER, b"0" * (MAX_DIGITS + 1)


class Excess(Exception):
    """A message would cost too much to decode; the text says why, and what to do.

    Attributes:
        code: `too_large`, or `invalid_request` if the size is not the cause.
    """

    def __init__(self, text: str, code: ErrorCode = "invalid_request") -> None:
        super().__init__(text)
        self.code: ErrorCode = code


def weigh_json(text: bytes) -> bool:
    """Check the cost of a JSON text. It may be no JSON at all, which the decoder will find.

    Returns:
        Whether it has more than `FEW` exponents and long numbers, so that the fast decoder would be slow.

    Raises:
        Excess: it must not be decoded.
    """
    if len(text) <= MESSAGE_LIMIT:
        # The fast path, for nearly all messages. It also counts what is inside texts, which is harmless below the limits.
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
    """Return a JSON message without the contents of its texts, of which only quotes are left."""
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
    # If there are more brackets than twice the containers, some are closed without being open, and a decoder stops there.
    brackets = brackets[: 2 * MAX_CONTAINERS].translate(_ONE_KIND)
    # Each round removes the innermost level of nesting.
    for _ in range(MAX_DEPTH):
        brackets = brackets.replace(b"[]", b"")
    # If the brackets match, only levels that are deeper than the limit are left. If they do not, no decoder goes deeper than the removed
    # levels and those that stay open.
    if b"[]" in brackets or brackets.count(b"[") > MAX_DEPTH:
        raise _too_deep()


def weigh_msgpack(frame: bytes | memoryview) -> None:
    """Check that a msgpack frame is exactly one complete value of maps, lists, texts, bytes and numbers, and costs little to decode.

    Raises:
        Excess: it must not be decoded.
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
    """Return where the value ends, and the number of bytes in its binary values and in its plain texts.

    Raises:
        IndexError: the frame is too short.
    """
    position = binary = plain = values = containers = 0
    # Values that each enclosing container still waits for.
    open_containers: list[int] = []
    awaited = 1
    while True:
        # Nearly all the time is spent in this inner loop over scalars and short texts.
        while awaited:
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
        # LIST is -1 and MAP is -2: a map holds a key and a value for each entry.
        count *= -size
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
    """Return the number of entries or bytes in the map, list, text or binary value at a position, and where they begin."""
    width = _WIDTHS[frame[position]]
    # A header of one byte has the number of entries of a map or list in its lower 4 bits. Texts with such a header are in SIZES.
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
    """Return the tables `SIZES` and `_WIDTHS`."""
    sizes, widths = [1] * 256, [0] * 256
    sizes[0x80:0x90] = [MAP] * 16
    sizes[0x90:0xA0] = [LIST] * 16
    sizes[0xA0:0xC0] = range(1, 33)  # short texts
    for lead in (0xC1, *range(0xC7, 0xCA), *range(0xD4, 0xD9)):  # unused, extensions
        sizes[lead] = REFUSED
    sizes[0xCA:0xD4] = (5, 9, 2, 3, 5, 9, 2, 3, 5, 9)  # floats, then integers
    for first, kind, bytes_of_length in (
        (0xC4, BINARY, (1, 2, 4)), (0xD9, TEXT, (1, 2, 4)), (0xDC, LIST, (2, 4)), (0xDE, MAP, (2, 4)),
    ):  # fmt: skip
        for lead, width in enumerate(bytes_of_length, first):
            sizes[lead], widths[lead] = kind, width
    return tuple(sizes), tuple(widths)


SIZES, _WIDTHS = _sizes()
"""By type byte of msgpack: the bytes of a whole scalar or short text, or else LIST, MAP, TEXT, BINARY or REFUSED; the width of its length field."""
