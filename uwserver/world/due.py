"""Sensors that are due in the same ticks, and how they read."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import IntArray
from uwserver.sensors import Scope
from uwserver.sensors.bank import Bank, BankSensor
from uwserver.world.instruments import Instruments
from uwserver.world.profile import Timer, kind_of
from uwserver.world.sensor_slot import SensorSlot

Reader = Callable[[Bank, IntArray], Callable[[float], None]]
"""What lets sensors of a kind, numbers of heads, read at a time (s)."""


class Compiled(NamedTuple):
    """Sensors for which compiled code can do everything: the numbers of heads by kind, and those that write."""

    kinds: tuple[tuple[Bank, IntArray], ...]
    written: tuple[SensorSlot, ...]


class Due(NamedTuple):
    """Sensors that read together.

    Attributes:
        divisor: every so many ticks, of those that repeat others.
        in_banks: what lets those read whose readings compiled code makes, each called with the time (s): before them who of them also tells what
            it would read without errors.
        in_python: the others, and what reads each.
        written: what lets those of them read that need not see the world.
        ready_made: what makes the errors of those whose errors are written in Python.
        kept: what keeps values that are no numbers for the samples of this reading, after their delays are known.
        slow: those that may take time to compute what they read.
        heads: numbers of all.
        most: samples that can come of them.
        needs_rates: whether one of them does.
        compiled: the same for compiled code that does everything for them; None where something needs Python.
    """

    divisor: int
    in_banks: tuple[Callable[[float], None], ...]
    in_python: tuple[tuple[SensorSlot, Callable[[Scope], None]], ...]
    written: tuple[Callable[[], None], ...]
    ready_made: tuple[Callable[[int], None], ...]
    kept: tuple[Callable[[], None], ...]
    slow: tuple[SensorSlot, ...]
    heads: IntArray
    most: int
    needs_rates: bool
    compiled: Compiled | None


def once(reader: Reader) -> Reader:
    """The same, which finds for the same sensors what it has found before: they read in many ticks, each time beside others, and what their rays need
    is as large as they are many."""
    found: dict[tuple[int, bytes], Callable[[float], None]] = {}

    def find(bank: Bank, due: IntArray) -> Callable[[float], None]:
        key = id(bank), due.tobytes()
        if key not in found:
            found[key] = reader(bank, due)
        return found[key]

    return find


def writer(slots: Sequence[SensorSlot], instruments: Instruments) -> Callable[[], None]:
    """What lets sensors write (`Sensor.writes`), and tells of all at once that they are ready, but for those that a fault keeps silent."""
    numbers, heads = np.array([slot.head for slot in slots]), instruments.heads.rows
    # To find a column costs as much as to write it.
    ready, silent, valid = heads["ready"], heads["silent"], heads["valid"]

    def write_all() -> None:
        ready[numbers] = silent[numbers] == 0
        valid[numbers] = 1
        for slot in slots:
            slot.write()

    return write_all


def keeper(slots: Sequence[SensorSlot], instruments: Instruments) -> Callable[[], None]:
    """What lets sensors keep what is no number of their readings (`SensorSlot.keep_loose`)."""
    numbers, heads = np.array([slot.head for slot in slots]), instruments.heads.rows
    streams = np.array([k for slot in slots for k in slot.stream_numbers])
    ready, made, dropped = heads["ready"], heads["number"], instruments.streams.rows["reading"]["dropped"]

    def keep_all() -> None:
        lost = iter(dropped[streams].tolist())
        for slot, is_ready, number in zip(slots, ready[numbers].tolist(), made[numbers].tolist(), strict=True):
            own = tuple(islice(lost, len(slot.streams)))
            if is_ready:
                slot.keep_loose(number - 1, own)

    return keep_all


def due_of(slots: Sequence[SensorSlot], divisor: int, reader: Reader, instruments: Instruments, timed: Timer) -> Due:
    """These sensors, which read together; `timed` is told what each step is."""
    banks: dict[int, tuple[BankSensor, list[int]]] = {}
    for slot in slots:
        if isinstance(slot.sensor, BankSensor):
            banks.setdefault(id(slot.sensor.bank), (slot.sensor, []))[1].append(slot.head)
    in_banks = [slot for slot in slots if isinstance(slot.sensor, BankSensor)]
    in_python = [slot for slot in slots if not isinstance(slot.sensor, BankSensor) and not slot.writes]
    written = _by_kind([slot for slot in slots if slot.writes])
    wordy = [slot for slot in slots if slot.is_wordy]
    ready_made = [slot for slot in slots if any(stream.is_ready_made for stream in slot.streams)]
    kinds = tuple((first.bank, np.array(heads, np.int64)) for first, heads in banks.values())
    exactly = [timed("sensors", kind_of(slot.sensor), slot.read_exactly) for slot in in_banks if slot.wants_exact]
    readers = [
        timed("sensors", kind_of(first), reader(bank, heads), len(heads))
        for (first, _), (bank, heads) in zip(banks.values(), kinds, strict=True)
    ]
    return Due(
        divisor,
        (*exactly, *readers),
        tuple((slot, timed("sensors", kind_of(slot.sensor), slot.read, 1)) for slot in in_python),
        tuple(timed("sensors", kind_of(alike[0].sensor), writer(alike, instruments), len(alike)) for alike in written),
        tuple(timed("delivery", "errors in Python", slot.disturb) for slot in ready_made),
        (keeper(wordy, instruments),) if wordy else (),
        tuple(slot for slot in wordy if slot.sensor.takes_time),
        np.array([slot.head for slot in slots], np.int64),
        sum(len(slot.streams) for slot in slots),
        any(slot.sensor.needs_rates for slot in slots),
        Compiled(kinds, tuple(slot for slot in slots if slot.writes))
        if all(slot.is_compiled for slot in slots)
        else None,
    )


def _by_kind(slots: Iterable[SensorSlot]) -> Collection[list[SensorSlot]]:
    kinds: dict[str, list[SensorSlot]] = {}
    for slot in slots:
        kinds.setdefault(kind_of(slot.sensor), []).append(slot)
    return kinds.values()
