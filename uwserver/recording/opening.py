"""Makes new files for recordings."""

from __future__ import annotations

from pathlib import Path
from typing import IO


def new_file(path: Path) -> IO[bytes]:
    """Make a file for a recording. An old file is never overwritten: it may be the only record of its run.

    Raises:
        OSError: the file exists already or cannot be written; the text names it and says what to do.
    """
    try:
        return path.open("xb")
    except FileExistsError:
        raise there_already(path) from None
    except OSError as error:
        raise unwritable(path, error) from error


def there_already(path: Path) -> FileExistsError:
    """Return the error for a file that exists already."""
    return FileExistsError(
        f"cannot record to {path}: it exists already; give --record another name, or remove it first"
    )


def unwritable(path: Path, error: OSError) -> OSError:
    """Return the error for a file that cannot be written."""
    return OSError(f"cannot record to {path}: {error.strerror or error}; give --record a place that can be written")
