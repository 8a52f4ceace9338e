"""Files that others wrote, opened so that none of them holds up or fills the process: plain files only, of a bounded size."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

NOT_PLAIN = "it is no plain file (a folder, a pipe or a device)"


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """The file for reading. A pipe is not waited for, and a device is not read.

    Raises:
        OSError: it cannot be opened, or is no plain file; `strerror` says why in words.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except ValueError as error:  # a NUL in the name, or half a surrogate pair
        raise OSError(errno.EINVAL, f"no file can have this name: {error}") from error
    with os.fdopen(_plain(descriptor), "rb") as file:
        yield file


def read_whole(path: Path, most_bytes: int) -> bytes:
    """The file's bytes, as they are while it is read once: what is checked of them holds, though the file may change.

    Raises:
        OSError: as `opened`; or it has more than `most_bytes`, or grows.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most_bytes:
            raise OSError(errno.EFBIG, f"it has {size} bytes: at most {most_bytes}")
        data = file.read(size + 1)
    if len(data) > size:
        raise OSError(errno.EAGAIN, "it grew while it was read: wait until it is written")
    return data


def is_plain(path: Path) -> bool:
    """Whether there is such a file; False also where nobody may look, or no file can have that name."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _plain(descriptor: int) -> int:
    """The descriptor, which is closed if it is not of a plain file."""
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, NOT_PLAIN)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
