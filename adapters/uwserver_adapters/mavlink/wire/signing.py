"""Signatures of MAVLink 2. Whoever has the key may speak. A frame is signed, but not encrypted."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable

from uwserver_adapters.mavlink.wire.frames import SIGNATURE, Frame

KEY_SIZE = 32
EPOCH_S = 1_420_070_400
"""1 January 2015 UTC, seconds since 1970: time stamps count from here."""
STAMPS_PER_S = 100_000
_BEHIND = 60 * STAMPS_PER_S
"""How far behind a new sender's time stamps may be."""
_STAMP_MAX = (1 << 48) - 1


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
