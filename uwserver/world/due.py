"""Sensors that are due in the same ticks, and how they read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import IntArray
from uwserver.sensors import Scope
from uwserver.sensors.bank import Bank, BankSensor
from uwserver.world.profile import Timer, kind_of
from uwserver.world.sensor_slot import SensorSlot

Reader = Callable[[Bank, IntArray], Callable[[float], None]]
"""What lets sensors of a kind, numbers of heads, read at a time (s)."""


class Due(NamedTuple):
    """Sensors that read together.

    Attributes:
        divisor: every so many ticks, of those that repeat others.
        in_banks: what lets those read whose readings compiled code makes, each called with the time (s): before them who of them also tells what
            it would read without errors.
        in_python: the others, and what reads each.
        written: what lets those of them read that need not see the world.
        ready_made: what makes the errors of those whose errors are written in Python.
        wordy: those with values that are no numbers.
        heads: numbers of all.
        most: samples that can come of them.
        needs_rates: whether one of them does.
    """

    divisor: int
    in_banks: tuple[Callable[[float], None], ...]
    in_python: tuple[tuple[SensorSlot, Callable[[Scope], None]], ...]
    written: tuple[Callable[[], None], ...]
    ready_made: tuple[Callable[[int], None], ...]
    wordy: tuple[SensorSlot, ...]
    heads: IntArray
    most: int
    needs_rates: bool


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


def due_of(slots: Sequence[SensorSlot], divisor: int, reader: Reader, timed: Timer) -> Due:
    """These sensors, which read together; `timed` is told what each step is."""
    banks: dict[int, tuple[BankSensor, list[int]]] = {}
    for slot in slots:
        if isinstance(slot.sensor, BankSensor):
            banks.setdefault(id(slot.sensor.bank), (slot.sensor, []))[1].append(slot.head)
    in_banks = [slot for slot in slots if isinstance(slot.sensor, BankSensor)]
    in_python = [slot for slot in slots if not isinstance(slot.sensor, BankSensor) and not slot.writes]
    written = [slot for slot in slots if slot.writes]
    ready_made = [slot for slot in slots if any(stream.is_ready_made for stream in slot.streams)]
    exactly = [timed("sensors", kind_of(slot.sensor), slot.read_exactly) for slot in in_banks if slot.wants_exact]
    readers = [
        timed("sensors", kind_of(first), reader(first.bank, np.array(heads)), len(heads))
        for first, heads in banks.values()
    ]
    return Due(
        divisor,
        (*exactly, *readers),
        tuple((slot, timed("sensors", kind_of(slot.sensor), slot.read, 1)) for slot in in_python),
        tuple(timed("sensors", kind_of(slot.sensor), slot.write, 1) for slot in written),
        tuple(timed("delivery", "errors in Python", slot.disturb) for slot in ready_made),
        tuple(slot for slot in slots if slot.is_wordy),
        np.array([slot.head for slot in slots], np.int64),
        sum(len(slot.streams) for slot in slots),
        any(slot.sensor.needs_rates for slot in slots),
    )
