"""A recording as something that can be played: runs between jumps of time, who was there when, and its messages in the order of time.

A message of a sensor or an event was written when the loop had it; states and casts take a shorter way and may stand before samples of the same
time. So those wait here until time has come to them. Each run between two jumps has its own span of time; within one, time never goes back.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

import msgspec

from uwserver.ports import Cast, Port, Sample, SceneState
from uwserver.recording.format import EVENTS, METADATA
from uwserver.recording.parts import begins_with_state
from uwserver.recording.player_file import Message, NotPlayable, renamed
from uwserver.recording.player_head import played_head
from uwserver.recording.player_items import Item, Mark, Place, Run, Scene
from uwserver.recording.player_messages import Messages
from uwserver.recording.player_parts import PartChunks
from uwserver.recording.states import CASTS, JUMPS, STATES, CastRecord, read_state, time_of_state

MOST_MARKS: Final = 2000
"""Events of a file that are told as marks on its line of time."""
MOST_LOOKED_AT: Final = 300
"""Chunks that are unpacked for each, marks and jumps, when a file is opened."""
_MOST_WAITING: Final = 100_000
_MOST_EARLY: Final = 50
"""Chunks by which states are sought before samples of the same time."""


class Track:
    """A recording that is played. Used by one thread at a time.

    Attributes:
        path: of the file.
        head: of the recording.
        runs: at least one.
        scenes: who is there, in the order of the file; at least one.
        remarks: what to know of the file, as sentences.
        run: that is played.
        head_item: what comes next; None for nothing, as yet.
        messages: reads them.
        state: where the bodies were last.
    """

    def __init__(self, path: Path, names: Mapping[str, str] = MappingProxyType({})) -> None:
        """Of a file.

        Args:
            path: of a recording.
            names: of bodies -> what they are called here.

        Raises:
            OSError: it cannot be read.
            NotPlayable: see there; or the names are of nobody, or taken.
        """
        self._chunks, self._names = PartChunks(path, names), names
        try:
            self.path = path
            self.head, self.remarks = played_head(self._chunks)
            self.runs: list[Run] = []
            self.scenes: list[Scene] = []
            self._casts: dict[int, Cast] = {}
            self._sensors: set[str] = set()
            # A later part alone begins with its own run 0, whatever was before it.
            self._is_later = begins_with_state(self._chunks.metadata[METADATA])
            self._jumps_before = 0
            self._seen_chunks = 0
            self._jump_places: list[tuple[Place, int]] = []
            self.messages = Messages(self._chunks.channels)
            self._follow()
            if not self.scenes:
                raise NotPlayable(f"{path}: the recording ends before its first tick: there is nothing to play")
            self._check_names()
            if not self._chunks.has_index:
                end = "its end" if self._chunks.is_finished else "no end yet, or was cut off"
                self.remarks += (
                    f"the file has no index ({end}): it was walked through once; what it still gets is followed",
                )
        except BaseException:
            self._chunks.close()
            raise
        self.state: SceneState | None = None
        self.head_item: Item | None = None
        self._newest: dict[int, Message] = {}
        self.run = 0
        self.seek(0, self.runs[0].from_ns - 1)

    def _check_names(self) -> None:
        there = {body.name for scene in self.scenes for body in scene.bodies}
        for old, new in self._names.items():
            if new not in there:
                known = ", ".join(sorted(there - set(self._names.values())))
                raise NotPlayable(f'{self.path}: nobody is called "{old}"; there are: {known}')
        if any(len({body.name for body in scene.bodies}) < len(scene.bodies) for scene in self.scenes):
            raise NotPlayable(f"{self.path}: two bodies would have the same name: map one to a name that nobody has")

    def close(self) -> None:
        """Close the file."""
        self._chunks.close()

    @property
    def is_growing(self) -> bool:
        """Whether more may come."""
        return not self._chunks.is_finished

    @property
    def is_replaced(self) -> bool:
        """Whether another file stands under its name by now."""
        return self._chunks.is_replaced

    # -- what the file holds --------------------------------------------------------------------------------------------------------

    def refresh(self) -> bool:
        """Look for more; returns whether there is. May raise NotPlayable."""
        more = self._chunks.refresh()
        if more:
            self._follow()
            if self.head_item is None:
                self.head_item = next(self._stream)
        return more

    def _follow(self) -> None:
        """Take in who came and went, and where time was set, in the chunks that are new."""
        first = self._seen_chunks
        self._seen_chunks = len(self._chunks.chunks)
        for channel in self._numbers(CASTS):
            for message in self._all(channel, first):
                self._add_scene(message)
        jumps = self._numbers(JUMPS)
        looked_at = {chunk for channel in jumps for chunk in self._chunks.holding(channel) if chunk >= first}
        if len(looked_at) > MOST_LOOKED_AT:
            self.remarks += (f"time was set in {len(looked_at)} places: only the first {MOST_LOOKED_AT} can be sought",)
        for chunk in sorted(looked_at)[:MOST_LOOKED_AT]:
            for k, message in enumerate(self._chunks.messages(chunk)):
                if message.channel in jumps:
                    self._jump_places.append((Place(chunk, k + 1), message.t_ns))
        self._find_runs()

    def _find_runs(self) -> None:
        chunks = self._chunks.chunks
        starts = [(Place(0, 0), min((chunk.start_ns for chunk in chunks[:1]), default=0)), *self._jump_places]
        self.runs = []
        for (place, from_ns), after in zip(starts, [*starts[1:], None], strict=True):
            if after is not None:
                to_ns = self._end_before(place, from_ns, after[0])
            elif place.chunk + 1 < len(chunks):
                to_ns = chunks[-1].end_ns
            else:  # the chunk of a jump holds what was before it, too
                to_ns = self._end_before(place, from_ns, Place(len(chunks), 0))
            self.runs.append(Run(place, from_ns, max(from_ns, to_ns)))

    def _end_before(self, first: Place, from_ns: int, end: Place) -> int:
        """Last time of what the loop had of a run before the next begins; in the chunk of that, or else in the one before."""
        for chunk in (end.chunk, end.chunk - 1):
            if chunk < first.chunk:
                break
            if chunk >= len(self._chunks.chunks):
                continue
            messages = self._chunks.messages(chunk)[: end.message if chunk == end.chunk else None]
            begin = first.message if chunk == first.chunk else 0
            times = [m.t_ns for m in messages[begin:] if self._is_timed(m)]
            if times:
                return max(from_ns, times[-1])
        return from_ns

    def _is_timed(self, message: Message) -> bool:
        channel = self._chunks.channels.get(message.channel)
        return channel is not None and channel.topic in self._sensors

    def _numbers(self, topic: str) -> list[int]:
        return [number for number, channel in self._chunks.channels.items() if channel.topic == topic]

    def _all(self, channel: int, first: int) -> Iterator[Message]:
        for chunk in self._chunks.holding(channel):
            if chunk >= first:
                yield from (m for m in self._chunks.messages(int(chunk)) if m.channel == channel)

    def _add_scene(self, message: Message) -> None:
        try:
            record = msgspec.json.decode(message.data, type=CastRecord)
            if self._names:
                record = record.renamed(lambda path: renamed(path, self._names))
            before = self.scenes[-1] if self.scenes else None
            ports = dict(before.ports) if before else {}
            ports |= {port.path: port for port in record.ports}
            services = dict(before.services) if before else {}
            services |= {service.path: service.service for service in record.services}
            for path in record.ports_gone:
                ports.pop(path, None)
            for path in record.services_gone:
                services.pop(path, None)
            water = record.water or (before.water if before else None)
            if not water:
                return
        except (msgspec.MsgspecError, ValueError):
            self.messages.damaged += 1
            return
        if before is None and self._is_later:
            self._jumps_before = record.jumps
        self._sensors |= {port.path for port in record.ports if port.direction == "sensor"}
        there = (record.cast, ports, services, water)
        if before is not None and there == (before.cast, before.ports, before.services, before.water):
            return  # a part tells again who was there in the one before
        is_same = before is not None and not (record.ports or record.ports_gone)
        kept = before.ports if before is not None and is_same else ports
        bodies = (*record.vehicles, *record.objects)
        self._casts[record.revision] = record.cast
        jumps = record.jumps - self._jumps_before
        self.scenes.append(Scene(jumps, record.t_ns, record.cast, bodies, kept, services, water))

    def _time_of(self, state: Message) -> tuple[int, int]:
        """Run and time of a state."""
        jumps, t_ns = time_of_state(state.data)
        return jumps - self._jumps_before, t_ns

    def scene_at(self, t_ns: int) -> Scene:
        """Who is there at a time of the run that is played."""
        place = bisect_right(self.scenes, (self.run, t_ns), key=lambda scene: (scene.jumps, scene.t_ns))
        return self.scenes[max(0, place - 1)]

    def marks(self) -> list[Mark]:
        """Events of the file, the first `MOST_MARKS`."""
        found: list[Mark] = []
        starts = [run.first for run in self.runs]
        for channel in self._numbers(EVENTS):
            for chunk in self._chunks.holding(channel)[:MOST_LOOKED_AT]:
                for k, message in enumerate(self._chunks.messages(int(chunk))):
                    event = self.messages.event(message) if message.channel == channel else None
                    if event is not None and len(found) < MOST_MARKS:
                        run = bisect_right(starts, Place(int(chunk), k + 2)) - 1  # a jump stands behind its event
                        found.append(Mark(max(0, run), event))
        return found

    # -- playing --------------------------------------------------------------------------------------------------------------------

    def seek(self, run: int, t_ns: int) -> list[Message]:
        """Go to a time of a run: what comes next is later. Returns the last message of each sensor until then. May raise NotPlayable."""
        self.run = run
        chunks, first, end = self._chunks.chunks, self.runs[run].first, self._end_of(run)
        begin = first.chunk
        if run and begin + 1 < min(end.chunk, len(chunks)) and chunks[begin + 1].start_ns <= t_ns:
            begin += 1  # the chunk of a jump holds what was before it, too: its end tells nothing
        while begin < end.chunk and chunks[begin].end_ns <= t_ns:
            begin += 1
        self._newest = self._latest(run, t_ns, begin)
        place = Place(begin, 0) if begin > first.chunk else first
        self._stream = self._items(place, run, t_ns, self._early(place, run, t_ns))
        self.head_item = next(self._stream)
        return self.last()

    def _end_of(self, run: int) -> Place:
        return self.runs[run + 1].first if run + 1 < len(self.runs) else Place(len(self._chunks.chunks), 0)

    def _latest(self, run: int, t_ns: int, begin: int) -> dict[int, Message]:
        """The last message of each channel of sensors until a time, and the state there."""
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
        found: dict[int, Message] = {}
        while before:
            before = {channel: self._chunks.last_with(channel, chunk) for channel, chunk in before.items()}
            # States of a run may stand before the jump with which it begins.
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

    def _early(self, place: Place, run: int, after_ns: int) -> deque[tuple[int, Message]]:
        """States after a time that stand before a place, with their runs."""
        found: deque[tuple[int, Message]] = deque()
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
        self, place: Place, run: int, after_ns: int, waiting: deque[tuple[int, Message]]
    ) -> Iterator[Item | None]:
        """What comes after a time, in the order of time; None while there is nothing more in the file. `waiting`: states as of `_early`."""
        now, topics = after_ns, self._chunks.channels
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
                channel = topics.get(message.channel)
                topic = "" if channel is None else channel.topic
                if topic == STATES:
                    jumps, t_ns = self._time_of(message)
                    if (jumps, t_ns) > (run, after_ns) and len(waiting) < _MOST_WAITING:
                        waiting.append((jumps, message))
                    continue
                if topic == JUMPS:
                    run, now, after_ns = run + 1, message.t_ns, message.t_ns - 1
                    yield Item(now, "jump", message)
                    continue
                # Commands, and what is there for other tools, have not waited for the loop: their times say nothing of the samples.
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
        """What comes next, which is taken. May raise NotPlayable."""
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

    def show(self, message: Message) -> None:
        """From now on bodies are where a message says."""
        try:
            self.state = read_state(message.data, self._casts).state
        except ValueError:
            self.messages.damaged += 1

    def last(self) -> list[Message]:
        """The last message of each sensor, in the order of time."""
        return sorted(self._newest.values(), key=lambda message: message.t_ns)

    def newest(self, path: str, ports: Mapping[str, Port]) -> Sample | None:
        """The last sample of a port."""
        found = [m for n, m in self._newest.items() if self._chunks.channels[n].topic == path]
        latest = max(found, key=lambda message: message.t_ns, default=None)
        return None if latest is None else self.messages.sample(latest, ports)
