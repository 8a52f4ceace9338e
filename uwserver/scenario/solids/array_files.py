"""Reads parts of arrays in .npy files. The files are not memory-mapped: if a mapped file is truncated meanwhile, the process is killed."""

from __future__ import annotations

import io
import math
import os
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

_HEAD_BYTES = 16_384
"""Most bytes of a header; that of an array of numbers has 128."""


class NoArray(Exception):
    """Raised if a file does not hold an array that a grid can use; the text continues a sentence that begins with the name of the file."""


@dataclass(frozen=True)
class Array:
    """A two-dimensional array of numbers in a file.

    Attributes:
        shape: rows and columns.
        dtype: type of a number.
        by_columns: whether columns are contiguous, not rows.
        offset: position of the first number, bytes.
    """

    shape: tuple[int, int]
    dtype: np.dtype[Any]
    by_columns: bool
    offset: int

    @classmethod
    def of(cls, file: IO[bytes]) -> Array:
        """Read the header, and compare it with the length of the file.

        Raises:
            NoArray: the file does not hold such an array, or is too short.
        """
        head = io.BytesIO(file.read(_HEAD_BYTES))
        readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        try:
            version = np.lib.format.read_magic(head)
            shape, by_columns, dtype = readers[version](head)
        except KeyError:
            raise NoArray("must hold an array of numbers, in version 1 or 2 of the .npy format") from None
        except Exception as error:  # the parser of a header may raise anything
            raise NoArray(f"is not an array in .npy format: {error}") from error
        if len(shape) != 2 or dtype.kind not in "fiu":
            raise NoArray("must hold an array of numbers with rows and columns")
        there, needed = os.fstat(file.fileno()).st_size - head.tell(), math.prod(shape) * dtype.itemsize
        if there < needed or min(shape) < 0:
            raise NoArray(f"should hold {shape[0]} x {shape[1]} numbers in {needed} bytes, but has only {there}")
        return cls(shape, dtype, bool(by_columns), head.tell())

    def read(self, file: IO[bytes], rows: slice, columns: slice) -> np.ndarray[Any, Any]:
        """Read a part of the array; both slices have a start and a stop.

        Raises:
            NoArray: the file became shorter meanwhile.
        """
        outer, inner, length = (columns, rows, self.shape[0]) if self.by_columns else (rows, columns, self.shape[1])
        part = np.empty((outer.stop - outer.start, inner.stop - inner.start), self.dtype)
        for k, line in enumerate(part, outer.start):
            file.seek(self.offset + (k * length + inner.start) * self.dtype.itemsize)
            if file.readinto(line.view(np.uint8)) < line.nbytes:  # type: ignore[attr-defined]  # every buffered file has it
                raise NoArray("became shorter while it was read: load it again")
        return part.T if self.by_columns else part
