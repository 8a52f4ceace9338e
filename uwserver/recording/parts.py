"""The files of a recording: how a new one is made, and how a recording is divided into several.

Each part can be read and replayed alone; the name of the first stands for all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from uwserver.logfiles.part_files import FIRST_PART, PART, RUN, later_parts, part_of, part_path

__all__ = [
    "BEGINS", "ESTIMATED", "FIRST_PART", "ONE_FILE", "PART", "RUN", "SERVED", "STATE", "WITH_STATE", "Rotation", "begins_with_state",
    "later_parts", "part_of", "part_path",
]  # fmt: skip

STATE = "uwserver/state"
"""Attachment with the state of the world at the begin of the file, in the form of `snapshot.to_bytes`. Every part except the first has it, and a
recording that began during the run."""
BEGINS, WITH_STATE = "begins", "with_state"
"""Key and value in the metadata record of a recording that began during the run."""
SERVED = "served"
"""Key in the metadata record of a file that `uwserver record` took from a running server; its value is the address. Such a record has no scenario."""
ESTIMATED = "estimate_of"
"""Key in the metadata record of a file that an estimator made of a recording; its value is the name of that recording."""


@dataclass(frozen=True)
class Rotation:
    """The limits of a part. The recording continues in the next part at the first whole simulated second at which a limit is reached.

    Attributes:
        most_bytes: size of a part; 0 for no limit.
        most_s: simulated time of a part, s; 0 for no limit.
    """

    most_bytes: int = 0
    most_s: float = 0.0

    def __bool__(self) -> bool:
        return bool(self.most_bytes or self.most_s)

    def is_due(self, size: int, seconds: float) -> bool:
        """Return whether a part of this size (bytes) and length (s) is full."""
        return bool(self.most_bytes and size >= self.most_bytes) or bool(self.most_s and seconds >= self.most_s)


ONE_FILE = Rotation()


def begins_with_state(record: Mapping[str, str]) -> bool:
    """Return whether the file of this metadata record begins with a state, because the run had begun before the file."""
    return part_of(record) > FIRST_PART or record.get(BEGINS) == WITH_STATE


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
