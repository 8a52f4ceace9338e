"""Names and numbers of the files of a recording of ours that goes on in several."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

RUN, PART = "run", "part"
"""Keys of the metadata record of a part: what all parts of a run share, and the part's number."""
FIRST_PART = 1


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
