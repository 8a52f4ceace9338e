"""The chunks of a recording in several files, as if they were in one file.

Channels have different numbers in each file; here all channels of a topic have one number. Only the files that are being read are open, so that the
system's limit of open files does not limit the number of parts.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from uwserver.recording.format import METADATA
from uwserver.recording.parts import FIRST_PART, PART, RUN, part_of, part_path
from uwserver.recording.player_file import Channel, Chunk, Chunks, McapMessage, NotPlayable
from uwserver.recording.reading import NotReplayable, head_record, parts_of

_Key = tuple[Channel, int]
"""A channel, and how many channels of the same topic and encoding come before it in its file: those of ports of one path with other fields."""


@dataclass
class _Part:
    """One file.

    Attributes:
        file: its chunks.
        start: number of its first chunk in the recording.
        numbers: maps channel numbers of the file to those here.
        own: maps channel numbers here to those of the file.
        seen: number of channels of each topic and encoding so far.
        is_as_written: all channel numbers are the same here and in the file.
    """

    file: Chunks
    start: int
    numbers: dict[int, int] = field(default_factory=dict)
    own: dict[int, int] = field(default_factory=dict)
    seen: Counter[Channel] = field(default_factory=Counter)
    is_as_written: bool = True


class PartChunks:
    """An open recording: like `Chunks`, with all its parts. A later part that is opened by its own name is opened alone.

    Attributes:
        path, metadata: of the first part.
        chunks: of all parts, in their order.
        channels: by number.
    """

    def __init__(self, path: Path, names: Mapping[str, str] = MappingProxyType({})) -> None:
        """Open a recording.

        Args:
            path: the first part, or one later part.
            names: as in `Chunks`.

        Raises:
            OSError: a file cannot be read.
            NotPlayable: it is not an MCAP file, or a part is missing.
        """
        self.path, self._names = path, names
        self.chunks: list[Chunk] = []
        self.channels: dict[int, Channel] = {}
        self._parts: list[_Part] = []
        self._number_of: dict[_Key, int] = {}
        self._add(path)
        self._reading = self._parts[0]
        self.metadata = self._parts[0].file.metadata
        head = self.metadata.get(METADATA, {})
        self._run = head.get(RUN, "") if PART in head and part_of(head) == FIRST_PART else ""
        try:
            self._add_later()
        except BaseException:
            self.close()
            raise

    def _add_later(self) -> bool:
        """Open the parts that are not open yet; return whether there are any."""
        before = len(self._parts)
        try:
            for path in parts_of(self.path)[before:] if self._run else ():
                self._add(path)
        except NotReplayable as error:
            raise NotPlayable(str(error)) from error
        return len(self._parts) > before

    def _add(self, path: Path) -> None:
        file = Chunks(path, self._names)
        if self._parts:
            self._parts[-1].file.close()
        self._parts.append(_Part(file, len(self.chunks)))
        self._take_in()

    def _take_in(self) -> None:
        """Add the new channels and chunks of the last part."""
        last = self._parts[-1]
        self._learn(last)
        self.chunks += last.file.chunks[len(self.chunks) - last.start :]

    def _learn(self, part: _Part) -> None:
        """Give numbers to new channels of a part."""
        if len(part.numbers) == len(part.file.channels):
            return
        for own, channel in part.file.channels.items():
            if own not in part.numbers:
                key = (channel, part.seen[channel])
                part.seen[channel] += 1
                free = own if own not in self.channels else max(self.channels) + 1
                number = self._number_of.setdefault(key, free)
                part.numbers[own], part.own[number] = number, own
                part.is_as_written &= number == own
                self.channels.setdefault(number, channel)

    @property
    def has_index(self) -> bool:
        """Return whether each part has an index."""
        return all(part.file.has_index for part in self._parts)

    @property
    def is_finished(self) -> bool:
        """Return whether the recording does not grow any more."""
        return self._parts[-1].file.is_finished and not self._is_next_there()

    @property
    def is_replaced(self) -> bool:
        """Return whether the last part was replaced, as `Chunks.is_replaced`."""
        return self._parts[-1].file.is_replaced

    def close(self) -> None:
        """Close all files."""
        for part in self._parts:
            part.file.close()

    def messages(self, chunk: int) -> list[McapMessage]:
        """Return the messages of a chunk, as `Chunks.messages`."""
        part = self._parts[bisect_right(self._parts, chunk, key=lambda part: part.start) - 1]
        if part is not self._reading:
            if self._reading is not self._parts[-1]:  # the last part stays open, because it may grow
                self._reading.file.close()
            self._reading = part
        found = part.file.messages(chunk - part.start)
        self._learn(part)
        if part.is_as_written:
            return found
        return [McapMessage(part.numbers.get(own, -1), t_ns, data) for own, t_ns, data in found]

    def last_with(self, channel: int, before: int) -> int:
        """Return the last chunk before this one that contains messages of a channel, as `Chunks.last_with`."""
        for part in reversed(self._parts):
            own = part.own.get(channel)
            found = -1 if own is None or part.start >= before else part.file.last_with(own, before - part.start)
            if found >= 0:
                return found + part.start
        return -1

    def holding(self, channel: int) -> list[int]:
        """Return all chunks that contain messages of a channel, as `Chunks.holding`."""
        parts = (part for part in self._parts if channel in part.own)
        return [int(chunk) + part.start for part in parts for chunk in part.file.holding(part.own[channel])]

    def refresh(self) -> bool:
        """Look for new chunks, as `Chunks.refresh`, also in the next part if it exists."""
        before = len(self.chunks)
        self._parts[-1].file.refresh()
        self._take_in()
        while self._parts[-1].file.is_finished and self._add_later():
            pass
        return len(self.chunks) > before

    def _is_next_there(self) -> bool:
        """Return whether there is a next part, or a file that may become it because its head is not written yet."""
        if not self._run:
            return False
        try:
            return head_record(part_path(self.path, len(self._parts) + FIRST_PART)).get(RUN) == self._run
        except NotReplayable:
            return True
        except OSError:
            return False
