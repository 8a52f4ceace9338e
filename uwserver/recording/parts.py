"""A recording in several files: each can be read and replayed by itself, and all together by the name of the first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from uwserver.logfiles.part_files import FIRST_PART, PART, RUN, later_parts, part_of, part_path

__all__ = [
    "BEGINS", "ESTIMATED", "FIRST_PART", "ONE_FILE", "PART", "RUN", "SERVED", "STATE", "WITH_STATE", "Rotation", "begins_with_state",
    "later_parts", "part_of", "part_path",
]  # fmt: skip

STATE = "uwserver/state"
"""The attachment with which each part but the first begins, and a recording that began while the run went on: the state of the world there, as
`snapshot.to_bytes` gives it."""
BEGINS, WITH_STATE = "begins", "with_state"
"""Key of the metadata record of a recording that began while the run went on, and its value."""
SERVED = "served"
"""Key of the metadata record of what `uwserver record` took from a running server, with its address: no scenario stands beside it."""
ESTIMATED = "estimate_of"
"""Likewise of what an estimator made of a recording, with the recording's name."""


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


def begins_with_state(record: Mapping[str, str]) -> bool:
    """Whether the file of this metadata record begins with a state, as the run had begun before it."""
    return part_of(record) > FIRST_PART or record.get(BEGINS) == WITH_STATE
