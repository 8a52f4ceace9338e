"""A recording in several files: each can be read and replayed by itself, and all together by the name of the first."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

RUN, PART = "run", "part"
"""Keys of the metadata record of a part: what all parts of a run share, and the part's number."""
STATE = "uwserver/state"
"""The attachment with which each part but the first begins: the state of the world there, as `snapshot.to_bytes` gives it."""
FIRST_PART = 1
SERVED = "served"
"""Key of the metadata record of what `uwserver record` took from a running server, with its address: no scenario stands beside it."""
ESTIMATED = "estimate_of"
"""Likewise of what an estimator made of a recording, with the recording's name."""


def part_path(path: Path, number: int) -> Path:
    """The file of a part: the first, 1, is the recording's own name; the second of ``run.mcap`` is ``run.0002.mcap``."""
    return path if number == FIRST_PART else path.with_name(f"{path.stem}.{number:04d}{path.suffix}")


def part_of(record: Mapping[str, str]) -> int:
    """Number of the part that a metadata record heads; 1 too for a recording in one file."""
    number = record.get(PART, "")
    return int(number) if number.isascii() and number.isdigit() and len(number) < 10 else FIRST_PART


def later_parts(path: Path) -> dict[int, Path]:
    """Files that have the names of later parts, by their numbers, in order; whether they are of the same run is not looked at."""
    named = re.compile(rf"{re.escape(path.stem)}\.(\d{{4,}}){re.escape(path.suffix)}")
    found = {int(match[1]): other for other in path.parent.iterdir() if (match := named.fullmatch(other.name))}
    return {number: found[number] for number in sorted(found) if found[number] == part_path(path, number)}


@dataclass(frozen=True)
class Rotation:
    """When a recording goes on in its next part: at the first whole simulated second at which it has grown so far.

    Attributes:
        most_bytes: of a part; 0 for no limit.
        most_s: simulated time of a part, s; 0 for no limit.
    """

    most_bytes: int = 0
    most_s: float = 0.0

    def __bool__(self) -> bool:
        return bool(self.most_bytes or self.most_s)

    def is_due(self, size: int, seconds: float) -> bool:
        """Whether a part of this size (bytes) and length (s) is full."""
        return bool(self.most_bytes and size >= self.most_bytes) or bool(self.most_s and seconds >= self.most_s)


ONE_FILE = Rotation()
