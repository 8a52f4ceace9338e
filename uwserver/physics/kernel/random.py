"""Random numbers that depend only on the component that draws them and on their purpose: not on order, batches, threads or processes.

Philox 4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") turns a key and a counter into 128 random bits. The key is derived
from a path (`key_of`); the counter says what the numbers are for. The only state of such a stream is how often it was used.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np

from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.kernel.elementary import within_an_eighth

SAMPLE, TURN_ON, EVENT = 0, 1, 2
"""Purposes of random numbers: a reading, the start of a run, or an event beside the readings."""

LANES = 1 << 24
"""Number of blocks of four words that one purpose may draw at a time."""

Word = np.uint64
"""32 bits of a counter, a key or a random number, in a 64-bit word, as products need 64 bits."""

_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
_5, _6 = np.uint64(5), np.uint64(6)
_QUARTER_TURN = 0.5 * math.pi


def key_of(seed: int, path: str) -> int:
    """Return the key (64 bits) of a path in a scenario with this seed."""
    return int.from_bytes(hashlib.blake2b(path.encode(), key=str(seed).encode()[:64], digest_size=8).digest(), "little")


@compiled
def philox(a: Word, b: Word, c: Word, d: Word, k: Word, m: Word) -> tuple[Word, Word, Word, Word]:
    """Return four random words for a counter of four words and a key of two."""
    for _ in range(10):
        p, q = _M0 * a, _M1 * c
        a, b, c, d = (q >> _HALF) ^ b ^ k, q & _LOW, (p >> _HALF) ^ d ^ m, p & _LOW
        k, m = (k + _W0) & _LOW, (m + _W1) & _LOW
    return a, b, c, d


@compiled
def uniforms(key: int, number: int, purpose: int, lane: int) -> tuple[float, float]:
    """Return two numbers 0 <= u < 1 of 53 bits each.

    Args:
        key: unsigned, of `key_of`.
        number: number of the reading, from 0 on.
        purpose: `SAMPLE`, `TURN_ON` or `EVENT`.
        lane: which of the pairs of this purpose, less than `LANES`.
    """
    n, k = np.uint64(number), np.uint64(key)
    word = np.uint64(purpose * LANES + lane)
    a, b, c, d = philox(word, np.uint64(0), n & _LOW, n >> _HALF, k & _LOW, k >> _HALF)
    u = ((a >> _5) * 67108864.0 + (b >> _6)) / 9007199254740992.0
    v = ((c >> _5) * 67108864.0 + (d >> _6)) / 9007199254740992.0
    return u, v


@compiled
def on_circle(turn: float) -> tuple[float, float]:
    """Return cosine and sine of an angle of 0 to 1 turns, within 2.3e-16, without branches, which no processor could predict for random angles.

    With the functions of the C library two normal numbers would take twice as long, and their last digits would depend on the machine.
    """
    quarters = 4.0 * turn
    n = math.floor(quarters + 0.5)
    sine, cosine = within_an_eighth((quarters - n) * _QUARTER_TURN)  # the difference is exact
    k = int(n)
    a, b = (sine, cosine) if k & 1 else (cosine, sine)
    return -a if (k + 1) & 2 else a, -b if k & 2 else b


@compiled
def normals(key: int, number: int, purpose: int, lane: int) -> tuple[float, float]:
    """Return two independent standard normal numbers (Box and Muller 1958), up to 8.5 sigma, made of the numbers of `uniforms`, which has the same
    arguments."""
    u, v = uniforms(key, number, purpose, lane)
    r = math.sqrt(-2.0 * math.log(1.0 - u))
    x, y = on_circle(v)
    return r * x, r * y


@compiled
def fill_normals(key: int, number: int, purpose: int, lane: int, count: int, out: Array) -> None:
    """Write `count` standard normal numbers to `out`, from this lane on."""
    for k in range(0, count, 2):
        a, b = normals(key, number, purpose, lane + k // 2)
        out[k] = a
        if k + 1 < count:
            out[k + 1] = b


@entry
def _draw_normals(key: int, number: int, purpose: int, out: Array) -> None:
    fill_normals(key, number, purpose, 0, len(out), out)


def draw_normals(key: int, count: int, number: int = 0, purpose: int = TURN_ON) -> FloatArray:
    """Return (count) standard normal numbers of a path, for callers in Python."""
    out = np.empty(count)
    _draw_normals(np.uint64(key), number, purpose, out)
    return out
