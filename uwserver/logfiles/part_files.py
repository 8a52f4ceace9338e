"""Names and numbers of the files of a recording that was written in several parts."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

RUN, PART = "run", "part"
"""Keys of a part's metadata record: the identifier that all parts of a run share, and the number of the part."""
FIRST_PART = 1


class MissingPart(Exception):
    """A part of a recording is missing although a later one exists; the text names the files."""


def part_path(path: Path, number: int) -> Path:
    """Return the file of a part. Part 1 has the recording's own name; the second part of ``run.mcap`` is ``run.0002.mcap``."""
    return path if number == FIRST_PART else path.with_name(f"{path.stem}.{number:04d}{path.suffix}")


def part_of(record: Mapping[str, str]) -> int:
    """Return the part number in a metadata record; 1 also for a recording in one file."""
    number = record.get(PART, "")
    return int(number) if number.isascii() and number.isdigit() and len(number) < 10 else FIRST_PART


def later_parts(path: Path) -> dict[int, Path]:
    """Return the files that are named like later parts, in the order of their numbers. They may belong to another run."""
    named = re.compile(rf"{re.escape(path.stem)}\.(\d{{4,}}){re.escape(path.suffix)}")
    found = {int(match[1]): other for other in path.parent.iterdir() if (match := named.fullmatch(other.name))}
    return {number: found[number] for number in sorted(found) if found[number] == part_path(path, number)}


def parts_of_run(path: Path, head_of: Callable[[Path], Mapping[str, str]]) -> tuple[Path, ...]:
    """Return all files of a recording in their order; a later part, or a recording in one file, is returned alone.

    Args:
        path: the first file of the recording.
        head_of: reads the metadata record of a file.

    Raises:
        MissingPart: a part is missing.
    """
    first = head_of(path)
    if PART not in first or part_of(first) != FIRST_PART:
        return (path,)
    there = [number for number, other in later_parts(path).items() if head_of(other).get(RUN) == first.get(RUN)]
    for expected, number in enumerate(there, FIRST_PART + 1):
        if number != expected:
            missing = part_path(path, expected).name
            raise MissingPart(f"{path}: its part {missing} is missing, but {part_path(path, number).name} exists")
    return (path, *(part_path(path, number) for number in there))
