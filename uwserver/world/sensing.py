"""The sensors of a world: which measure in a tick, and the samples that are on their way."""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Mapping, Sequence, Set
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from msgspec import Meta

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.ports import Sample, Value
from uwserver.ports.checks import check_values
from uwserver.sensors import Scope
from uwserver.sensors.bank import Bank, BankSensor
from uwserver.world.components import Count, SensorStream
from uwserver.world.instruments import Instruments
from uwserver.world.part import Part, Stage, State
from uwserver.world.sensor_slot import SensorSlot

_READ, _HEARD = 1, 2
"""As in `delivery`, for which numba would be imported."""

Listen = Callable[[Any, FloatArray, int, int], None]
"""Takes entries and numbers of delivered samples, how many, and the time (ns)."""


class OnTheirWay(State, frozen=True):
    """Samples that are measured and not delivered yet: time of delivery (ns), order, port, seq, t_ns, valid and values of each."""

    order: Count
    samples: Annotated[
        tuple[tuple[Count, Count, str, Count, Count, bool, tuple[Value, ...]], ...], Meta(max_length=65536)
    ]


class _Due(NamedTuple):
    """Sensors that read together.

    Attributes:
        divisor: every so many ticks, of those that repeat others.
        banks: of those whose readings compiled code makes, the numbers of heads by bank.
        exactly: of those, who also tell what they would read without errors.
        in_python: the others.
        ready_made: those with errors that are written in Python.
        heads: numbers of all.
        most: samples that can come of them.
        needs_rates: whether one of them does.
    """

    divisor: int
    banks: tuple[tuple[Bank, IntArray], ...]
    exactly: tuple[SensorSlot, ...]
    in_python: tuple[SensorSlot, ...]
    ready_made: tuple[SensorSlot, ...]
    heads: IntArray
    most: int
    needs_rates: bool


def _due(slots: Sequence[SensorSlot], divisor: int) -> _Due:
    banks: dict[int, tuple[Bank, list[int]]] = {}
    for slot in slots:
        if isinstance(slot.sensor, BankSensor):
            banks.setdefault(id(slot.sensor.bank), (slot.sensor.bank, []))[1].append(slot.head)
    return _Due(
        divisor,
        tuple((bank, np.array(heads)) for bank, heads in banks.values()),
        tuple(slot for slot in slots if isinstance(slot.sensor, BankSensor) and slot.wants_exact),
        tuple(slot for slot in slots if not isinstance(slot.sensor, BankSensor)),
        tuple(slot for slot in slots if any(stream.is_ready_made for stream in slot.streams)),
        np.array([slot.head for slot in slots], np.int64),
        sum(len(slot.streams) for slot in slots),
        any(slot.sensor.needs_rates for slot in slots),
    )


class Sensing(Part):
    """A part that stands for all sensors: it lets those read that are due, and delivers what is delayed."""

    path = "world/samples"
    state_type = OnTheirWay
    stage: ClassVar[Stage] = Stage.SENSORS

    def __init__(
        self,
        slots: Mapping[str, SensorSlot],
        instruments: Instruments,
        seconds: Callable[[], float],
        scopes: Callable[[bool], Callable[[SensorSlot], Scope]],
    ) -> None:
        """Of a world that is still being built.

        Args:
            slots: the sensors by path; may change before each `schedule`.
            instruments: where they lie.
            seconds: time of the world.
            scopes: gives what sensors in Python see of the world as it is now, for one after the other, with accelerations or without.
        """
        self._slots, self._instruments = slots, instruments
        self._seconds, self._scopes = seconds, scopes
        self._groups: list[tuple[int, list[SensorSlot]]] = []
        self._repeating: list[_Due] = []
        self._plans: dict[int, _Due] = {}
        self._listening: list[SensorSlot] = []
        self._there: set[SensorSlot] = set()
        self._wanted: Container[str] | None = None
        self._heard: Collection[str] = ()
        self._overheard: Collection[str] = ()
        self._listen: Listen | None = None
        self._unread: Set[int] = frozenset()
        self._streams: dict[int, SensorStream] = {}
        self.numbers: dict[str, int] = {}

    def settle(self) -> None:
        """Sensors came or went: give them their places."""
        there = set(self._slots.values())
        gone = [slot for slot in self._there if slot not in there]
        self._lose({k for slot in gone for k in slot.stream_numbers})
        for slot in gone:
            slot.move_out()
        for slot in self._slots.values():
            if slot not in self._there:
                slot.enter(self._instruments)
        self._there = there
        numbered = (
            (k, s) for slot in self._slots.values() for k, s in zip(slot.stream_numbers, slot.streams, strict=True)
        )
        self._streams = dict(numbered)
        self.numbers = {stream.port.path: k for k, stream in self._streams.items()}
        self._mark()
        self._instruments.gather(
            {id(s.wiring): s.wiring for s in self._slots.values() if s.wiring is not None}.values()
        )

    def want(self, ports: Container[str] | None) -> None:
        """Only samples of these ports are made; None for all. Those that parts of the world hear are always made."""
        self._wanted = ports
        self._mark()

    def set_listeners(self, ports: Collection[str], overheard: Collection[str], listen: Listen) -> None:
        """Parts of the world hear some ports; compiled code hears others, after each tick in which something is delivered that somebody wants."""
        self._heard, self._overheard, self._listen = ports, overheard, listen
        self._mark()

    def _mark(self) -> None:
        rows, wanted, unread = self._instruments.streams.rows["wanted"], self._wanted, set()
        for k, stream in self._streams.items():
            path = stream.port.path
            if wanted is None or path in wanted or path in self._heard:
                rows[k] = _READ
                continue
            unread.add(k)
            # Values that are no numbers wait in Python for the sample that they belong to.
            rows[k] = _READ if stream.columns.loose else _HEARD if path in self._overheard else 0
        self._unread = unread

    def schedule(self) -> None:
        """Sort the active sensors by how often they are due."""
        groups: dict[tuple[bool, int], list[SensorSlot]] = {}
        for slot in self._slots.values():
            if slot.active:
                groups.setdefault((slot.sensor.repeats, slot.divisor), []).append(slot)
        self._listening = [slot for slot in self._slots.values() if slot.active and slot.sensor.listens]
        inorder = sorted(groups.items(), key=lambda group: group[0])
        self._groups = [(divisor, slots) for (repeats, divisor), slots in inorder if not repeats]
        self._repeating = [_due(slots, divisor) for (repeats, divisor), slots in inorder if repeats]
        self._plans = {0: _due((), 1)}

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        """What is delivered in a tick. The order is part of the contract:

        1. the delayed samples whose time has come, oldest first: they are older than anything measured now;
        2. sensors to which something has come meanwhile that they wait for, as the answer of a beacon;
        3. sensors that are due, those of a shorter interval first, with their errors, from the new state;
        4. those that repeat what the others have read.
        """
        mask = told = 0
        for k, (divisor, _) in enumerate(self._groups):
            if tick % divisor == 0:
                mask |= 1 << k
        if not mask and not self._listening and not self._repeating and t_ns < self._instruments.next_ns:
            return
        now, begins = self._seconds(), True
        self._instruments.set_time(t_ns)
        called = [slot for slot in self._listening if slot.is_called(now)]
        if called:
            told, begins = self._measure(_due(called, 1), now, t_ns, begins), False
        told = self._measure(self._plan(mask), now, t_ns, begins)
        for group in self._repeating:
            if tick % group.divisor == 0:
                told = self._measure(group, now, t_ns, False)
        if told and self._listen is not None:
            self._listen(*self._instruments.delivered, told, t_ns)
        if told and self._instruments.read_count:
            self._tell(told, samples)

    def _plan(self, mask: int) -> _Due:
        """Those whose groups have their bit set; there are as many as sets of groups that ever meet."""
        plan = self._plans.get(mask)
        if plan is None:
            slots = [slot for k, (_, slots) in enumerate(self._groups) if mask >> k & 1 for slot in slots]
            plan = self._plans[mask] = _due(slots, 1)
        return plan

    def _measure(self, due: _Due, now: float, t_ns: int, begins: bool) -> int:
        """Let sensors read, and deliver. Returns how many samples of this tick somebody reads."""
        instruments = self._instruments
        if due.needs_rates:
            instruments.look(now)
        for slot in due.exactly:
            slot.read_exactly(now)
        for bank, heads in due.banks:
            instruments.read(bank, heads, now)
        if due.in_python:
            scope_of = self._scopes(due.needs_rates)
            for slot in due.in_python:
                slot.read(scope_of(slot))
        for slot in due.ready_made:
            slot.disturb(t_ns)
        return instruments.deliver(due.heads, t_ns, begins, due.most)

    def _tell(self, told: int, samples: list[Sample]) -> None:
        for k, seq, t_ns, t_sent_ns, valid, numbers in self._instruments.told(0, told):
            stream = self._streams[k]
            loose = stream.coming.pop(seq, ()) if stream.columns.loose else ()
            if k in self._unread:
                continue
            values = stream.columns.unpack(numbers[: stream.columns.width], loose)
            samples.append(Sample(stream.port.path, seq, t_ns, t_sent_ns, valid, values))

    def newest(self, path: str) -> Sample | None:
        """The newest delivered sample of a port; None before the first, or after the time was set."""
        k = self.numbers.get(path)
        newest = None if k is None else self._instruments.newest(k)
        if k is None or newest is None:
            return None
        stream = self._streams[k]
        values = stream.columns.unpack(newest.values, stream.loose)
        return Sample(path, newest.seq, newest.t_ns, newest.t_sent_ns, newest.valid, values)

    # -- state ----------------------------------------------------------------------------------------------------------------------

    def save(self) -> OnTheirWay:
        """The samples on their way, in their order."""
        order, entries = self._instruments.on_their_way()
        told = []
        for t_sent_ns, n, k, seq, t_ns, valid, numbers in entries:
            stream = self._streams[k]
            values = stream.columns.unpack(numbers[: stream.columns.width], stream.coming.get(seq, ()))
            told.append((t_sent_ns, n, stream.port.path, seq, t_ns, valid, values))
        return OnTheirWay(order, tuple(told))

    def check(self, state: Any) -> None:
        """Each sample is of a sensor, and fits its fields."""
        ports = {stream.port.path: stream.port for stream in self._streams.values()}
        for _, order, path, seq, t_ns, _, values in state.samples:
            if path not in ports or order > state.order or seq < 0 or t_ns < 0:
                raise ValueError(f'a sample on its way from "{path[:80]}" that cannot be')
            check_values(ports[path].fields, values)

    def load(self, state: OnTheirWay) -> None:
        """Put them on their way again."""
        numbers = self.numbers
        for stream in self._streams.values():
            stream.coming.clear()
        entries = []
        for t_sent_ns, n, path, seq, t_ns, valid, values in state.samples:
            k = numbers[path]
            stream = self._streams[k]
            row = np.zeros(stream.columns.width)
            stream.columns.pack(values, row)
            if stream.columns.loose:
                stream.coming[seq] = tuple([values[i] for i in stream.columns.loose])
            entries.append((t_sent_ns, n, k, seq, t_ns, valid, row))
        self._instruments.send_on_their_way(state.order, entries)

    def _lose(self, streams: Set[int]) -> None:
        """Samples of sensors that go are lost on their way."""
        order, entries = self._instruments.on_their_way()
        others = [entry for entry in entries if entry[2] not in streams]
        if len(others) < len(entries):
            self._instruments.send_on_their_way(order, others)
