"""Files of compiled kernels, and which of them may be read.

A file is a line that names the folder for which it was made, a SHA-256 sum, and a pickle. Whoever can write a pickle that is read here runs code
of his own, so a folder or a file counts only if its owner is this user or root, and nobody else can write it. A file that is cut off, damaged
or of another folder is as none.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
from pathlib import Path

_SUM = hashlib.sha256
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def _owned_safely(status: os.stat_result) -> bool:
    if not hasattr(os, "geteuid"):
        return True
    return status.st_uid in (os.geteuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def fault_of(folder: Path) -> str:
    """Why nothing is read from a folder that is there; empty if it may be read.

    Raises:
        OSError: it cannot be looked at.
    """
    status = os.lstat(folder)
    if not stat.S_ISDIR(status.st_mode):
        return f"{folder} is a link or a file, not a folder"
    if not _owned_safely(status):
        return f"{folder} belongs to somebody else, or others may write it (chmod 700): not read"
    return ""


def read(folder: Path, name: str, packaged: bool = False) -> bytes | None:
    """What `write` got for this name; None without a sound file of that name.

    Args:
        folder: one without a `fault_of`.
        name: of the file.
        packaged: whether the folder is part of the installed package; its files are then as good as the code beside them.
    """
    try:
        descriptor = os.open(folder / name, os.O_RDONLY | _NO_LINK)
        with os.fdopen(descriptor, "rb") as file:
            if not packaged and not _owned_safely(os.fstat(descriptor)):
                return None
            data = file.read()
    except OSError:
        return None
    head, _, rest = data.partition(b"\n")
    body = rest[_SUM().digest_size :]
    sound = head == folder.name.encode() and rest[: len(rest) - len(body)] == _SUM(body).digest() and body
    return body if sound else None


def write(folder: Path, name: str, body: bytes) -> None:
    """Keep bytes under a name, at once or not at all; a folder that is full or gone keeps nothing."""
    with contextlib.suppress(OSError):
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:  # mode 0600
            path = Path(file.name)
            try:
                file.write(folder.name.encode() + b"\n" + _SUM(body).digest() + body)
                file.close()
                path.replace(folder / name)
            except OSError:
                path.unlink()
                raise
