"""Numbers as JSON has them, written by compiled code: the shortest decimal that reads back as the same float, and whole numbers.

The shortest decimals are found as in Giulietti 2020, "The Schubfach way to render doubles": two candidates a decade, compared with the ends of the
interval of all reals that round to the float, in products of 128 bits with powers of ten that are rounded up. Where two are as short, the nearer
one is taken, and of two as near the even one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled

Word = Any
"""64 bits without a sign."""

LONGEST = 26
"""Bytes of a number at most."""

_LEAST, _MOST = -292, 325
"""Exponents of the powers of ten that a float may need."""


def _shift(k: int) -> int:
    """floor(log2(10^k)), for |k| <= 1650."""
    return (k * 1741647) >> 19


def _power(k: int) -> int:
    """10^k in 128 bits, rounded up."""
    shift = 127 - _shift(k)
    above = 10 ** max(k, 0) << max(shift, 0)
    below = 10 ** max(-k, 0) << max(-shift, 0)
    return int(-(-above // below))


_HIGH = np.array([_power(k) >> 64 for k in range(_LEAST, _MOST)], np.uint64)
_LOW = np.array([_power(k) & (2**64 - 1) for k in range(_LEAST, _MOST)], np.uint64)
_HALF, _MASK = np.uint64(32), np.uint64(0xFFFFFFFF)
_0, _1, _2, _3, _4, _10, _40 = (np.uint64(n) for n in (0, 1, 2, 3, 4, 10, 40))
_HIDDEN, _MANTISSA = np.uint64(1 << 52), np.uint64((1 << 52) - 1)
_ZERO, _POINT, _MINUS, _E = (np.uint8(ord(c)) for c in "0.-e")
_NULL = np.frombuffer(b"null", np.uint8)


@compiled
def _high(a: Word, b: Word) -> Word:
    """The upper half of a product of 128 bits."""
    a0, a1, b0, b1 = a & _MASK, a >> _HALF, b & _MASK, b >> _HALF
    cross = a1 * b0 + ((a0 * b0) >> _HALF)
    return a1 * b1 + (cross >> _HALF) + (((cross & _MASK) + a0 * b1) >> _HALF)


@compiled
def _scaled(high: Word, low: Word, c: Word) -> Word:
    """The upper 64 bits of a power of ten times c, the last of which is 1 where anything stands below."""
    middle = high * c
    sum_ = middle + _high(low, c)
    top = _high(high, c) + (_1 if sum_ < middle else _0)
    return top | (_1 if sum_ > _1 else _0)


@compiled
def _shortest(mantissa: Word, exponent: int) -> tuple[Word, int]:
    """Digits and exponent of ten of a float > 0, of its two parts."""
    c, q = mantissa, 1 - 1075
    if exponent != 0:
        c, q = mantissa | _HIDDEN, exponent - 1075
    # The float below a power of two is nearer than the one above.
    is_near = mantissa == _0 and exponent > 1
    k = (q * 1262611 - (524031 if is_near else 0)) >> 22
    h = np.uint64(q + ((-k * 1741647) >> 19) + 1)
    high, low = _HIGH[-k - _LEAST], _LOW[-k - _LEAST]
    odd = c & _1
    lower = _scaled(high, low, (_4 * c - (_1 if is_near else _2)) << h) + odd
    here = _scaled(high, low, (_4 * c) << h)
    upper = _scaled(high, low, (_4 * c + _2) << h) - odd
    s = here >> _2
    if s >= _10:
        tens = s // _10
        below, above = lower <= _40 * tens, _40 * tens + _40 <= upper
        if below != above:
            return tens + (_1 if above else _0), k + 1
    below, above = lower <= _4 * s, _4 * s + _4 <= upper
    if below != above:
        return s + (_1 if above else _0), k
    middle = _4 * s + _2
    is_up = here > middle or (here == middle and (s & _1) != _0)
    return s + (_1 if is_up else _0), k


@compiled
def _length(digits: Word) -> int:
    """Of a whole number."""
    n = 1
    while digits >= _10:
        digits //= _10
        n += 1
    return n


@compiled
def _write_digits(digits: Word, out: Array, end: int) -> None:
    """So that the last one stands before `end`."""
    while True:
        tens = digits // _10
        end -= 1
        out[end] = _ZERO + np.uint8(digits - tens * _10)
        digits = tens
        if digits == _0:
            return


@compiled
def write_null(out: Array, at: int) -> int:
    """A number that is missing. Returns where it ends."""
    out[at : at + 4] = _NULL
    return at + 4


@compiled
def write_whole(number: int, out: Array, at: int) -> int:
    """A whole number of 64 bits. Returns where it ends."""
    digits = np.uint64(number)
    if number < 0:
        digits = _0 - digits
        out[at] = _MINUS
        at += 1
    end = at + _length(digits)
    _write_digits(digits, out, end)
    return int(end)


@compiled
def write_float(bits: int, out: Array, at: int) -> int:
    """A float, of its 64 bits; missing where it is not finite. Returns where it ends."""
    word = np.uint64(bits)
    mantissa, exponent = word & _MANTISSA, np.int64(word >> np.uint64(52)) & 0x7FF
    if exponent == 0x7FF:
        return int(write_null(out, at))
    if bits < 0:
        out[at] = _MINUS
        at += 1
    if mantissa == _0 and exponent == 0:
        out[at], out[at + 1], out[at + 2] = _ZERO, _POINT, _ZERO
        return at + 3
    digits, k = _shortest(mantissa, exponent)
    while digits % _10 == _0:
        digits //= _10
        k += 1
    n = _length(digits)
    first = n - 1 + k  # the power of ten of the first digit
    if first < -5 or first > 15:
        return int(_write_scientific(digits, n, first, out, at))
    if first < 0:
        out[at], out[at + 1] = _ZERO, _POINT
        start = at + 1 - first
        out[at + 2 : start] = _ZERO
        _write_digits(digits, out, start + n)
        return int(start + n)
    if k >= 0:
        end = at + first + 1
        _write_digits(digits, out, at + n)
        out[at + n : end] = _ZERO
        out[end], out[end + 1] = _POINT, _ZERO
        return int(end + 2)
    _write_digits(digits, out, at + n + 1)
    for i in range(at, at + first + 1):
        out[i] = out[i + 1]
    out[at + first + 1] = _POINT
    return int(at + n + 1)


@compiled
def _write_scientific(digits: Word, n: int, first: int, out: Array, at: int) -> int:
    if n == 1:
        out[at] = _ZERO + np.uint8(digits)
        at += 1
    else:
        _write_digits(digits, out, at + n + 1)
        out[at] = out[at + 1]
        out[at + 1] = _POINT
        at += n + 1
    out[at] = _E
    return int(write_whole(first, out, at + 1))
