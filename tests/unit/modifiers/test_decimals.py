"""Numbers are written as the encoder of JSON writes them, to the last byte."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from uwserver.modifiers.decimals import LONGEST
from uwserver.modifiers.lines import _FLOATS, _WHOLES, LineWriter, Piece
from uwserver.ports.told import Log, Told
from uwserver.step.streams import ENTRY

COUNT = 20_000


def written(numbers: Any, kind: int) -> bytes:
    """Numbers of a row, with commas between them."""
    writer, log = LineWriter(), Log(np.zeros(1, ENTRY), np.zeros(len(numbers)))
    log.whole[:] = numbers.view(np.int64)
    form = writer.add((b"[", Piece(kind, 0, len(numbers)), b"]"))
    return writer.write(Told({}, log, 0, 1), np.array([0]), np.array([form]))


def floats(kind: str) -> Any:
    rng = np.random.default_rng(7)
    sign = rng.choice([-1.0, 1.0], COUNT)
    return {
        "of all bits": rng.integers(-(2**63), 2**63 - 1, COUNT).view(np.float64),
        "normal": rng.normal(size=COUNT),
        "rounded": np.round(100.0 * rng.normal(size=COUNT), 3),
        "of few bits": sign * rng.integers(0, 2**53, COUNT) * 2.0 ** rng.integers(-60, 10, COUNT),
        "whole": sign * rng.integers(0, 10**17, COUNT),
        "the smallest": sign * rng.integers(0, 2**16, COUNT) * 5e-324,
        "powers of two and their neighbours": np.concatenate(
            [np.nextafter(2.0 ** np.arange(-1074, 1024), way) for way in (0.0, np.inf)] + [2.0 ** np.arange(-1074, 1024)]
        ),
        "powers of ten": np.array([float(f"{d}e{k}") for d in (1, 9, 123) for k in range(-323, 306)]),
        "ends": np.array(
            [0.0, -0.0, np.nan, np.inf, -np.inf, 1.7976931348623157e308, 2.2250738585072014e-308, 9.5e-6, 1e-5, 9999999999999998.0, 1e16]
        ),
    }[kind]  # fmt: skip


@pytest.mark.parametrize(
    "kind",
    ["of all bits", "normal", "rounded", "of few bits", "whole", "the smallest", "powers of two and their neighbours", "powers of ten", "ends"],
)  # fmt: skip
def test_floats_are_the_shortest_that_read_back(kind: str) -> None:
    numbers = floats(kind)
    line = written(numbers, _FLOATS)
    assert line == msgspec.json.encode(numbers.tolist())
    assert max(map(len, line[1:-1].split(b","))) <= LONGEST
    finite = np.isfinite(numbers)
    assert [n for n in msgspec.json.decode(line) if n is not None] == numbers[finite].tolist()


def test_whole_numbers_of_all_lengths_and_the_missing_one() -> None:
    rng = np.random.default_rng(8)
    numbers = np.concatenate(
        [rng.integers(-(2**k), 2**k, 30) for k in range(1, 63)] + [np.array([0, -1, 2**63 - 1, -(2**63) + 1, -(2**63)])]
    )
    told = [None if n == -(2**63) else n for n in numbers.tolist()]
    assert written(numbers, _WHOLES) == msgspec.json.encode(told)
