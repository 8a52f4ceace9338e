"""The chunks of a recording in several files, as if they stood in one.

Channels have other numbers in each file; here those of a topic have one. Of files that are not read just now none is kept open, so that their
number is not limited by the system's.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from uwserver.recording.format import METADATA
from uwserver.recording.parts import FIRST_PART, PART, RUN, part_of, part_path
from uwserver.recording.player_file import Channel, Chunk, Chunks, Message, NotPlayable
from uwserver.recording.reading import NotReplayable, head_record, parts_of

_Key = tuple[Channel, int]
"""A channel, and how many of the same topic and encoding its file had before it: of ports of one name and other kinds."""


class PartChunks:
    """An open recording: as `Chunks`, over all its parts. A part that is named itself is opened alone.

    Attributes:
        path, metadata: of the first part.
        chunks: of all parts, in their order.
        channels: by number.
        parts: files that are read.
    """

    def __init__(self, path: Path, names: Mapping[str, str] = MappingProxyType({})) -> None:
        """Of a recording's name.

        Args:
            path: of the first part, or of any one.
            names: as of `Chunks`.

        Raises:
            OSError: a file cannot be read.
            NotPlayable: it is no MCAP file, or a part is missing.
        """
        self.path, self._names = path, names
        self.chunks: list[Chunk] = []
        self.channels: dict[int, Channel] = {}
        self._parts: list[Chunks] = []
        self._starts: list[int] = []
        self._number_of: dict[_Key, int] = {}
        self._numbers: list[dict[int, int]] = []
        self._files_of: list[dict[int, int]] = []
        self._seen: list[Counter[Channel]] = []
        self._is_as_written: list[bool] = []
        self._read = 0
        self._add(Chunks(path, names))
        self.metadata = self._parts[0].metadata
        self._run = self._run_of(self._parts[0])
        try:
            for part in self._later():
                self._add(Chunks(part, names))
        except BaseException:
            self.close()
            raise

    @staticmethod
    def _run_of(first: Chunks) -> str:
        """What all parts of the run share; "" where no other belongs to this file."""
        head = first.metadata.get(METADATA, {})
        return head.get(RUN, "") if PART in head and part_of(head) == FIRST_PART else ""

    def _later(self) -> tuple[Path, ...]:
        try:
            return parts_of(self.path)[1:] if self._run else ()
        except NotReplayable as error:
            raise NotPlayable(str(error)) from error

    def _add(self, part: Chunks) -> None:
        if self._parts:
            self._parts[-1].close()
        self._parts.append(part)
        self._starts.append(len(self.chunks))
        self._numbers.append({})
        self._files_of.append({})
        self._seen.append(Counter())
        self._is_as_written.append(True)
        self._take_in()

    def _take_in(self) -> None:
        """What the last part has got."""
        self._learn(len(self._parts) - 1)
        self.chunks += self._parts[-1].chunks[len(self.chunks) - self._starts[-1] :]

    def _learn(self, k: int) -> None:
        """Give numbers to channels of a part that are new."""
        numbers, channels = self._numbers[k], self._parts[k].channels
        if len(numbers) == len(channels):
            return
        for own, channel in channels.items():
            if own not in numbers:
                key = (channel, self._seen[k][channel])
                self._seen[k][channel] += 1
                number = self._number_of.get(key)
                if number is None:
                    number = self._number_of[key] = own if own not in self.channels else max(self.channels) + 1
                numbers[own], self._files_of[k][number] = number, own
                self._is_as_written[k] &= number == own
                self.channels.setdefault(number, channel)

    @property
    def parts(self) -> tuple[Path, ...]:
        """Files of the recording that are read."""
        return tuple(part.path for part in self._parts)

    @property
    def has_index(self) -> bool:
        """Whether each part brought one."""
        return all(part.has_index for part in self._parts)

    @property
    def is_finished(self) -> bool:
        """Whether nothing comes any more."""
        return self._parts[-1].is_finished and not self._is_next_there()

    @property
    def is_replaced(self) -> bool:
        """As of `Chunks`, of the part that is still written."""
        return self._parts[-1].is_replaced

    def close(self) -> None:
        """Close all files."""
        for part in self._parts:
            part.close()

    def messages(self, chunk: int) -> list[Message]:
        """As `Chunks.messages`."""
        k = bisect_right(self._starts, chunk) - 1
        if k != self._read:
            if self._read != len(self._parts) - 1:
                self._parts[self._read].close()
            self._read = k
        found = self._parts[k].messages(chunk - self._starts[k])
        self._learn(k)
        numbers = self._numbers[k]
        if self._is_as_written[k]:
            return found
        return [Message(numbers.get(own, -1), t_ns, data) for own, t_ns, data in found]

    def last_with(self, channel: int, before: int) -> int:
        """As `Chunks.last_with`."""
        for k in range(min(len(self._parts), bisect_right(self._starts, before)) - 1, -1, -1):
            own = self._files_of[k].get(channel)
            found = -1 if own is None else self._parts[k].last_with(own, before - self._starts[k])
            if found >= 0:
                return found + self._starts[k]
        return -1

    def holding(self, channel: int) -> list[int]:
        """As `Chunks.holding`."""
        return [
            int(chunk) + start
            for part, start, files in zip(self._parts, self._starts, self._files_of, strict=True)
            if channel in files
            for chunk in part.holding(files[channel])
        ]

    def refresh(self) -> bool:
        """As `Chunks.refresh`; goes on in the next part when that is there."""
        before = len(self.chunks)
        self._parts[-1].refresh()
        self._take_in()
        while self._parts[-1].is_finished and self._goes_on():
            pass
        return len(self.chunks) > before

    def _next_path(self) -> Path:
        return part_path(self.path, len(self._parts) + FIRST_PART)

    def _is_next_there(self) -> bool:
        """Whether there is a next part, or what may be one whose head is not written yet."""
        if not self._run:
            return False
        try:
            return head_record(self._next_path()).get(RUN) == self._run
        except NotReplayable:
            return True
        except OSError:
            return False

    def _goes_on(self) -> bool:
        """Open the next part, if it is there and of this run."""
        before = len(self._parts)
        for path in self._later()[before - 1 :]:
            self._add(Chunks(path, self._names))
        return len(self._parts) > before
