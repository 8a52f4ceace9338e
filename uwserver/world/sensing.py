"""The sensors of a world: which measure in a tick, and the samples that are on their way."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Container, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Sample
from uwserver.ports.checks import check_values
from uwserver.ports.thinning import WHOLE, Thinned
from uwserver.ports.told import Origin, Told
from uwserver.world.components import SensorStream
from uwserver.world.computing import DROP, settled
from uwserver.world.due import Due, due_of, once
from uwserver.world.instruments import Instruments
from uwserver.world.on_their_way import WAY, OnTheirWay
from uwserver.world.part import Part, Stage
from uwserver.world.profile import Timer, untimed
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.streams import ENTRY, HEARD, KEPT, LARGE, READ, SMALL
from uwserver.world.under_way import UnderWay

Listen = Callable[[Any, FloatArray, int, int], None]
"""Takes entries and numbers of delivered samples, how many, and the time (ns)."""


_PERIOD = 4096
"""Ticks after which the same sensors are due again, for which it is noted down who they are."""


class Sensing(Part):
    """A part that stands for all sensors: it lets those read that are due, and delivers what is delayed.

    Attributes:
        numbers: of the streams, by port.
        schedule_made: another object whenever others are due than before.
        under_way: readings that take time.
    """

    path = "world/samples"
    state_type = OnTheirWay
    stage: ClassVar[Stage] = Stage.SENSORS

    def __init__(
        self,
        slots: Mapping[str, SensorSlot],
        instruments: Instruments,
        seconds: Callable[[], float],
    ) -> None:
        """Of a world that is still being built.

        Args:
            slots: the sensors by path; may change before each `schedule`.
            instruments: where they lie.
            seconds: time of the world.
        """
        self._slots, self._instruments = slots, instruments
        self._seconds = seconds
        self._groups: list[tuple[int, list[SensorSlot]]] = []
        self._repeating: list[Due] = []
        self._plans: dict[int, Due] = {}
        self._reader = once(instruments.reader)
        self._masks: tuple[int, ...] = ()
        self._listening: list[SensorSlot] = []
        self._there: dict[SensorSlot, None] = {}
        self._wanted: Container[str] | None = None
        self._thinned = WHOLE
        self._heard: Collection[str] = ()
        self._overheard: Collection[str] = ()
        self._listen: Listen | None = None
        self._streams: dict[int, SensorStream] = {}
        self._wordy: list[SensorStream] = []
        self._origins: dict[int, Origin] = {}
        self._is_read = self._marked(())
        self._told: Told | None = None
        self.numbers: dict[str, int] = {}
        self.schedule_made = object()
        self.under_way = UnderWay(instruments, self._is_needed)
        self.services = ((DROP, self.under_way.drop),)
        self.watch(untimed)

    def watch(self, timed: Timer) -> None:
        """Call what a tick consists of through what `timed` makes of it; `schedule` follows."""
        self._timed = timed
        self._look = timed("sensors", "accelerations", self._instruments.look)
        self._deliver = timed("delivery", "errors, delays", self._instruments.deliver)
        self._give = timed("samples", "for who reads", self._tell)

    def _due(self, slots: Sequence[SensorSlot], divisor: int = 1) -> Due:
        return due_of(slots, divisor, self._instruments.reader, self._instruments, self._timed)

    def settle(self) -> None:
        """Sensors came or went: give them their places."""
        slots, there, self._thinned = self._slots, dict.fromkeys(self._slots.values()), WHOLE
        gone = [slot for slot in self._there if slot not in there]
        streams = dict(self._streams)
        if gone:
            lost = {k for slot in gone for k in slot.stream_numbers}
            self._instruments.lose(lambda k, _: k in lost)  # while they are still there
            for k in lost:
                del streams[k]
            for slot in gone:
                slot.move_out()
        new = [slot for slot in slots.values() if slot not in self._there]
        for slot in new:
            slot.enter(self._instruments)
            streams |= zip(slot.stream_numbers, slot.streams, strict=True)
        self._there, self._streams = there, streams
        self.numbers = {stream.port.path: k for k, stream in streams.items()}
        self._wordy = [stream for stream in streams.values() if stream.columns.loose]
        writing = [(slot, slot.sensor.writing) for slot in there]
        texts = {k: w.texts for slot, w in writing if w is not None for k in slot.stream_numbers}
        self._origins = {
            k: Origin(s.port.path, s.columns.width, s.columns.values, texts.get(k, ())) for k, s in streams.items()
        }
        wordy = {k: SMALL if s.columns.is_small else LARGE for k, s in streams.items() if s.columns.loose}
        self._instruments.streams.rows["wordy"] = 0
        self._instruments.streams.rows["wordy"][[*wordy]] = [*wordy.values()]
        self.under_way.settle(slots.values())
        self._instruments.gather({id(s.wiring): s.wiring for s in slots.values() if s.wiring is not None}.values())

    def want(self, ports: Container[str] | None, thinned: Thinned = WHOLE) -> None:
        """Only samples of these ports are made; None for all. Those that parts of the world hear are always made.

        Args:
            ports: paths.
            thinned: of those by path, of which only the samples are needed that one of these takes. More may be made, as where their order
                is not that of their times. It holds until sensors come or go, or the time is set.
        """
        self._wanted, self._thinned = ports, thinned
        self._mark()

    def forget_newest(self) -> None:
        """The time was set: what was read at another time does not count."""
        self._instruments.forget_newest()
        self._thinned = WHOLE
        self._instruments.thin({})

    def set_listeners(self, ports: Collection[str], overheard: Collection[str], listen: Listen | None) -> None:
        """Parts of the world hear some ports; compiled code hears others, after each tick in which something is delivered that somebody wants."""
        self._heard, self._overheard = ports, overheard
        self._listen = None if listen is None else self._timed("listening", "autopilots", listen)
        self._mark()

    def _mark(self) -> None:
        rows, streams, wanted = self._instruments.streams.rows["wanted"], self._streams, self._wanted
        rows[:] = 0
        if wanted is None:
            rows[list(streams)] = READ
            self._instruments.thin({})
            return
        read = {k for path, k in self.numbers.items() if path in wanted or path in self._heard}
        self._is_read = self._marked(read)
        # Values that are no numbers wait in Python for the sample that they belong to.
        rows[[k for k, stream in streams.items() if stream.columns.loose]] = KEPT
        rows[[self.numbers[path] for path in self._overheard]] = HEARD
        rows[list(read)] = READ
        known = [(self.numbers.get(path), some) for path, some in self._thinned.items() if path not in self._heard]
        self._instruments.thin({k: some for k, some in known if k in read and streams[k].columns.is_small})

    def _is_needed(self, stream: int) -> bool:
        return self._wanted is None or bool(self._is_read[stream])

    def _marked(self, streams: Collection[int]) -> Any:
        """By number of a stream: whether it is one of these."""
        marked = np.zeros(max(self._streams, default=-1) + 1, bool)
        marked[list(streams)] = True
        return marked

    def schedule(self) -> None:
        """Sort the active sensors by how often they are due."""
        groups: dict[tuple[bool, int], list[SensorSlot]] = {}
        for slot in self._slots.values():
            if slot.active:
                groups.setdefault((slot.sensor.repeats, slot.divisor), []).append(slot)
        self._listening = [slot for slot in self._slots.values() if slot.active and slot.sensor.listens]
        inorder = sorted(groups.items(), key=lambda group: group[0])
        self._groups = [(divisor, slots) for (repeats, divisor), slots in inorder if not repeats]
        self._repeating = [self._due(slots, divisor) for (repeats, divisor), slots in inorder if repeats]
        self._plans, self._reader = {0: self._due(())}, once(self._instruments.reader)
        period = math.lcm(*(divisor for divisor, _ in self._groups))
        self._masks = tuple(map(self._mask_of, range(period))) if period <= _PERIOD else ()
        self.schedule_made = object()

    def by_mask(self) -> tuple[Sequence[int], Callable[[int], Due]] | None:
        """For each tick of a period which sensors are due, and what these are. None where that is not all: some listen, repeat what others have
        read, or take time; or the period is too long."""
        if self._listening or self._repeating or not self.under_way.is_idle or not self._masks:
            return None
        return self._masks, lambda mask: self._plans.get(mask) or self._new_plan(mask)

    def _mask_of(self, tick: int) -> int:
        """The groups that are due in a tick, as bits."""
        return sum(1 << k for k, (divisor, _) in enumerate(self._groups) if tick % divisor == 0)

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        """What is delivered in a tick. The order is part of the contract:

        1. the delayed samples whose time has come, oldest first: they are older than anything measured now; what is not computed yet is
           waited for (`uwserver.world.computing`);
        2. sensors to which something has come meanwhile that they wait for, as the answer of a beacon;
        3. sensors that are due, those of a shorter interval first, with their errors, from the new state;
        4. those that repeat what the others have read.
        """
        instruments, masks = self._instruments, self._masks
        mask = masks[tick % len(masks)] if masks else self._mask_of(tick)
        roused = self._roused() if instruments.roused else ()
        if not (mask or self._listening or self._repeating or roused) and t_ns < instruments.next_ns:
            return
        now, begins = self._seconds(), True
        instruments.set_time(t_ns)
        if t_ns >= instruments.next_ns and not self.under_way.is_idle:
            self.under_way.arrive(t_ns)
        called = [s for s in (*self._listening, *roused) if s.is_called(now)] if self._listening or roused else ()
        if called:
            self._measure(self._due(called), now, t_ns, begins)
            begins = False
        told = self._measure(self._plans.get(mask) or self._new_plan(mask), now, t_ns, begins)
        for group in self._repeating:
            if tick % group.divisor == 0:
                told = self._measure(group, now, t_ns, False)
        if told and self._listen is not None:
            self._listen(*instruments.delivered, told, t_ns)
        if told and (instruments.read_count or instruments.wordy_count):
            self._give(samples)
        self.under_way.purge()

    def _roused(self) -> list[SensorSlot]:
        """Active sensors that have something to tell, in an order that does not depend on who came first."""
        roused = self._instruments.roused
        for slot in [slot for slot in roused if slot.sensor.wake is None]:
            del roused[slot]
        return sorted((slot for slot in roused if slot.active), key=lambda slot: slot.path)

    def _new_plan(self, mask: int) -> Due:
        """Those whose groups have their bit set; there are as many as sets of groups that ever meet."""
        slots = [slot for k, (_, slots) in enumerate(self._groups) if mask >> k & 1 for slot in slots]
        self._plans[mask] = plan = due_of(slots, 1, self._reader, self._instruments, self._timed)
        return plan

    def _measure(self, due: Due, now: float, t_ns: int, begins: bool) -> int:
        """Let sensors read, and deliver. Returns how many samples of this tick somebody reads."""
        _, in_banks, in_python, written, ready_made, kept, slow, heads, most, needs_rates, _ = (
            due  # quicker than by name
        )
        if needs_rates:
            self._look(now)
        for read_all in in_banks:
            read_all(now)
        if in_python:
            scope_of = self._instruments.scopes(t_ns, needs_rates)
            for slot, read in in_python:
                read(scope_of(slot.row, slot.wiring))
        for write in written:
            write()
        for disturb in ready_made:
            disturb(t_ns)
        told = self._deliver(heads, t_ns, begins, most)
        for keep in kept:
            keep()
        for slot in slow:
            self.under_way.take(slot, t_ns)
        return told

    def tell_all(self, ends: Sequence[int], with_words: bool, written: bool, samples: list[Sample]) -> None:
        """Compiled code has delivered in several ticks (`ticking`): tell of it.

        Args:
            ends: of each tick with samples that somebody reads, the place behind them in the log.
            with_words: in the last one there are some with values that are no numbers.
            written: sensors wrote.
            samples: receives those that `take_told` does not give.
        """
        first = self._instruments.take_over()
        if written:
            self._take_texts()
        self._tell_of(first, ends, with_words, samples)

    def _take_texts(self) -> None:
        """Know the texts again that belong to what compiled code has written (`sensors.writing.Writing`)."""
        told = self._instruments.streams.rows["texts"]
        (streams,) = told.nonzero()
        for k, texts in zip(streams.tolist(), told[streams].tolist(), strict=True):
            stream = self._streams[k]
            stream.fresh = stream.loose = stream.newest = self._origins[k].texts[texts - 1]
        told[streams] = 0

    def _tell(self, samples: list[Sample]) -> None:
        first, end = self._instruments.logged
        self._tell_of(first, (end,) if end > first else (), bool(self._instruments.wordy_count), samples)

    def _tell_of(self, first: int, ends: Sequence[int], with_words: bool, samples: list[Sample]) -> None:
        log, is_large = self._instruments.log, False
        if with_words:
            for k, seq, place in self._instruments.wordy:
                stream = self._streams[k]
                # A state from outside may have two of one number on their way.
                stream.newest = stream.coming.pop(seq, stream.newest or stream.loose)
                if place >= 0:
                    log.loose[place] = settled(stream.newest)
                    is_large = is_large or not stream.columns.is_small
        if not ends:
            return
        before, told = self._told, Told(self._origins, log, first, ends[-1], len(ends), tuple(ends[:-1]))
        together = told if before is None else before.followed_by(told)
        if together is not None and not is_large:
            self._told = together
            return
        samples += (*(before or ()), *told)
        self._told = None
        for place in range(first, ends[-1]):  # a picture is not kept by what was delivered with it
            log.loose.pop(place, None)

    def take_told(self) -> Told | None:
        """What was delivered in this tick, but for what `after` has appended."""
        told, self._told = self._told, None
        return told

    def newest(self, path: str) -> Sample | None:
        """The newest delivered sample of a port; None before the first, or after the time was set."""
        k = self.numbers.get(path)
        newest = None if k is None else self._instruments.newest(k)
        if k is None or newest is None:
            return None
        stream = self._streams[k]
        values = stream.columns.unpack(newest.values, settled(stream.newest))
        return Sample(path, newest.seq, newest.t_ns, newest.t_sent_ns, newest.valid, values)

    # -- state ----------------------------------------------------------------------------------------------------------------------

    def save(self) -> OnTheirWay:
        """The samples on their way, in their order."""
        order, pending, numbers = self._instruments.on_their_way()
        if not len(pending):
            return OnTheirWay(order, (), b"", b"", ())
        ports: dict[int, int] = {}
        places = [ports.setdefault(k, len(ports)) for k in pending["stream"].tolist()]
        entries = np.empty(len(pending), WAY)
        for name in ("t_sent_ns", "order", "seq", "t_ns", "valid"):
            entries[name] = pending[name]
        entries["port"] = places
        streams = [self._streams[k] for k in ports]
        loose: list[Any] = []
        pictures: list[Any] = []
        if self._wordy:
            for k, seq in zip(pending["stream"].tolist(), pending["seq"].tolist(), strict=True):
                stream = self._streams[k]
                if stream.columns.loose:
                    kept = pictures if k in self.under_way.streams else loose
                    kept.append(stream.coming.get(seq, stream.loose))
        paths = tuple([stream.port.path for stream in streams])
        return OnTheirWay(order, paths, entries.tobytes(), numbers.tobytes(), tuple(loose), tuple(pictures))

    def check(self, state: Any) -> None:
        """Each sample is of a sensor, and fits its fields."""
        unknown = [path for path in state.ports if path not in self.numbers]
        if unknown:
            raise ValueError(f'a sample on its way from "{unknown[0][:80]}", which is no sensor')
        entries = state.checked_entries()
        streams = [self._streams[self.numbers[path]] for path in state.ports]
        width = sum([streams[place].columns.width for place in entries["port"].tolist()])
        if len(state.numbers) != 8 * width:
            raise ValueError(f"samples on their way with other fields: {len(state.numbers)} bytes, not {8 * width}")
        wordy, slow = self._split(state, entries)
        if len(state.loose) != len(wordy) or len(state.pictures) != len(slow):
            raise ValueError("samples on their way with other fields")
        for (stream, _), values in zip(wordy + slow, state.loose + state.pictures, strict=True):
            check_values([stream.port.fields[k] for k in stream.columns.loose], values)

    def _split(self, state: OnTheirWay, entries: Any) -> tuple[list[tuple[SensorStream, int]], ...]:
        """Stream and number of each sample whose values stand in `loose` of a state, and of those in `pictures`."""
        numbers = [self.numbers[path] for path in state.ports]
        each = [(numbers[place], seq) for place, seq in entries[["port", "seq"]].tolist()]
        each = [(k, seq) for k, seq in each if self._streams[k].columns.loose]
        takes_time = self.under_way.streams
        return tuple([[(self._streams[k], n) for k, n in each if (k in takes_time) is slow] for slow in (False, True)])

    def load(self, state: OnTheirWay) -> None:
        """Put them on their way again."""
        for stream in self._wordy:
            stream.coming.clear()
        given = np.frombuffer(state.entries, WAY)
        entries = np.zeros(len(given), ENTRY)
        for name in ("t_sent_ns", "order", "seq", "t_ns", "valid"):
            entries[name] = given[name]
        numbers = np.array([self.numbers[path] for path in state.ports], np.int64)
        entries["stream"] = numbers[given["port"]]
        self.under_way.forget()
        for known, each in zip(self._split(state, given), (state.loose, state.pictures), strict=True):
            for (stream, seq), values in zip(known, each, strict=True):
                stream.coming[seq] = values
        self._instruments.send_on_their_way(state.order, entries, np.frombuffer(state.numbers))

    def leave(self, why: str) -> None:
        """The run ends, and with it the thread that computes readings."""
        self._instruments.computing.end()
