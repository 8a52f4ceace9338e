"""What readings need of Python, at the stops of a step: sensors and errors that are written in it, and values that are no numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import IntArray
from uwserver.sensors import Scope
from uwserver.sensors.bank import BankSensor
from uwserver.world.instruments import Instruments
from uwserver.world.profile import Timer, kind_of
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.timetable import is_repeated, is_written

_MOST_KEPT = 512
"""Sets of sensors that read together for which it is known what they need."""


class _Chores(NamedTuple):
    """What sensors that read together need.

    Attributes:
        in_python: sensors, and what reads each.
        loose: what takes those values that are no numbers of those that compiled code reads.
        written: what lets those of them read that need not see the world.
        texts: the same for those that compiled code writes otherwise.
        ready_made: what makes the errors of those whose errors are written in Python.
        kept: what keeps values that are no numbers for the samples of this reading, after their delays are known.
        kept_texts: the same of those that compiled code writes otherwise.
        slow: those that may take time to compute what they read.
        needs_rates: whether one of them does.
    """

    in_python: tuple[tuple[SensorSlot, Callable[[Scope], None]], ...]
    loose: tuple[Callable[[], None], ...]
    written: tuple[Callable[[], None], ...]
    texts: tuple[Callable[[], None], ...]
    ready_made: tuple[Callable[[int], None], ...]
    kept: tuple[Callable[[], None], ...]
    kept_texts: tuple[Callable[[], None], ...]
    slow: tuple[SensorSlot, ...]
    needs_rates: bool


class ByHand:
    """Of a world, until other sensors are due."""

    def __init__(self, slots: Mapping[int, SensorSlot], instruments: Instruments, timed: Timer) -> None:
        """Of sensors by their heads, which lie in these instruments; `timed` is told what each step is."""
        self._slots, self._instruments, self._timed = slots, instruments, timed
        self._chores: dict[bytes, _Chores] = {}
        self._writes_texts = False

    def sense(self, due: IntArray, t_ns: int) -> None:
        """Let sensors read that are written in Python, then make the errors that are."""
        chores = self._of(due)
        if chores.in_python:
            scope_of = self._instruments.scopes(t_ns, chores.needs_rates)
            for slot, read in chores.in_python:
                read(scope_of(slot.row, slot.wiring))
        for take in chores.loose:
            take()
        for write in chores.written:
            write()
        for disturb in chores.ready_made:
            disturb(t_ns)

    def write(self, due: IntArray) -> None:
        """Let sensors write that compiled code writes otherwise: one of them repeats itself."""
        self._writes_texts = True
        for write in self._of(due).texts:
            write()

    def keep(self, due: IntArray) -> Sequence[SensorSlot]:
        """What is no number of these readings waits for its samples. Returns those that take time."""
        chores = self._of(due)
        for keep in chores.kept:
            keep()
        for keep in chores.kept_texts if self._writes_texts else ():
            keep()
        self._writes_texts = False
        return chores.slow

    def _of(self, due: IntArray) -> _Chores:
        key = due.tobytes()
        chores = self._chores.get(key)
        if chores is None:
            if len(self._chores) >= _MOST_KEPT:
                self._chores.clear()
            chores = self._chores[key] = self._made([self._slots[head] for head in due.tolist()])
        return chores

    def _made(self, slots: Sequence[SensorSlot]) -> _Chores:
        timed, instruments = self._timed, self._instruments
        texts = [slot for slot in slots if is_written(slot)]
        others = [slot for slot in slots if not is_written(slot)]
        compiled = {slot for slot in others if isinstance(slot.sensor, BankSensor) or is_repeated(slot)}
        in_python = [slot for slot in others if slot not in compiled and not slot.writes]
        wordy = [slot for slot in others if slot.is_wordy]
        ready_made = [slot for slot in others if any(stream.is_ready_made for stream in slot.streams)]
        return _Chores(
            tuple((slot, timed("sensors", kind_of(slot.sensor), slot.read, 1)) for slot in in_python),
            tuple(slot.take_loose for slot in others if slot.is_wordy and isinstance(slot.sensor, BankSensor)),
            self._writers(slot for slot in others if slot.writes),
            self._writers(texts),
            tuple(timed("delivery", "errors in Python", slot.disturb) for slot in ready_made),
            (_keeper(wordy, instruments),) if wordy else (),
            (_keeper(texts, instruments),) if texts else (),
            tuple(slot for slot in wordy if slot.sensor.takes_time),
            any(slot.sensor.needs_rates for slot in slots),
        )

    def _writers(self, slots: Iterable[SensorSlot]) -> tuple[Callable[[], None], ...]:
        return tuple(
            self._timed("sensors", kind_of(alike[0].sensor), _writer(alike, self._instruments), len(alike))
            for alike in _by_kind(slots)
        )


def _by_kind(slots: Iterable[SensorSlot]) -> Collection[list[SensorSlot]]:
    kinds: dict[str, list[SensorSlot]] = {}
    for slot in slots:
        kinds.setdefault(kind_of(slot.sensor), []).append(slot)
    return kinds.values()


def _writer(slots: Sequence[SensorSlot], instruments: Instruments) -> Callable[[], None]:
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


def _keeper(slots: Sequence[SensorSlot], instruments: Instruments) -> Callable[[], None]:
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
