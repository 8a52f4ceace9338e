"""A recording in several files: each can be read and replayed by itself, and all together by the name of the first."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

RUN, PART = "run", "part"
"""Keys of the metadata record of a part: what all parts of a run share, and the part's number."""
STATE = "uwserver/state"
"""The attachment with which each part but the first begins: the state of the world there, as `snapshot.to_bytes` gives it."""
FIRST_PART = 1
SERVED = "served"
"""Key of the metadata record of what `uwserver record` took from a running server, with its address: no scenario stands beside it."""


def part_path(path: Path, number: int) -> Path:
    """The file of a part: the first, 1, is the recording's own name; the second of ``run.mcap`` is ``run.0002.mcap``."""
    return path if number == FIRST_PART else path.with_name(f"{path.stem}.{number:04d}{path.suffix}")


def part_of(record: Mapping[str, str]) -> int:
    """Number of the part that a metadata record heads; 1 too for a recording in one file."""
    number = record.get(PART, "")
    return int(number) if number.isascii() and number.isdigit() and len(number) < 10 else FIRST_PART
