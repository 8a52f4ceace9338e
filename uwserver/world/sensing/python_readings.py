"""The Python work that readings need at the stops of a step: sensors and errors that are written in Python, and values that are no numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import IntArray
from uwserver.sensors import Scope
from uwserver.sensors.compiled import CompiledSensor
from uwserver.world.parts.profile import Timer, kind_of
from uwserver.world.sensing.sensor_arrays import SensorArrays
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.sensing.timetable import is_repeated, is_written

_MOST_SETS = 512
"""Number of sets of sensors for which the work is kept ready. A set is what reads together in one round."""


class _Work(NamedTuple):
    """The Python work for a set of sensors that read together.

    Attributes:
        in_python: sensors written in Python, each with the function that reads it.
        loose: functions that take values that are no numbers from sensors of compiled code.
        written: functions that let sensors write their readings; these sensors need not see the world.
        texts: the same for sensors that compiled code usually writes.
        ready_made: functions that make the errors that are written in Python.
        kept: functions that keep the values that are no numbers until their samples are delivered. They run when the delays are known.
        kept_texts: the same for sensors that compiled code usually writes.
        slow: sensors that may take time to compute their readings.
        needs_rates: whether one of the sensors needs accelerations.
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


class PythonReadings:
    """Does the Python work of a world's sensors. It is made anew whenever other sensors are due."""

    def __init__(self, slots: Mapping[int, SensorSlot], sensor_arrays: SensorArrays, timed: Timer) -> None:
        """Take the sensors by the numbers of their heads in these arrays. `timed` wraps each function for a profile."""
        self._slots, self._sensor_arrays, self._timed = slots, sensor_arrays, timed
        self._work: dict[bytes, _Work] = {}
        self._writes_texts = False

    def sense(self, due: IntArray, t_ns: int) -> None:
        """Read the due sensors that are written in Python, then make the errors that are written in Python."""
        work = self._work_for(due)
        if work.in_python:
            scope_of = self._sensor_arrays.scopes(t_ns, work.needs_rates)
            for slot, read in work.in_python:
                read(scope_of(slot.row, slot.wiring))
        for take in work.loose:
            take()
        for write in work.written:
            write()
        for disturb in work.ready_made:
            disturb(t_ns)

    def write(self, due: IntArray) -> None:
        """Write the due sensors that compiled code usually writes. Needed when a fault makes one of them repeat itself."""
        self._writes_texts = True
        for write in self._work_for(due).texts:
            write()

    def keep(self, due: IntArray) -> Sequence[SensorSlot]:
        """Keep the values that are no numbers for the samples of these readings. Returns the sensors that take time to compute."""
        work = self._work_for(due)
        for keep in work.kept:
            keep()
        for keep in work.kept_texts if self._writes_texts else ():
            keep()
        self._writes_texts = False
        return work.slow

    def _work_for(self, due: IntArray) -> _Work:
        key = due.tobytes()
        work = self._work.get(key)
        if work is None:
            if len(self._work) >= _MOST_SETS:
                self._work.clear()
            work = self._work[key] = self._find_work([self._slots[head] for head in due.tolist()])
        return work

    def _find_work(self, slots: Sequence[SensorSlot]) -> _Work:
        timed, sensor_arrays = self._timed, self._sensor_arrays
        texts = [slot for slot in slots if is_written(slot)]
        others = [slot for slot in slots if not is_written(slot)]
        compiled = {slot for slot in others if isinstance(slot.sensor, CompiledSensor) or is_repeated(slot)}
        in_python = [slot for slot in others if slot not in compiled and not slot.writes]
        with_loose = [slot for slot in others if slot.has_loose]
        ready_made = [slot for slot in others if any(stream.is_ready_made for stream in slot.streams)]
        return _Work(
            tuple((slot, timed("sensors", kind_of(slot.sensor), slot.read, 1)) for slot in in_python),
            tuple(slot.take_loose for slot in others if slot.has_loose and isinstance(slot.sensor, CompiledSensor)),
            self._writers(slot for slot in others if slot.writes),
            self._writers(texts),
            tuple(timed("delivery", "errors in Python", slot.disturb) for slot in ready_made),
            (_keeper(with_loose, sensor_arrays),) if with_loose else (),
            (_keeper(texts, sensor_arrays),) if texts else (),
            tuple(slot for slot in with_loose if slot.sensor.takes_time),
            any(slot.sensor.needs_rates for slot in slots),
        )

    def _writers(self, slots: Iterable[SensorSlot]) -> tuple[Callable[[], None], ...]:
        return tuple(
            self._timed("sensors", kind_of(alike[0].sensor), _writer(alike, self._sensor_arrays), len(alike))
            for alike in _by_kind(slots)
        )


def _by_kind(slots: Iterable[SensorSlot]) -> Collection[list[SensorSlot]]:
    kinds: dict[str, list[SensorSlot]] = {}
    for slot in slots:
        kinds.setdefault(kind_of(slot.sensor), []).append(slot)
    return kinds.values()


def _writer(slots: Sequence[SensorSlot], sensor_arrays: SensorArrays) -> Callable[[], None]:
    """Return a function that lets some sensors write (`Sensor.writes`) and marks all of them as ready, except those that a fault keeps
    silent."""
    numbers, heads = np.array([slot.head for slot in slots]), sensor_arrays.heads.rows
    # Finding a column of a record array costs as much as writing it, so it is done once.
    ready, silent, valid = heads["ready"], heads["silent"], heads["valid"]

    def write_all() -> None:
        ready[numbers] = silent[numbers] == 0
        valid[numbers] = 1
        for slot in slots:
            slot.write()

    return write_all


def _keeper(slots: Sequence[SensorSlot], sensor_arrays: SensorArrays) -> Callable[[], None]:
    """Return a function that lets some sensors keep the values of their readings that are no numbers (`SensorSlot.keep_loose`)."""
    numbers, heads = np.array([slot.head for slot in slots]), sensor_arrays.heads.rows
    streams = np.array([k for slot in slots for k in slot.stream_numbers])
    ready, made, dropped = heads["ready"], heads["number"], sensor_arrays.streams.rows["reading"]["dropped"]

    def keep_all() -> None:
        lost = iter(dropped[streams].tolist())
        for slot, is_ready, number in zip(slots, ready[numbers].tolist(), made[numbers].tolist(), strict=True):
            own = tuple(islice(lost, len(slot.streams)))
            if is_ready:
                slot.keep_loose(number - 1, own)

    return keep_all
