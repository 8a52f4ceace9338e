"""Memory of the copies: what is placed there is a copy in lines of its own, and there is no end to it but that of the rest of Python."""

from itertools import pairwise

import numpy as np
import pytest

from uwserver.copies.memory import LINE, Memory, lines

RECORD = np.dtype([("number", np.int64), ("place", np.float64, (3,)), ("flag", np.uint8)])


def records(n):
    rows = np.zeros(n, RECORD)
    rows["number"], rows["flag"] = np.arange(n) + 7, 1
    rows["place"] = np.arange(3 * n).reshape(n, 3) / 3
    return rows


def arrays():
    """Of all forms that a world has, with nan, odd lengths and nothing at all."""
    return [
        np.array([1.5, np.nan, -0.0]),
        records(5),
        np.zeros((0, 13)),
        np.arange(26.0).reshape(2, 13),
        np.zeros(0, RECORD),
        np.arange(7, dtype=np.uint8),
        np.array([-(2**62)]),
        np.arange(24).reshape(2, 3, 4),
        records(1),
    ]


def size_of(given):
    return sum(lines(array.nbytes) for array in given)


def same(placed, given):
    return (
        placed.dtype == given.dtype
        and placed.shape == given.shape
        and placed.flags.c_contiguous
        and placed.flags.writeable
        and placed.tobytes() == given.tobytes()
    )


def span(array):
    """Addresses of its first byte and of the one behind its last."""
    return array.ctypes.data, array.ctypes.data + array.nbytes


@pytest.mark.parametrize(("count", "needed"), [(0, 0), (1, 64), (63, 64), (64, 64), (65, 128), (6400, 6400)])
def test_lines_are_whole(count, needed):
    assert (lines(count), LINE) == (needed, 64)


def test_what_is_placed_is_the_same_in_other_memory():
    given = arrays()
    place = Memory(1, size_of(given)).of(0)
    for array in given:
        placed = place(array)
        assert same(placed, array)
        assert not np.shares_memory(placed, array)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_no_array_shares_a_line_with_another_or_with_another_copy(n):
    given = arrays()
    memory = Memory(n, size_of(given))
    placed = [place(array) for place in [memory.of(i) for i in range(n)] for array in given]
    there = sorted(span(array) for array in placed if array.nbytes)
    assert all(first % 64 == 0 for first, _ in there)
    assert all(lines(end) <= first for (_, end), (first, _) in pairwise(there))
    for array in placed:
        array.reshape(-1).view(np.uint8)[:] = 255
        assert sum((other.reshape(-1).view(np.uint8) == 255).all() for other in placed if other.nbytes) == (
            1 if array.nbytes else 0
        )
        array.reshape(-1).view(np.uint8)[:] = 0


def test_arrays_of_a_copy_lie_side_by_side_and_those_of_the_next_behind_them():
    given = arrays()
    memory = Memory(3, size_of(given))
    there = [span(place(array)) for place in [memory.of(i) for i in range(3)] for array in given if array.nbytes]
    assert all(first == lines(end) for (_, end), (first, _) in pairwise(there))


def test_places_begin_anew_when_they_are_asked_for_again_and_those_of_others_stay():
    given = arrays()
    memory = Memory(2, size_of(given))
    (mine, others), again = [[place(array) for array in given] for place in (memory.of(0), memory.of(1))], memory.of(0)
    anew = [again(array) for array in mine[::-1]][::-1]
    for array, other in zip(given, others, strict=True):
        assert same(other, array)
    assert min(span(a)[0] for a in anew if a.nbytes) == min(span(a)[0] for a in mine if a.nbytes)


def test_what_is_placed_where_it_lies_already_stays_what_it_is():
    """A copy that is moved again, in the same order."""
    given = arrays()
    memory = Memory(1, size_of(given))
    for _ in range(2):
        place = memory.of(0)
        given = [place(array) for array in given]
    assert all(same(array, wanted) for array, wanted in zip(given, arrays(), strict=True))


@pytest.mark.parametrize("room", [0, 64, 128, 192])
def test_what_is_too_large_has_memory_of_its_own_and_what_fits_still_comes_in(room):
    memory = Memory(2, room)
    place, beside = memory.of(0), memory.of(1)
    small, large = np.arange(8.0), np.arange(32.0)
    other = beside(small)
    placed = [place(array) for array in (small, large, small + 1, records(3), small + 2)]
    for array, wanted in zip(placed, (small, large, small + 1, records(3), small + 2), strict=True):
        assert same(array, wanted)
    assert same(other, small)
    for k, array in enumerate(placed):
        assert not any(np.shares_memory(array, each) for each in (other, small, large, *placed[:k]))
    within = [array for array in placed if np.shares_memory(array, memory._bytes[:room])]
    assert len(within) == min(3, room // 64)
    assert not any(np.shares_memory(array, memory._bytes[room:]) for array in placed)
