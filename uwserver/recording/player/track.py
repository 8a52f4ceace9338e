"""A recording in the form that can be played: runs between jumps of time, scenes, and messages in the order of time.

Samples and events were written when the loop had them. States and lists of bodies reach the file sooner, and may come before samples of the same
time; so they wait here until their time has come. Each run between two jumps has its own span of time, and within a run time never goes back.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final, TypeVar

import msgspec

from uwserver.ports import EntityList, Port, Sample, SceneState, Service
from uwserver.recording.format import EVENTS, METADATA
from uwserver.recording.parts import begins_with_state
from uwserver.recording.player.chunks import McapMessage, NotPlayable, PartChunks, renamed
from uwserver.recording.player.head import played_head
from uwserver.recording.player.messages import ChannelReader, Item, Mark, Place, Run, Scene
from uwserver.recording.states import ENTITY_LISTS, JUMPS, STATES, EntityListRecord, read_state, time_of_state

T = TypeVar("T", Port, Service)

MOST_MARKS: Final = 2000
"""Largest number of events that are shown as marks on the time line."""
MOST_LOOKED_AT: Final = 300
"""Largest number of chunks that are decompressed to find marks, and again to find jumps."""
_MOST_WAITING: Final = 100_000
_MOST_EARLY: Final = 50
"""Largest number of chunks by which states may come before samples of the same time."""


class Track:
    """A recording that is played. Only one thread may use it at a time.

    Attributes:
        path: the file.
        head: the head of the recording.
        runs: all runs, at least one.
        scenes: all scenes in the order of the file, at least one.
        remarks: what a user should know about the file, one sentence each.
        run: number of the current run.
        head_item: the next item; None if there is none so far.
        messages: converts messages.
        state: the last poses of the bodies; None before the first.
    """

    def __init__(self, path: Path, names: Mapping[str, str] = MappingProxyType({})) -> None:
        """Open a recording.

        Args:
            path: path of the recording.
            names: maps names of bodies to the names that they get here.

        Raises:
            OSError: the file cannot be read.
            NotPlayable: the file cannot be played, or a name is unknown or taken.
        """
        self._chunks, self._names = PartChunks(path, names), names
        try:
            self.path = path
            self.head, self.remarks = played_head(self._chunks)
            self.runs: list[Run] = []
            self.scenes: list[Scene] = []
            self._entity_lists: dict[int, EntityList] = {}
            self._sensors: set[str] = set()
            # In a later part that is played alone, the first run has number 0, whatever came before.
            self._is_later = begins_with_state(self._chunks.metadata[METADATA])
            self._jumps_before = 0
            self._seen_chunks = 0
            self._jump_places: list[tuple[Place, int]] = []
            self.messages = ChannelReader(self._chunks.channels)
            self._follow()
            if not self.scenes:
                raise NotPlayable(f"{path}: the recording ends before its first tick: there is nothing to play")
            self._check_names()
            if not self._chunks.has_index:
                end = "but an end" if self._chunks.is_finished else "and no end yet, or it was cut off"
                self.remarks += (f"the file has no index {end}: it was read once, and it is followed while it grows",)
        except BaseException:
            self._chunks.close()
            raise
        self.state: SceneState | None = None
        self.head_item: Item | None = None
        self._newest: dict[int, McapMessage] = {}
        self.run = 0
        self.seek(0, self.runs[0].from_ns - 1)

    def _check_names(self) -> None:
        there = {body.name for scene in self.scenes for body in scene.bodies}
        for old, new in self._names.items():
            if new not in there:
                known = ", ".join(sorted(there - set(self._names.values())))
                raise NotPlayable(f'{self.path}: no body has the name "{old}"; there are: {known}')
        if any(len({body.name for body in scene.bodies}) < len(scene.bodies) for scene in self.scenes):
            raise NotPlayable(f"{self.path}: two bodies would have the same name: map one to a name that is free")

    def close(self) -> None:
        """Close the file."""
        self._chunks.close()

    @property
    def is_growing(self) -> bool:
        """Return whether the recording may still grow."""
        return not self._chunks.is_finished

    @property
    def is_replaced(self) -> bool:
        """Return whether the path names another file by now."""
        return self._chunks.is_replaced

    # -- what the file holds --------------------------------------------------------------------------------------------------------

    def refresh(self) -> bool:
        """Look for new messages; return whether there are any. Raises NotPlayable."""
        more = self._chunks.refresh()
        if more:
            self._follow()
            if self.head_item is None:
                self.head_item = next(self._stream)
        return more

    def _follow(self) -> None:
        """Add the scenes and the jumps of time of the new chunks."""
        first = self._seen_chunks
        self._seen_chunks = len(self._chunks.chunks)
        for chunk in self._holding(ENTITY_LISTS, first):
            for _, message in self._of_topic(ENTITY_LISTS, chunk):
                self._add_scene(message)
        with_jumps = self._holding(JUMPS, first)
        if len(with_jumps) > MOST_LOOKED_AT:
            self.remarks += (
                f"time was set in {len(with_jumps)} places: only the first {MOST_LOOKED_AT} can be sought",
            )
        for chunk in with_jumps[:MOST_LOOKED_AT]:
            self._jump_places += [(Place(chunk, k + 1), m.t_ns) for k, m in self._of_topic(JUMPS, chunk)]
        self._find_runs()

    def _holding(self, topic: str, first: int = 0) -> list[int]:
        """Return the chunks from `first` on that contain messages of a topic, in their order."""
        chunks = {chunk for channel in self._numbers(topic) for chunk in self._chunks.holding(channel)}
        return sorted(chunk for chunk in chunks if chunk >= first)

    def _of_topic(self, topic: str, chunk: int) -> Iterator[tuple[int, McapMessage]]:
        """Yield the messages of a topic in a chunk, with their indices."""
        for k, message in enumerate(self._chunks.messages(chunk)):
            if self.messages.topic(message) == topic:
                yield k, message

    def _find_runs(self) -> None:
        chunks = self._chunks.chunks
        starts = [(Place(0, 0), min((chunk.start_ns for chunk in chunks[:1]), default=0)), *self._jump_places]
        self.runs = []
        for (place, from_ns), after in zip(starts, [*starts[1:], None], strict=True):
            if after is not None:
                to_ns = self._end_before(place, from_ns, after[0])
            elif place.chunk + 1 < len(chunks):
                to_ns = chunks[-1].end_ns
            else:  # the chunk with a jump also contains messages from before it
                to_ns = self._end_before(place, from_ns, Place(len(chunks), 0))
            self.runs.append(Run(place, from_ns, max(from_ns, to_ns)))

    def _end_before(self, first: Place, from_ns: int, end: Place) -> int:
        """Return the last time of a run before the next begins, from its samples in the chunk of that begin or in the chunk before."""
        for chunk in (end.chunk, end.chunk - 1):
            if chunk < first.chunk:
                break
            if chunk >= len(self._chunks.chunks):
                continue
            messages = self._chunks.messages(chunk)[: end.message if chunk == end.chunk else None]
            begin = first.message if chunk == first.chunk else 0
            times = [m.t_ns for m in messages[begin:] if self.messages.topic(m) in self._sensors]
            if times:
                return max(from_ns, times[-1])
        return from_ns

    def _numbers(self, topic: str) -> list[int]:
        return [number for number, channel in self._chunks.channels.items() if channel.topic == topic]

    def _add_scene(self, message: McapMessage) -> None:
        try:
            record = msgspec.json.decode(message.data, type=EntityListRecord)
            if self._names:
                record = record.renamed(lambda path: renamed(path, self._names))
            before = self.scenes[-1] if self.scenes else None
            ports: Mapping[str, Port] = _updated(before.ports if before else {}, record.ports, record.ports_gone)
            new_services = [service.service for service in record.services]
            services = _updated(before.services if before else {}, new_services, record.services_gone)
            water = record.water or (before.water if before else None)
            if not water:
                return
        except (msgspec.MsgspecError, ValueError):
            self.messages.damaged += 1
            return
        if before is None and self._is_later:
            self._jumps_before = record.jumps
        self._sensors |= {port.path for port in record.ports if port.direction == "sensor"}
        there = (record.entities, ports, services, water)
        if before is not None and there == (before.entities, before.ports, before.services, before.water):
            return  # a part repeats the last scene of the part before
        if before is not None and not (record.ports or record.ports_gone):
            ports = before.ports  # the same object, by which the player sees that no port changed
        bodies = (*record.vehicles, *record.objects)
        self._entity_lists[record.revision] = record.entities
        jumps = record.jumps - self._jumps_before
        self.scenes.append(Scene(jumps, record.t_ns, record.entities, bodies, ports, services, water))

    def _time_of(self, state: McapMessage) -> tuple[int, int]:
        """Return run and time (ns) of a state."""
        jumps, t_ns = time_of_state(state.data)
        return jumps - self._jumps_before, t_ns

    def scene_at(self, t_ns: int) -> Scene:
        """Return the scene at a time of the current run."""
        place = bisect_right(self.scenes, (self.run, t_ns), key=lambda scene: (scene.jumps, scene.t_ns))
        return self.scenes[max(0, place - 1)]

    def marks(self) -> list[Mark]:
        """Return the first `MOST_MARKS` events of the file."""
        found: list[Mark] = []
        starts = [run.first for run in self.runs]
        for chunk in self._holding(EVENTS)[:MOST_LOOKED_AT]:
            for k, message in self._of_topic(EVENTS, chunk):
                event = self.messages.event(message)
                if event is not None:
                    run = bisect_right(starts, Place(chunk, k + 2)) - 1  # a jump comes right after its event
                    found.append(Mark(max(0, run), event))
        return found[:MOST_MARKS]

    # -- playing --------------------------------------------------------------------------------------------------------------------

    def seek(self, run: int, t_ns: int) -> list[McapMessage]:
        """Go to a time of a run; later messages come next. Return the last message of each sensor until then. Raises NotPlayable."""
        self.run = run
        chunks, first, end = self._chunks.chunks, self.runs[run].first, self._end_of(run)
        begin = first.chunk
        if run and begin + 1 < min(end.chunk, len(chunks)) and chunks[begin + 1].start_ns <= t_ns:
            begin += 1  # the chunk with a jump also contains messages from before it, so its last time says nothing
        while begin < end.chunk and chunks[begin].end_ns <= t_ns:
            begin += 1
        self._newest = self._latest(run, t_ns, begin)
        place = Place(begin, 0) if begin > first.chunk else first
        self._stream = self._items(place, run, t_ns, self._early(place, run, t_ns))
        self.head_item = next(self._stream)
        return self.last()

    def _end_of(self, run: int) -> Place:
        return self.runs[run + 1].first if run + 1 < len(self.runs) else Place(len(self._chunks.chunks), 0)

    def _latest(self, run: int, t_ns: int, begin: int) -> dict[int, McapMessage]:
        """Return the last message of each sensor channel until a time, and set `state`.

        It goes backwards through the chunks that contain a channel whose message is not found yet.
        """
        chunks, first, end = self._chunks.chunks, self.runs[run].first, self._end_of(run)
        upper = min(begin, len(chunks) - 1)
        while upper + 1 < min(end.chunk + 1, len(chunks)) and chunks[upper + 1].start_ns <= t_ns:
            upper += 1
        ports = self.scene_at(t_ns).ports
        states = set(self._numbers(STATES))
        sensors = {
            n for n, c in self._chunks.channels.items() if c.topic in ports and ports[c.topic].direction == "sensor"
        }
        before = dict.fromkeys(sensors | states, upper + 1)
        found: dict[int, McapMessage] = {}
        while before:
            before = {channel: self._chunks.last_with(channel, chunk) for channel, chunk in before.items()}
            # The states of a run may come before the jump with which it begins.
            before = {channel: chunk for channel, chunk in before.items() if chunk >= first.chunk or channel in states}
            chunk = max(before.values(), default=-1)
            if chunk < 0:
                break
            high = end.message if chunk == end.chunk else None
            for k, message in reversed(list(enumerate(self._chunks.messages(chunk)[:high]))):
                if before.get(message.channel) != chunk or message.t_ns > t_ns:
                    continue
                if message.channel in states:
                    jumps = self._time_of(message)[0]
                    if jumps > run:
                        continue
                    if jumps == run:
                        found[message.channel] = message
                elif (chunk, k) >= first:
                    found[message.channel] = message
                del before[message.channel]
        self.state = None
        for channel in states & found.keys():
            self.show(found.pop(channel))
        return found

    def _early(self, place: Place, run: int, after_ns: int) -> deque[tuple[int, McapMessage]]:
        """Return the states after a time that come before a place in the file, with their runs."""
        found: deque[tuple[int, McapMessage]] = deque()
        states = self._numbers(STATES)
        for chunk in range(place.chunk, max(-1, place.chunk - _MOST_EARLY), -1):
            messages = self._chunks.messages(chunk) if chunk < len(self._chunks.chunks) else []
            for message in reversed(messages[: place.message if chunk == place.chunk else None]):
                if message.channel in states:
                    jumps, t_ns = self._time_of(message)
                    if (jumps, t_ns) <= (run, after_ns):
                        return found
                    found.appendleft((jumps, message))
        return found

    def _items(
        self, place: Place, run: int, after_ns: int, waiting: deque[tuple[int, McapMessage]]
    ) -> Iterator[Item | None]:
        """Yield the items after a time in the order of time; None while the file contains nothing more. `waiting` are the states of `_early`."""
        now = after_ns
        chunk, k = place
        while True:
            if chunk >= len(self._chunks.chunks):
                while waiting:
                    jumps, message = waiting.popleft()
                    if jumps == run:
                        now = max(now, message.t_ns)
                        yield Item(now, "state", message)
                yield None
                continue
            messages = self._chunks.messages(chunk)
            for message in messages[k:]:
                topic = self.messages.topic(message)
                if topic == STATES:
                    jumps, t_ns = self._time_of(message)
                    if (jumps, t_ns) > (run, after_ns) and len(waiting) < _MOST_WAITING:
                        waiting.append((jumps, message))
                    continue
                if topic == JUMPS:
                    run, now, after_ns = run + 1, message.t_ns, message.t_ns - 1
                    yield Item(now, "jump", message)
                    continue
                # Commands, and messages for other tools, did not wait for the loop, so their times do not show how far the samples are.
                if message.t_ns <= after_ns or not (topic == EVENTS or topic in self._sensors):
                    continue
                while waiting and (
                    waiting[0][0] < run or (waiting[0][0] == run and waiting[0][1].t_ns <= message.t_ns)
                ):
                    jumps, state = waiting.popleft()
                    if jumps == run:
                        now = max(now, state.t_ns)
                        yield Item(now, "state", state)
                now = max(now, message.t_ns)
                yield Item(now, "event" if topic == EVENTS else "sample", message)
            chunk, k = chunk + 1, 0

    def pop(self) -> Item:
        """Take the next item. Raises NotPlayable."""
        item = self.head_item
        assert item is not None
        self.head_item = next(self._stream)
        if item.type == "state":
            self.show(item.message)
        elif item.type == "sample":
            self._newest[item.message.channel] = item.message
        elif item.type == "jump":
            self.run = min(self.run + 1, len(self.runs) - 1)
            self._newest, self.state = {}, None
        return item

    def show(self, message: McapMessage) -> None:
        """Set the poses of the bodies from a message."""
        try:
            self.state = read_state(message.data, self._entity_lists).state
        except ValueError:
            self.messages.damaged += 1

    def last(self) -> list[McapMessage]:
        """Return the last message of each sensor, in the order of time."""
        return sorted(self._newest.values(), key=lambda message: message.t_ns)

    def newest(self, path: str, ports: Mapping[str, Port]) -> Sample | None:
        """Return the last sample of a port; None if there is none so far."""
        found = [message for message in self.last() if self.messages.topic(message) == path]
        return self.messages.sample(found[-1], ports) if found else None


def _updated(before: Mapping[str, T], new: Iterable[T], gone: Iterable[str]) -> dict[str, T]:
    """Return ports or services by path, with new ones added and some paths removed."""
    found = {**before, **{entry.path: entry for entry in new}}
    for path in gone:
        found.pop(path, None)
    return found
