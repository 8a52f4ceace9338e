"""Delivered samples as lines of JSON, written by compiled code from the rows in which they lie: no object is made, and meanwhile others have the
interpreter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec
import numpy as np

from uwserver.modifiers.columns import columns_of
from uwserver.modifiers.decimals import LONGEST, write_float, write_null, write_whole
from uwserver.physics.kernel.arrays import Array, IntArray, shared_numbers
from uwserver.physics.kernel.deferred import Elsewhere, compiled, entry
from uwserver.physics.kernel.places import WAY_SIZE
from uwserver.physics.kernel.right_of_way import RightOfWay
from uwserver.ports import Field, Port
from uwserver.ports.told import Told

_BYTES, _TEXT, _HEAD, _IS_VALID, _FLOATS, _FLAGS, _WHOLES = range(7)
_KINDS = {"float": _FLOATS, "bool": _FLAGS, "int": _WHOLES}
_NO_WHOLE = -(1 << 63)
"""`modifiers.columns`."""
_TEXTS = 1024
"""Texts that are remembered as they are encoded: modes, and reasons."""

_NULL, _TRUE, _FALSE = (np.frombuffer(word, np.uint8) for word in (b"null", b"true", b"false"))
_COMMA = np.uint8(ord(","))

_GIVING_WAY = "uwserver.physics.kernel.giving_way"
leave: Any = Elsewhere(_GIVING_WAY, "leave")
enter: Any = Elsewhere(_GIVING_WAY, "enter")


class Piece(NamedTuple):
    """A part of a line that differs from sample to sample.

    Attributes:
        kind: of what stands there.
        first: where it begins: the place in an entry of a log, or the number in a row, or the one of several texts.
        size: how many numbers, with commas between them.
    """

    kind: int
    first: int = 0
    size: int = 1


T_SENT_NS, SEQ, T_NS, VALID = Piece(_HEAD, 0), Piece(_HEAD, 3), Piece(_HEAD, 4), Piece(_IS_VALID, 5)
"""What all samples have (`ports.told.Log.entries`)."""


def pieces_of(port: Port, selected: Sequence[str] | None = None) -> tuple[bytes | Piece, ...] | None:
    """The values of a sample as a map by field: all of them, or those selected. None where that takes more than numbers and texts."""
    columns = columns_of(port.fields)
    if not columns.is_small:
        return None
    pieces: list[bytes | Piece] = []
    for place, (field, first) in enumerate(zip(port.fields, columns.first, strict=True)):
        if selected is not None and field.name not in selected:
            continue
        pieces.append((b"," if pieces else b"") + msgspec.json.encode(field.name) + b":")
        pieces += [Piece(_TEXT, columns.loose.index(place))] if first < 0 else _shaped(field, field.shape, first)
    return (b"{", *pieces, b"}")


def _shaped(field: Field, shape: Sequence[int], first: int) -> Iterator[bytes | Piece]:
    """Lists in lists, where a field has more than one dimension."""
    count = int(np.prod(shape, dtype=np.int64))
    if not shape:
        yield Piece(_KINDS[field.type], first)
    elif len(shape) == 1:
        yield from (b"[", Piece(_KINDS[field.type], first, count), b"]")
    else:
        size = count // shape[0] if shape[0] else 0
        yield b"["
        for k in range(shape[0]):
            yield b"," if k else b""
            yield from _shaped(field, shape[1:], first + k * size)
        yield b"]"


@compiled
def _write_bytes(given: Array, first: int, count: int, out: Array, at: int) -> int:
    for i in range(count):
        out[at + i] = given[first + i]
    return at + count


@compiled
def _write_flag(number: float, out: Array, at: int) -> int:
    if number != number:
        return int(write_null(out, at))
    word = _TRUE if number != 0.0 else _FALSE
    return int(_write_bytes(word, 0, len(word), out, at))


@compiled
def _write_numbers(step: Array, numbers: Array, whole: Array, row: int, out: Array, at: int) -> int:
    kind, first = step[0], row + step[1]
    for i in range(first, first + step[2]):
        if i > first:
            out[at] = _COMMA
            at += 1
        if kind == _FLOATS:
            at = write_float(whole[i], out, at)
        elif kind == _FLAGS:
            at = _write_flag(numbers[i], out, at)
        elif whole[i] == _NO_WHOLE:
            at = write_null(out, at)
        else:
            at = write_whole(whole[i], out, at)
    return at


@entry
def write_lines(
    way: Array, table: Array, numbers: Array, whole: Array, places: Array, forms: Array, firsts: Array, steps: Array, given: Array,
    texts: Array, ends: Array, out: Array,
) -> int:  # fmt: skip
    """Write lines; returns how many bytes they are.

    Args:
        way: numbers of a right of way, without which it is done.
        table, numbers, whole: of a log.
        places: of samples there.
        forms: of their lines.
        firsts: of a form, the place of its first step; one more than there are forms.
        steps: (n, 3) kind, first and count of a `Piece`; of bytes that are always the same, where they begin in `given`, and how many they are.
        given: those bytes.
        texts, ends: of those steps that are texts, in their order: all of them, and where each ends.
        out: has room for the longest that they can be.
    """
    at = text = 0
    leave(way)
    for n in range(len(places)):
        head, form = table[places[n]], forms[n]
        for k in range(firsts[form], firsts[form + 1]):
            step = steps[k]
            if step[0] == _BYTES:
                at = _write_bytes(given, step[1], step[2], out, at)
            elif step[0] == _HEAD:
                at = write_whole(head[step[1]], out, at)
            elif step[0] == _IS_VALID:
                at = _write_flag(float(head[step[1]]), out, at)
            elif step[0] == _TEXT:
                begin = ends[text - 1] if text > 0 else 0
                at = _write_bytes(texts, begin, ends[text] - begin, out, at)
                text += 1
            else:
                at = _write_numbers(step, numbers, whole, head[6], out, at)
    enter(way)
    return at


class LineWriter:
    """Writes samples in forms that it was given."""

    def __init__(self, way: RightOfWay | None = None) -> None:
        """In no form; `way`: of who writes, whom others may interrupt while he does."""
        load()
        self._way = shared_numbers(WAY_SIZE) if way is None else way.numbers
        self._given = bytearray()
        self._steps: list[tuple[int, int, int]] = []
        self._firsts, self._bounds = [0], list[int]()
        self._texts: list[tuple[int, ...]] = []
        self._out = np.zeros(1 << 16, np.uint8)
        self._gather()

    def add(self, pieces: Iterable[bytes | Piece]) -> int:
        """One form more; returns its number."""
        bound, texts = 0, []
        for piece in pieces:
            if isinstance(piece, bytes):
                self._steps.append((_BYTES, len(self._given), len(piece)))
                self._given += piece
                bound += len(piece)
                continue
            self._steps.append(piece)
            texts += [piece.first] if piece.kind == _TEXT else []
            bound += 0 if piece.kind == _TEXT else piece.size * (LONGEST + 1)
        self._firsts.append(len(self._steps))
        self._bounds.append(bound)
        self._texts.append(tuple(texts))
        self._stale = True
        return len(self._bounds) - 1

    def _gather(self) -> None:
        steps = np.array(self._steps, np.int64).reshape(-1, 3)
        self._tables = np.array(self._firsts), steps, np.frombuffer(bytes(self._given), np.uint8)
        self._room = np.array(self._bounds, np.int64)
        self._wordy = np.array([bool(texts) for texts in self._texts], np.bool_)
        self._stale = False

    def write(self, told: Told, places: IntArray, forms: IntArray) -> bytes:
        """Some samples, each in a form.

        Args:
            told: they stand in its log.
            places: there.
            forms: of each, its number.

        Raises:
            ValueError: a text that has no encoding.
        """
        if self._stale:
            self._gather()
        log, texts = told.log, self._texts_of(told, places, forms)
        joined = b"".join(texts)
        room = int(self._room[forms].sum()) + len(joined)
        if room > len(self._out):
            self._out = np.zeros(2 * room, np.uint8)
        ends = np.cumsum([len(text) for text in texts], dtype=np.int64) if texts else _NO_ENDS
        written = np.frombuffer(joined, np.uint8) if joined else _NO_BYTES
        end = write_lines(
            self._way, log.table, log.numbers, log.whole, places, forms, *self._tables, written, ends, self._out
        )  # fmt: skip
        return self._out[:end].tobytes()

    def _texts_of(self, told: Told, places: IntArray, forms: IntArray) -> list[bytes]:
        """All texts of these samples, in their order."""
        wordy = self._wordy[forms].nonzero()[0]
        at, wanted = places[wordy], self._texts
        which = zip(at.tolist(), *told.log.table[at, 1:3].T.tolist(), forms[wordy].tolist(), strict=True)
        return [
            _encoded(told.loose(place, texts, stream)[k]) for place, texts, stream, form in which for k in wanted[form]
        ]


@lru_cache(_TEXTS)
def _encoded(text: object) -> bytes:
    return msgspec.json.encode(text)


_NO_ENDS = np.zeros(0, np.int64)
_NO_BYTES = np.frombuffer(b"", np.uint8)


def load() -> None:
    """Have it ready, compiled or from the cache, so that nobody who waits for a sample waits for it."""
    none, given = np.zeros(0, np.int64), _NO_BYTES
    write_lines.made().load(
        none, none.reshape(0, 7), np.zeros(0), none, none, none, none, none.reshape(0, 3), given, given, none, np.zeros(0, np.uint8)
    )  # fmt: skip
