"""New files for recordings."""

from __future__ import annotations

from pathlib import Path
from typing import IO


def new_file(path: Path) -> IO[bytes]:
    """A file for a recording. An old one is never overwritten: it may be the only one of its run.

    Raises:
        OSError: it exists already or cannot be written; the text names it and says what to do.
    """
    try:
        return path.open("xb")
    except FileExistsError:
        raise there_already(path) from None
    except OSError as error:
        raise unwritable(path, error) from error


def there_already(path: Path) -> FileExistsError:
    """What to say of a file that is there."""
    return FileExistsError(
        f"cannot record to {path}: it exists already; give --record another name, or remove it first"
    )


def unwritable(path: Path, error: OSError) -> OSError:
    """What to say of a place that cannot be written."""
    reason = error.strerror or str(error)
    return OSError(f"cannot record to {path}: {reason}; give --record a place that can be written")
