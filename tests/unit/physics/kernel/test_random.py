"""Philox against its published answers; what is made of its words; and that a number depends on key, number, purpose and lane alone."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import entry
from uwserver.physics.kernel.random import (
    EVENT,
    LANES,
    SAMPLE,
    TURN_ON,
    draw_normals,
    fill_normals,
    key_of,
    normals,
    on_circle,
    philox,
    uniforms,
)

KNOWN_ANSWERS = """
00000000 00000000 00000000 00000000 00000000 00000000   6627e8d5 e169c58d bc57ac4c 9b00dbd8
ffffffff ffffffff ffffffff ffffffff ffffffff ffffffff   408f276d 41c83b0e a20bc7c6 6d5451fd
243f6a88 85a308d3 13198a2e 03707344 a4093822 299f31d0   d16cfe09 94fdcceb 5001e420 24126ea1
"""
"""Counter, key and answer of philox4x32-10, from the file kat_vectors of Random123 (Salmon et al. 2011)."""
FEW, MANY = 1 << 20, 1 << 24
"""Pairs of normal numbers: of the few, 133 of the numbers are expected beyond 4 sigma, and of the many 19 beyond 5."""
FIVE = 5.0
"""Standard errors within which a sum must lie; the seeds are fixed, so it is right or wrong for ever."""


@entry
def answer(words: Array, out: Array) -> None:
    out[0], out[1], out[2], out[3] = philox(words[0], words[1], words[2], words[3], words[4], words[5])


@entry
def pair(key: Array, number: int, purpose: int, lane: int, out: Array) -> None:
    """Of the normal numbers, and of the uniform ones that they are made of."""
    out[0], out[1] = uniforms(key[0], number, purpose, lane)
    out[2], out[3] = normals(key[0], number, purpose, lane)


@entry
def circle(turns: Array, out: Array) -> None:
    for k in range(len(turns)):
        out[k, 0], out[k, 1] = on_circle(turns[k])


@entry
def fill(key: Array, number: int, purpose: int, lane: int, out: Array) -> None:
    fill_normals(key[0], number, purpose, lane, len(out), out)


@entry
def tally(key: Array, pairs: int, beyond: Array, sums: Array) -> None:
    """How many numbers lie beyond 0 to 5 sigma on each side, and the sums of their powers and products."""
    for number in range(pairs):
        x, y = normals(key[0], number, SAMPLE, 0)
        sums[4] += x * y
        sums[5] += x * x * y * y
        for z in (x, y):
            power = 1.0
            for k in range(4):
                power *= z
                sums[k] += power
            for k in range(6):
                if z > k:
                    beyond[0, k] += 1
                if z < -k:
                    beyond[1, k] += 1


def reference(key: int, number: int, purpose: int, lane: int) -> tuple[float, float]:
    """The uniform numbers, in whole numbers of Python."""
    mask = (1 << 32) - 1
    a, b, c, d = purpose * LANES + lane, 0, number & mask, number >> 32
    k, m = key & mask, key >> 32
    for _ in range(10):
        p, q = 0xD2511F53 * a, 0xCD9E8D57 * c
        a, b, c, d = (q >> 32) ^ b ^ k, q & mask, (p >> 32) ^ d ^ m, p & mask
        k, m = (k + 0x9E3779B9) & mask, (m + 0xBB67AE85) & mask
    return tuple(((high >> 5) * (1 << 26) + (low >> 6)) / (1 << 53) for high, low in ((a, b), (c, d)))  # type: ignore[return-value]


def drawn(key: int, number: int = 0, purpose: int = SAMPLE, lane: int = 0, count: int = 2) -> FloatArray:
    out = np.empty(count)
    fill(np.array([key], np.uint64), number, purpose, lane, out)
    return out


@pytest.mark.parametrize("line", KNOWN_ANSWERS.split("\n")[1:-1])
def test_known_answers(line):
    words = [int(word, 16) for word in line.split()]
    out = np.zeros(4, np.uint64)
    answer(np.array(words[:6], np.uint64), out)
    assert [int(word) for word in out] == words[6:]


@pytest.mark.parametrize("key", [0, 1, 0x0123456789ABCDEF, (1 << 64) - 1])
@pytest.mark.parametrize("number", [0, 1, (1 << 32) - 1, 1 << 32, (1 << 62) + 12345])
def test_uniform_and_normal_numbers_are_made_of_all_bits_of_key_and_counter(key, number):
    out = np.zeros(4)
    for purpose, lane in ((SAMPLE, 0), (TURN_ON, 3), (EVENT, LANES - 1)):
        pair(np.array([key], np.uint64), number, purpose, lane, out)
        u, v = reference(key, number, purpose, lane)
        assert (out[0], out[1]) == (u, v)
        r = math.sqrt(-2.0 * math.log(1.0 - u))
        assert (out[2], out[3]) == pytest.approx(
            (r * math.cos(2 * math.pi * v), r * math.sin(2 * math.pi * v)), rel=1e-14
        )


def test_cosine_and_sine_of_turns_are_right_to_the_last_digit():
    eighths = np.arange(9) / 8.0
    turns = np.concatenate(
        [eighths, np.nextafter(eighths[1:], 0.0), np.nextafter(eighths, 1.0), np.random.default_rng(1).random(100_000)]
    )
    out = np.empty((len(turns), 2))
    circle(turns, out)
    angle = 2.0 * np.longdouble("3.14159265358979323846264338327950288") * turns
    assert np.abs(out - np.stack([np.cos(angle), np.sin(angle)], axis=1)).max() < 2.3e-16
    assert out[:8:2].tolist() == [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]


@pytest.mark.parametrize(("pairs", "outermost"), [(FEW, 4), pytest.param(MANY, 5, marks=pytest.mark.slow)])
def test_moments_and_tails(pairs, outermost):
    """Moments within five standard errors, counts beyond 0 to 5 sigma on each side as the exact probability has them."""
    beyond, sums = np.zeros((2, 6), np.int64), np.zeros(6)
    tally(np.array([key_of(1, "rov/imu/noise")], np.uint64), pairs, beyond, sums)
    n = 2 * pairs
    for k, (expected, variance) in enumerate(((0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0))):
        assert abs(sums[k] / n - expected) < FIVE * math.sqrt(variance / n), f"moment {k + 1}"
    # The two of a pair: neither they nor their squares are correlated.
    assert abs(sums[4] / pairs) < FIVE / math.sqrt(pairs)
    assert abs(sums[5] / pairs - 1.0) < FIVE * math.sqrt(8.0 / pairs)
    for sigma in range(6):
        low, high = stats.binom.ppf([1e-7, 1 - 1e-7], n, stats.norm.sf(sigma))
        for side in (0, 1):
            assert low <= beyond[side, sigma] <= high, f"beyond {sigma} sigma"
    assert beyond[0, outermost] > 0
    assert beyond[1, outermost] > 0


def test_the_whole_distribution_is_normal():
    assert stats.kstest(draw_normals(key_of(2, "a"), 200_000), "norm").pvalue > 1e-6


STREAMS = {
    "number": lambda k: {"number": k},
    "number beyond 32 bits": lambda k: {"number": k << 32},
    "purpose": lambda k: {"purpose": k},
    "lane": lambda k: {"lane": 5000 * k},
    "key": lambda k: {"key": 7 + k},
    "key beyond 32 bits": lambda k: {"key": 7 + (k << 32)},
}


@pytest.mark.parametrize("what", STREAMS)
def test_what_differs_in_one_thing_is_independent(what):
    n = 8000
    rows = [drawn(**{"key": 7, **STREAMS[what](k), "count": n}) for k in range(3)]
    for one, other in itertools.combinations(rows, 2):
        assert not np.intersect1d(one, other).size
        assert abs(np.corrcoef(one, other)[0, 1]) < FIVE / math.sqrt(n)
        assert abs(np.corrcoef(one**2, other**2)[0, 1]) < FIVE / math.sqrt(n)


def test_successive_numbers_and_lanes_are_independent():
    n = 20_000
    by_lane = draw_normals(7, n)
    by_number = np.array([drawn(7, number)[0] for number in range(2000)])
    for series in (by_lane, by_number):
        for lag in range(1, 6):
            assert abs(np.corrcoef(series[:-lag], series[lag:])[0, 1]) < FIVE / math.sqrt(len(series))


def test_how_many_are_drawn_changes_none_of_them():
    whole = draw_normals(9, 8, 3, EVENT)
    for count in range(1, 8):
        assert draw_normals(9, count, 3, EVENT).tolist() == whole[:count].tolist()
    assert drawn(9, 3, EVENT, 2, 4).tolist() == whole[4:].tolist()  # two a lane


def test_a_key_depends_on_seed_and_path_alone():
    """In every process, whatever its salt of hashes, and as in a recording of yesterday."""
    assert (key_of(1, "rov/imu/noise"), key_of(2**70, "rov/imu")) == (16678803982125469138, 14048797984546851495)


def test_no_two_of_many_paths_or_seeds_have_one_key():
    keys = {key_of(seed, f"rov{k}/imu/noise") for seed in range(100) for k in range(1000)}
    assert len(keys) == 100_000
    assert all(0 <= key < 1 << 64 for key in keys)
    assert key_of(1, "1/a") != key_of(11, "/a")
