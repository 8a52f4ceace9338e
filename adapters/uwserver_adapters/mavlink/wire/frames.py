"""Frames of MAVLink 1 and 2, sans-IO: splits bytes of any piece size into frames, packs frames, and signs them. Knows no messages."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable

from msgspec import Struct

from uwserver_adapters.mavlink.wire.dialect import Dialect

MAGIC_1, MAGIC_2 = 0xFE, 0xFD
SIGNED = 0x01
"""Incompatibility flag: a signature follows the checksum."""
SIGNATURE = 13
_HEAD_1, _HEAD_2 = 6, 10
_CRC = 2
_TRIES = 64
"""Offsets at which a frame is looked for in one call, so that garbage cannot hold up the caller."""
KEY_SIZE = 32
EPOCH_S = 1_420_070_400
"""1 January 2015 UTC, seconds since 1970: time stamps count from here."""
STAMPS_PER_S = 100_000
_BEHIND = 60 * STAMPS_PER_S
"""How far behind a new sender's time stamps may be."""
_STAMP_MAX = (1 << 48) - 1


class Frame(Struct, frozen=True):
    """One received message whose checksum is right.

    Attributes:
        raw: all its bytes, which are what is forwarded.
        version: 1 or 2.
        seq: counts the frames of its sender on a link, modulo 256.
        system, component: its sender.
        id: number of the message.
        payload: its payload; in version 2 without trailing zeros.
        is_signed: `raw` ends with a signature.
    """

    raw: bytes
    version: int
    seq: int
    system: int
    component: int
    id: int
    payload: bytes
    is_signed: bool = False


class Malformed(Struct, frozen=True):
    """Bytes that are no frame: how many were skipped, and the reason: garbage, checksum, unknown or incompatible."""

    reason: str
    size: int


class Decoder:
    """Splits bytes into frames. After an error it looks for the next frame within the same bytes, so one lost byte costs one message.

    Args:
        dialect: knows what each message adds to its checksum.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._buffer = bytearray()
        self._start = 0

    def receive(self, data: bytes) -> None:
        """Append received bytes."""
        if self._start:
            del self._buffer[: self._start]
            self._start = 0
        self._buffer += data

    def clear(self) -> None:
        """Discard the bytes that have not been decoded yet."""
        self._buffer.clear()
        self._start = 0

    def next_event(self) -> Frame | Malformed | None:
        """Return the next frame, or what was skipped before it; None until more bytes come."""
        buffer, first = self._buffer, self._start
        reason = "garbage"
        for _ in range(_TRIES):
            at = self._next_magic()
            if at > first:
                self._start = at
                return Malformed(reason, at - first)
            size = self._size(at)
            if size == 0 or at + size > len(buffer):
                return None
            frame, reason = self._frame(bytes(buffer[at : at + size]))
            if frame is not None:
                self._start = at + size
                return frame
            # Without the definition no checksum can be tested. If a frame follows, this one was most likely a frame too.
            if reason == "unknown":
                after = at + size
                if after == len(buffer) or buffer[after] in (MAGIC_1, MAGIC_2):
                    self._start = after
                    return Malformed(reason, size)
            first, self._start = at, at + 1
        return Malformed(reason, 1)

    def _next_magic(self) -> int:
        places = [at for magic in (b"\xfd", b"\xfe") if (at := self._buffer.find(magic, self._start)) >= 0]
        return min(places, default=len(self._buffer))

    def _size(self, at: int) -> int:
        """Return the length of the frame that begins here, in bytes; 0 while too few bytes are there to tell."""
        buffer = self._buffer
        if len(buffer) < at + 3:
            return 0
        if buffer[at] == MAGIC_1:
            return _HEAD_1 + buffer[at + 1] + _CRC
        return _HEAD_2 + buffer[at + 1] + _CRC + (SIGNATURE if buffer[at + 2] & SIGNED else 0)

    def _frame(self, raw: bytes) -> tuple[Frame | None, str]:
        version = 1 if raw[0] == MAGIC_1 else 2
        if version == 1:
            head, seq, system, component, id, is_signed = _HEAD_1, raw[2], raw[3], raw[4], raw[5], False
        else:
            if raw[2] & ~SIGNED:
                return None, "incompatible"
            head, seq, system, component = _HEAD_2, raw[4], raw[5], raw[6]
            id, is_signed = int.from_bytes(raw[7:10], "little"), bool(raw[2] & SIGNED)
        layout = self._dialect.by_id.get(id)
        if layout is None:
            return None, "unknown"
        end = head + raw[1]
        if self._dialect.crc(raw[1:end] + bytes((layout.crc_extra,))) != raw[end] | raw[end + 1] << 8:
            return None, "checksum"
        return Frame(raw, version, seq, system, component, id, raw[head:end], is_signed), ""


def pack(
    dialect: Dialect, id: int, payload: bytes, seq: int, system: int, component: int, is_signed: bool = False
) -> bytes:
    """Return a frame of MAVLink 2. With `is_signed` the caller must append the signature."""
    head = bytes((len(payload), SIGNED if is_signed else 0, 0, seq, system, component)) + id.to_bytes(3, "little")
    crc = dialect.crc(head + payload + bytes((dialect.by_id[id].crc_extra,)))
    return b"\xfd" + head + payload + crc.to_bytes(2, "little")


def key_of(passphrase: str) -> bytes:
    """Return the key that MAVProxy and QGroundControl derive from a passphrase."""
    return hashlib.sha256(passphrase.encode()).digest()


class Signing:
    """Signs outgoing frames and checks incoming ones. All links share one instance.

    Args:
        key: 32 bytes.
        stamp: returns the time in units of 10 us since 2015. It may jump back; our time stamps do not.
        stamp_from: our first time stamp is later than this one.
    """

    def __init__(self, key: bytes, stamp: Callable[[], int], stamp_from: int = 0) -> None:
        self._key = key
        self._now = stamp
        self._last = min(max(0, stamp_from), _STAMP_MAX)
        self._seen: dict[tuple[int, int, int], int] = {}

    def sign(self, frame: bytes, link: int) -> bytes:
        """Return the frame with its signature appended."""
        self._last = min(max(self._last + 1, self._now()), _STAMP_MAX)
        text = frame + bytes((link & 0xFF,)) + self._last.to_bytes(6, "little")
        return text + self._signature(text)

    def refusal(self, frame: Frame) -> str:
        """Return why a frame is not accepted: unsigned, signature, replayed or stale; "" when it is accepted."""
        if not frame.is_signed:
            return "unsigned"
        block = frame.raw[-SIGNATURE:]
        if not hmac.compare_digest(self._signature(frame.raw[:-6]), block[7:]):
            return "signature"
        stamp = int.from_bytes(block[1:7], "little")
        sender = (block[0], frame.system, frame.component)
        last = self._seen.get(sender)
        if last is not None and stamp <= last:
            return "replayed"
        if last is None and stamp + _BEHIND < max(self._last, self._now()):
            return "stale"
        self._seen[sender] = stamp
        self._last = max(self._last, stamp)
        return ""

    def _signature(self, text: bytes) -> bytes:
        return hashlib.sha256(self._key + text).digest()[:6]
