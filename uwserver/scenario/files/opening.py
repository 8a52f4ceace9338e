"""Opens files from outside safely: only regular files, and only up to a given size."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

NOT_PLAIN = "it is not a regular file (but a folder, a pipe or a device)"


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Open a file for reading. The call does not wait for the writer of a pipe, and does not read a device.

    Raises:
        OSError: it cannot be opened, or is not a regular file; `strerror` says why in words.
    """
    try:
        # Without O_NONBLOCK the call would wait until somebody writes to a pipe.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except ValueError as error:  # the name has a NUL or half a surrogate pair
        raise OSError(errno.EINVAL, f"a file cannot have this name: {error}") from error
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, NOT_PLAIN)
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            yield file
    finally:
        os.close(descriptor)


def read_whole(path: Path, most_bytes: int) -> bytes:
    """Return the bytes of a file. It is read once, so what was checked stays true even if the file changes later.

    Raises:
        OSError: as `opened`; or the file has more than `most_bytes`, or grows while it is read.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most_bytes:
            raise OSError(errno.EFBIG, f"it has {size} bytes; at most {most_bytes} are allowed")
        data = file.read(size + 1)
    if len(data) > size:
        raise OSError(errno.EAGAIN, "it grew while it was read: try again once it is complete")
    return data


def is_plain(path: Path) -> bool:
    """Return whether this is a regular file; False also if the folder may not be read or the name is impossible."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
