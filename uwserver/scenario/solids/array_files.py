"""Parts of arrays in .npy files. Read piece by piece and not mapped: a mapped file that somebody cuts meanwhile kills the process."""

from __future__ import annotations

import io
import math
import os
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

_HEAD_BYTES = 16_384
"""The header of an array of numbers has 128."""


class NoArray(Exception):
    """Not what a grid needs; the text goes on behind the file's name."""


@dataclass(frozen=True)
class Array:
    """An array of numbers with rows and columns in a file.

    Attributes:
        shape: rows and columns.
        dtype: of a number.
        by_columns: columns are contiguous, not rows.
        offset: of the first number, bytes.
    """

    shape: tuple[int, int]
    dtype: np.dtype[Any]
    by_columns: bool
    offset: int

    @classmethod
    def of(cls, file: IO[bytes]) -> Array:
        """What the header says, which is compared with the length of the file.

        Raises:
            NoArray: see there.
        """
        head = io.BytesIO(file.read(_HEAD_BYTES))
        readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        try:
            version = np.lib.format.read_magic(head)
            if version not in readers:
                raise NoArray("must hold an array of numbers with rows and columns")
            shape, by_columns, dtype = readers[version](head)
        except NoArray:
            raise
        except Exception as error:  # the parser of a header may raise anything
            raise NoArray(f"is no .npy array: {error}") from error
        if len(shape) != 2 or dtype.kind not in "fiu":
            raise NoArray("must hold an array of numbers with rows and columns")
        there, needed = os.fstat(file.fileno()).st_size - head.tell(), math.prod(shape) * dtype.itemsize
        if there < needed or min(shape) < 0:
            raise NoArray(f"says it has {shape[0]} x {shape[1]} numbers, {needed} bytes, but only {there} follow")
        return cls(shape, dtype, bool(by_columns), head.tell())

    def read(self, file: IO[bytes], rows: slice, columns: slice) -> np.ndarray[Any, Any]:
        """A part of it; both slices have a start and a stop.

        Raises:
            NoArray: the file was cut meanwhile.
        """
        outer, inner, length = (columns, rows, self.shape[0]) if self.by_columns else (rows, columns, self.shape[1])
        lines = []
        for k in range(outer.start, outer.stop):
            file.seek(self.offset + (k * length + inner.start) * self.dtype.itemsize)
            line = file.read((inner.stop - inner.start) * self.dtype.itemsize)
            if len(line) < (inner.stop - inner.start) * self.dtype.itemsize:
                raise NoArray("was cut while it was read: load it again")
            lines.append(np.frombuffer(line, self.dtype))
        part = np.array(lines, self.dtype).reshape(outer.stop - outer.start, inner.stop - inner.start)
        return part.T if self.by_columns else part
