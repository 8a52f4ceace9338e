"""The sensors of a world: who is there, whose samples are wanted, and the samples that are on their way or delivered."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Mapping, Sequence
from typing import Any

import numpy as np

from uwserver.ports import Sample
from uwserver.ports.checks import check_values
from uwserver.ports.thinning import WHOLE, Thinned
from uwserver.ports.told import Origin, Told
from uwserver.sensors.bank import BankSensor
from uwserver.step.streams import ENTRY, HEARD, KEPT, LARGE, NEVER, READ, SMALL
from uwserver.units import NANOSECONDS
from uwserver.world.by_hand import ByHand
from uwserver.world.components import SensorStream
from uwserver.world.computing import DROP, settled
from uwserver.world.instruments import Instruments
from uwserver.world.on_their_way import WAY, OnTheirWay
from uwserver.world.part import Part
from uwserver.world.profile import Timer, untimed
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.timetable import Group, groups_of
from uwserver.world.under_way import UnderWay

_EARLY_NS = 2
"""More than times in seconds are rounded by, up to a hundred days: who is asked so much too early has nothing to do."""


class Sensing(Part):
    """A part that stands for all sensors. When they read and are delivered is decided by the step (`uwserver.step.tick`).

    Attributes:
        numbers: of the streams, by port.
        groups: who is due when; another list whenever others are due than before.
        by_hand: what these need of Python.
        casts: whether some of them cast rays.
        callable: how many samples can come of those that may be called.
        under_way: readings that take time.
    """

    path = "world/samples"
    state_type = OnTheirWay

    def __init__(self, slots: Mapping[str, SensorSlot], instruments: Instruments) -> None:
        """Of a world that is still being built.

        Args:
            slots: the sensors by path; may change before each `schedule`.
            instruments: where they lie.
        """
        self._slots, self._instruments = slots, instruments
        self.groups: list[Group] = []
        self.by_hand = ByHand({}, instruments, untimed)
        self.casts, self.callable = False, 0
        self._listening: list[SensorSlot] = []
        self._there: dict[SensorSlot, None] = {}
        self._wanted: Container[str] | None = None
        self._measured: Collection[str] | None = None
        self._thinned = WHOLE
        self._heard: Collection[str] = ()
        self._overheard: Collection[str] = ()
        self._streams: dict[int, SensorStream] = {}
        self._wordy: list[SensorStream] = []
        self._origins: dict[int, Origin] = {}
        self._is_read = self._marked(())
        self._told: Told | None = None
        self.numbers: dict[str, int] = {}
        self.under_way = UnderWay(instruments, self._is_needed)
        self.services = ((DROP, self.under_way.drop),)
        self.watch(untimed)

    def watch(self, timed: Timer) -> None:
        """Call what it does in a tick through what `timed` makes of it; `schedule` follows."""
        self._timed = timed
        self.tell = timed("samples", "for who reads", self._tell)

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

    def set_listeners(self, ports: Collection[str], overheard: Collection[str]) -> None:
        """Parts of the world hear some ports; compiled code hears others."""
        self._heard, self._overheard = ports, overheard
        self._mark()

    def _mark(self) -> None:
        rows, streams, wanted = self._instruments.streams.rows["wanted"], self._streams, self._wanted
        rows[:] = 0
        if wanted is None:
            rows[list(streams)] = READ
            self._instruments.is_read = bool(streams)
            self._instruments.thin({})
            return
        read = {k for path, k in self.numbers.items() if path in wanted or path in self._heard}
        self._is_read, self._instruments.is_read = self._marked(read), bool(read)
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

    def choose(self, measured: Collection[str] | None) -> None:
        """Let sensors of these paths alone measure; None, as at first, for all."""
        self._measured = measured
        self.schedule()

    def schedule(self) -> None:
        """Sort the active sensors by how often they are due."""
        measured = self._measured
        slots = [slot for path, slot in self._slots.items() if measured is None or path in measured]
        self.groups = groups_of(slots)
        active = [slot for group in self.groups for slot in group.slots]
        self._listening = [slot for slot in slots if slot.active and slot.sensor.listens]
        called = [slot for slot in active if slot.sensor.listens or slot.sensor.rouses]
        self.callable = sum(len(slot.streams) for slot in called)
        self.casts = any(slot.sensor.rays for slot in active if isinstance(slot.sensor, BankSensor))
        self.by_hand = ByHand({slot.head: slot for slot in active}, self._instruments, self._timed)

    @property
    def call_ns(self) -> int:
        """Before this time (ns of simulation) nothing comes to sensors that they wait for, as far as is known now."""
        wakes = [slot.sensor.wake for slot in (*self._listening, *self._instruments.roused)]
        first = min([wake for wake in wakes if wake is not None], default=None)
        return NEVER if first is None else math.floor(first * NANOSECONDS) - _EARLY_NS

    def called(self, now: float) -> list[SensorSlot]:
        """Sensors to which something has come by now (s) that they wait for, in an order that does not depend on who came first."""
        roused = self._instruments.roused
        for slot in [slot for slot in roused if slot.sensor.wake is None]:
            del roused[slot]
        inorder = sorted((slot for slot in roused if slot.active), key=lambda slot: slot.path)
        return [slot for slot in (*self._listening, *inorder) if slot.is_called(now)]

    def take_texts(self) -> None:
        """Know the texts again that belong to what compiled code has written (`sensors.writing.Writing`)."""
        told = self._instruments.streams.rows["texts"]
        (streams,) = told.nonzero()
        for k, texts in zip(streams.tolist(), told[streams].tolist(), strict=True):
            stream = self._streams[k]
            stream.fresh = stream.loose = stream.newest = self._origins[k].texts[texts - 1]
        told[streams] = 0

    def _tell(self, first: int, ends: Sequence[int], with_words: bool, samples: list[Sample]) -> None:
        """Tell what was delivered in some ticks.

        Args:
            first: place in the log from which on that stands.
            ends: of each tick with samples that somebody reads, the place behind them.
            with_words: in the last one there are some with values that are no numbers.
            samples: receives those that `take_told` does not give.
        """
        log, is_large = self._instruments.log, False
        for k, seq, place in self._instruments.wordy if with_words else ():
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
        """What was delivered of late, but for what `tell` has appended."""
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
