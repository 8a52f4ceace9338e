"""Inputs that are nearly right, reproducible from a seed: changed as trees before they are encoded, or as bytes after.

`UWSERVER_FUZZ_SEED` is that seed; without it, it is the day (UTC). `UWSERVER_FUZZ_SECONDS` is the processor time that each codec has in the run
of every day.
"""

from __future__ import annotations

import datetime
import os
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

LEAVES: Sequence[Any] = (
    None, True, False, 0, -1, 1, 3, 2**31, 2**63 - 1, -(2**63), 2**64 - 1, 0.5, -0.0, 1e308, 5e-324, 1.5e-9, float("inf"), float("nan"),
    "", "x", "x" * 300, "rov/thrusters", "rov/*", "**", "world/echo", "describe", "\x00\x7f\n\"\\", "\u00e9\U0001f600", "../..", [], {}, [[[[]]]],
    [0.1] * 8, [None] * 8, ["0"] * 8, {"u": [0.0] * 8}, {"": ""}, {"id": 7}, [{}] * 20,
)  # fmt: skip
PIECES = (
    b"\x00", b"\xff", b"\n", b"\r\n", b" ", b"\t", b'"', b"\\", b"\\ud800", b"{", b"}", b"[", b"]", b":", b",", b"#", b"=", b"%", b"null", b"NaN",
    b"1e999", b"-", b"9" * 40, b"\x00\x00\x00\x05", b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\xfd", b"\xfe", b"\x91" * 40, b"[" * 40, b"\xc1",
    b"\xdd\xff\xff\xff\xff", b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00", b"HTTP/1.1", b"\xe2\x82", b"\xf0\x9f\x98\x80",
)  # fmt: skip
SECONDS = float(os.environ.get("UWSERVER_FUZZ_SECONDS", "0.5"))
_POOL = 1 << 16


def seed_of_the_day() -> int:
    """A run of another day looks further, one of the same day looks at the same; the seed stands in the output of a test that fails."""
    today = datetime.datetime.now(datetime.timezone.utc)
    seed = int(os.environ.get("UWSERVER_FUZZ_SEED") or f"{today:%Y%m%d}")
    print(f"UWSERVER_FUZZ_SEED={seed}")
    return seed


def for_seconds(seconds: float) -> Callable[[int], bool]:
    """Whether to go on, after so many inputs: as long as this process has worked less than that."""
    end = time.process_time() + seconds
    return lambda _: time.process_time() < end


class Dice:
    """Random choices; drawn in bulk, as a million inputs need tens of millions."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._pool: list[int] = []

    def below(self, bound: int) -> int:
        """A number of 0 to bound - 1."""
        if not self._pool:
            self._pool = self._rng.integers(1 << 40, size=_POOL).tolist()
        return self._pool.pop() % bound

    def one(self, choices: Sequence[T]) -> T:
        """One of several."""
        return choices[self.below(len(choices))]

    def bytes(self, most: int) -> bytes:
        """Any bytes, `most` at most."""
        return self._rng.bytes(self.below(most + 1))

    def tree(self, value: Any) -> Any:
        """The same value with one leaf or branch replaced, added or gone."""
        if isinstance(value, dict) and value and self.below(8):
            key = self.one(list(value))
            what = self.below(16)
            if what == 0:
                return {k: v for k, v in value.items() if k != key}
            if what == 1:
                return {**value, str(self.one(LEAVES))[:80]: self.one(LEAVES)}
            return {**value, key: self.tree(value[key])}
        if isinstance(value, list) and value and self.below(4):
            k = self.below(len(value))
            return [*value[:k], self.tree(value[k]), *value[k + 1 :]]
        return self.one(LEAVES)

    def damaged(self, data: bytes) -> bytes:
        """The same bytes with one to three faults."""
        changed = bytearray(data)
        for _ in range(1 + self.below(3)):
            at, span = self.below(len(changed) + 1), self.below(12)
            what = self.below(6)
            if what == 0 and at < len(changed):
                changed[at] ^= 1 << self.below(8)
            elif what == 1:
                del changed[at : at + span]
            elif what == 2:
                changed[at:at] = self.one(PIECES)
            elif what == 3:
                changed[at : at + span] = self.one(PIECES)
            elif what == 4:
                changed[at:at] = changed[at : at + span] * (1 + self.below(4))
            else:
                changed[at : at + 1] = bytes((self.below(256),))
        return bytes(changed)

    def pieces(self, data: bytes) -> list[bytes]:
        """The same bytes as they may come."""
        if self.below(2):
            return [data]
        cut = self.below(len(data) + 1)
        return [data[:cut], data[cut:]]
