"""Compares two recordings: the differences of each field of each port, and the time at which the states first differ.

Both are streamed, so that their length does not matter.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from mcap.records import Channel, Message, Schema
from msgspec import Struct

from uwserver.logfiles import Limits
from uwserver.logfiles.readers.mcap_records import Records
from uwserver.ports import Event
from uwserver.recording.channels import Described, described
from uwserver.recording.differences import Pairing, Timed
from uwserver.recording.format import EVENTS, HASHES, StateHash
from uwserver.recording.reading import MOST_RECORD_BYTES, NotReplayable, Reading
from uwserver.scenario.files.documents import opened

PAIR_EVERY = 512
"""Number of messages between two rounds of pairing."""

PortFilter = Callable[[str], bool]


class _Sample(Struct):
    """A message on the channel of a sensor."""

    t_ns: int
    valid: bool
    value: dict[str, Any]


class _Command(Struct):
    """A message on the channel of an actuator."""

    value: dict[str, Any]


@dataclass(frozen=True)
class States:
    """The comparison of the state hashes.

    Attributes:
        equal: number of equal hashes at equal times.
        last_equal_ns: time of the last equal hash before the first that differs; None for none.
        first_ns: time of the first hash that differs; None for none.
    """

    equal: int = 0
    last_equal_ns: int | None = None
    first_ns: int | None = None


@dataclass(frozen=True)
class Compared:
    """The result of a comparison.

    Attributes:
        ports: differences of the common ports, by path.
        only: for each side, ports that only it has, or that have other fields there.
        states: comparison of the state hashes, once per simulated second.
        first: port, field and time (ns) of the first two samples of one time that differ; None for none.
        remarks: what was left out, and why.
    """

    ports: Mapping[str, Pairing]
    only: tuple[tuple[str, ...], tuple[str, ...]]
    states: States
    first: tuple[str, str, int] | None
    remarks: tuple[str, ...]

    @property
    def is_same(self) -> bool:
        """Return whether nothing differs: ports, numbers of samples, values, states."""
        return (
            not any(self.only)
            and self.states.first_ns is None
            and all(pair.samples[0] == pair.samples[1] and not pair.alone and not pair.pairs[1] for pair in self.ports.values())
            and all(each.is_same for pair in self.ports.values() for each in (pair.valid, *pair.fields.values()))
        )  # fmt: skip


def compare(
    a: Path, b: Path, wanted: PortFilter = lambda _: True, begin_ns: int = 0, end_ns: int | None = None
) -> Compared:
    """Compare two recordings.

    Args:
        a, b: the files; the first part stands for all parts.
        wanted: selects the ports that are compared.
        begin_ns, end_ns: first and last simulation time; None for the end.

    Raises:
        OSError: a file cannot be read.
        NotReplayable: a file is not a recording, or is damaged.
    """
    known = [_surveyed(path, wanted) for path in (a, b)]
    both = [port for port, found in known[0].items() if port in known[1] and found[0] == known[1][port][0]]
    only = tuple(tuple(port for port in known[side] if port not in both) for side in (0, 1))
    pairings = {port: _pairing(*(each[port] for each in known)) for port in both}
    with ExitStack() as stack:
        readings = [stack.enter_context(Reading(path)) for path in (a, b)]
        end = math.inf if end_ns is None else end_ns
        merged = _Merged(pairings, [_Side(reading, set(both)) for reading in readings], begin_ns, end)
        merged.run()
        remarks = [*merged.remarks]
        for path, reading in zip((a, b), readings, strict=True):
            if reading.truncated:
                remarks.append(f"{path} has no end: it is compared as far as it goes")
    disordered = sum(pair.disordered for pair in pairings.values())
    if disordered:
        remarks.append(f"{disordered} samples are left out, because they come after later ones")
    return Compared(pairings, (only[0], only[1]), merged.states, _first(pairings), tuple(remarks))


def _pairing(one: tuple[Described, int], other: tuple[Described, int]) -> Pairing:
    return Pairing(one[0].columns, one[0].direction == "actuator", asks=0 if one[1] <= other[1] else 1)


def _first(pairings: Mapping[str, Pairing]) -> tuple[str, str, int] | None:
    found = [
        (each.first_ns, port, each.column.name)
        for port, pair in pairings.items()
        for each in (*pair.fields.values(), pair.valid)
        if each.first_ns is not None
    ]
    if not found:
        return None
    t_ns, port, field = min(found)
    return port, field, t_ns


def _surveyed(path: Path, wanted: PortFilter) -> dict[str, tuple[Described, int]]:
    """Return the ports with samples, and the numbers of samples, from the index of each file; a file without index is read."""
    ports: dict[str, Described] = {}
    counts: Counter[str] = Counter()
    with Reading(path) as reading:
        paths = reading.paths
    for part in paths:
        with opened(part) as file:
            summary = Records(part, file, Limits(record_bytes=MOST_RECORD_BYTES)).summary()
        if summary is None or summary.statistics is None:
            with Reading(part) as reading:
                side = _Side(reading, None)
                counts.update(topic for topic, _ in side.messages())
                ports |= side.ports
            continue
        for number, channel in summary.channels.items():
            about = described(channel.topic, channel.metadata, summary.schemas[channel.schema_id].data)
            if about is not None:
                ports[channel.topic] = about
                counts[channel.topic] += summary.statistics.channel_message_counts.get(number, 0)
    return {port: (about, counts[port]) for port, about in ports.items() if counts[port] and wanted(port)}


class _Side:
    """One recording, message by message.

    Attributes:
        ports: the ports whose channels were read, by path.
    """

    def __init__(self, reading: Reading, wanted: set[str] | None) -> None:
        self.ports: dict[str, Described] = {}
        self._reading, self._wanted = reading, wanted

    def messages(self) -> Iterator[tuple[str, Any]]:
        """Yield topic and message of the wanted ports, of hashes and of events."""
        schemas: dict[int, bytes] = {}
        topics: dict[int, str] = {}
        for record in self._reading.records():
            if isinstance(record, Message):
                topic = topics.get(record.channel_id)
                if topic is not None:
                    yield topic, record
            elif isinstance(record, Schema):
                schemas[record.id] = record.data
            elif isinstance(record, Channel):
                topics.pop(record.id, None)
                if record.topic in (HASHES, EVENTS):
                    topics[record.id] = record.topic
                elif self._wanted is None or record.topic in self._wanted:
                    about = described(record.topic, record.metadata, schemas.get(record.schema_id, b""))
                    # The path may be used again for a port with other fields; its samples cannot be compared.
                    if about is not None and self.ports.setdefault(record.topic, about) == about:
                        topics[record.id] = record.topic


class _Merged:
    """Reads both recordings in step: always the one that is behind in simulation time.

    Attributes:
        states: comparison of the hashes so far.
        remarks: what was left out.
    """

    def __init__(self, pairings: Mapping[str, Pairing], sides: list[_Side], begin_ns: int, end_ns: float) -> None:
        self._pairings, self._sides, self._begin, self._end = pairings, sides, begin_ns, end_ns
        self._reached: list[float] = [-math.inf, -math.inf]
        self._sample, self._command = msgspec.json.Decoder(_Sample), msgspec.json.Decoder(_Command)
        self._event, self._hash = msgspec.json.Decoder(Event), msgspec.json.Decoder(StateHash)
        self._hashes: tuple[deque[tuple[StateHash, int]], ...] = (deque(), deque())
        self._begun, self._is_over = [False, False], [False, False]
        self.states = States()
        self.remarks: list[str] = []

    def run(self) -> None:
        """Read both to their ends."""
        streams = [side.messages() for side in self._sides]
        count = 0
        while min(self._reached) < math.inf:
            side = 0 if self._reached[0] <= self._reached[1] else 1
            found = next(streams[side], None)
            if found is None or self._reached[side] > self._end or self._is_over[side]:
                self._reached[side] = math.inf
            else:
                topic, message = found
                try:
                    self._take(side, topic, message)
                except msgspec.MsgspecError as error:
                    text = f"{topic} at {message.log_time} ns cannot be read: {error}"
                    raise NotReplayable(text) from error
                self._reached[side] = max(self._reached[side], message.log_time)
            count += 1
            if count % PAIR_EVERY == 0 or found is None:
                for pairing in self._pairings.values():
                    pairing.pair(self._reached)

    def _take(self, side: int, topic: str, message: Any) -> None:
        if topic == HASHES:
            if self._begin <= message.log_time <= self._end:
                self._hashes[side].append((self._hash.decode(message.data), message.log_time))
                self._match()
            return
        if topic == EVENTS:
            event = self._event.decode(message.data)
            if event.event == "reset" and self._begun[side]:
                # The same times come again, so that samples cannot be paired by time.
                self._is_over[side] = True
                self._end = min(self._end, self._reached[side])
                self.remarks.append(f"compared to {self._end / 1e9:g} s, where a reset sets the time of one of them")
            return
        self._begun[side] = True
        pairing = self._pairings[topic]
        if self._sides[side].ports[topic].direction == "sensor":
            sample = self._sample.decode(message.data)
            timed: Timed = (sample.t_ns, sample.valid, sample.value)
        else:
            timed = message.log_time, True, self._command.decode(message.data).value
        if self._begin <= timed[0] <= self._end:
            pairing.put(side, timed)

    def _match(self) -> None:
        one, other = self._hashes
        while one and other:
            (a, t_ns), (b, t_other) = one[0], other[0]
            # Hashes are paired by time, not by tick, because the tick rates may differ.
            if t_ns <= t_other:
                one.popleft()
            if t_ns >= t_other:
                other.popleft()
            if t_ns == t_other:
                now = self.states
                is_first = a.hash != b.hash and now.first_ns is None
                last = t_ns if a.hash == b.hash and now.first_ns is None else now.last_equal_ns
                self.states = States(now.equal + (a.hash == b.hash), last, t_ns if is_first else now.first_ns)
