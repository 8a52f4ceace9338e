"""When the sensors of a world read, as rows for the step (`uwserver.step.rows`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.rays.raycast import no_hits
from uwserver.sensors.compiled import CompiledSensor, SensorKernel, codes_of
from uwserver.step.rows import (
    AS_REPEATED,
    GROUP,
    KIND,
    NEEDS_EXACT,
    NEEDS_KEEPING,
    NEEDS_PYTHON,
    NEEDS_RATES,
    NEEDS_REPEATING,
    NEEDS_TEXTS,
    REPEATING,
    SHARE,
    WHEN_DUE,
    WRITING,
)
from uwserver.world.sensing.sensor_arrays import SensorArrays
from uwserver.world.sensing.sensor_slot import SensorSlot


class Group(NamedTuple):
    """Sensors that are due in the same ticks, every `divisor`, and read in the same round."""

    round: int
    divisor: int
    slots: Sequence[SensorSlot]


class Timetable(NamedTuple):
    """The timetable of a world, until other sensors are due.

    Attributes:
        rows: arrays of `step.rows.FORMS`, by name.
        kernels: kernels of the kinds, by their numbers.
        slots: by the number of their head.
    """

    rows: dict[str, Any]
    kernels: tuple[SensorKernel, ...]
    slots: dict[int, SensorSlot]


def groups_of(slots: Iterable[SensorSlot]) -> list[Group]:
    """Return the active sensors among some, grouped by how often they are due. Sensors that repeat readings of others come last."""
    found: dict[tuple[bool, int], list[SensorSlot]] = {}
    for slot in slots:
        if slot.active:
            found.setdefault((slot.sensor.repeats, slot.divisor), []).append(slot)
    groups, number = [], AS_REPEATED
    for (repeats, divisor), alike in sorted(found.items(), key=lambda item: item[0]):
        groups.append(Group(number if repeats else WHEN_DUE, divisor, alike))
        number += repeats
    return groups


def is_written(slot: SensorSlot) -> bool:
    """Return whether compiled code writes the readings of a sensor, including their texts."""
    return slot.is_compiled and slot.sensor.writing is not None


def is_repeated(slot: SensorSlot) -> bool:
    """Return whether compiled code makes the readings of a sensor from readings of others."""
    return bool(slot.sensor.repeated) and not slot.has_loose


def needs_of(slots: Iterable[SensorSlot]) -> int:
    """Return what these sensors need besides the compiled kernels of their kinds, as a sum of NEEDS_ flags."""
    needs = 0
    for slot in slots:
        needs |= NEEDS_RATES * slot.sensor.needs_rates
        if is_written(slot):
            needs |= NEEDS_TEXTS
            continue
        has_kernel, repeats = isinstance(slot.sensor, CompiledSensor), is_repeated(slot)
        needs |= NEEDS_EXACT * (has_kernel and slot.needs_exact)
        needs |= NEEDS_REPEATING * repeats
        in_python = (
            not (has_kernel or repeats) or slot.has_loose or any(stream.is_ready_made for stream in slot.streams)
        )
        needs |= NEEDS_PYTHON * in_python
        needs |= NEEDS_KEEPING * slot.has_loose
    return needs


class _Maker:
    """Makes the rows of a timetable."""

    def __init__(self, sensor_arrays: SensorArrays) -> None:
        """Begin with empty rows, for sensors in these arrays."""
        self._sensor_arrays = sensor_arrays
        self.kernels: list[SensorKernel] = []
        self._numbers: dict[int, int] = {}
        self.groups: list[tuple[int, ...]] = []
        self.shares: list[tuple[int, ...]] = []
        self.writings: list[tuple[int, ...]] = []
        self.repeatings: list[tuple[int, ...]] = []
        self.repeated: list[int] = []
        self.scheduled: list[int] = []
        self.members: list[int] = []

    def add(self, group: Group) -> None:
        """Add a group."""
        first, share_first = len(self.scheduled), len(self.shares)
        writing_first, repeating_first = len(self.writings), len(self.repeatings)
        by_kind: dict[int, list[int]] = {}
        for slot in group.slots:
            self.scheduled.append(slot.head)
            if isinstance(slot.sensor, CompiledSensor):
                by_kind.setdefault(self._number(slot.sensor.kernel), []).append(slot.head)
            elif is_written(slot):
                self._add_writing(slot)
            elif is_repeated(slot):
                members = [member.stream_numbers.start for member in slot.sensor.repeated]
                self.repeatings.append((slot.head, len(self.repeated), len(members)))
                self.repeated += members
        for kind, heads in by_kind.items():
            self.shares.append((kind, len(self.members), len(heads)))
            self.members += heads
        self.groups.append((
            group.divisor, 0, group.round, first, len(group.slots), sum(len(slot.streams) for slot in group.slots), needs_of(group.slots),
            share_first, len(by_kind), writing_first, len(self.writings) - writing_first,
            repeating_first, len(self.repeatings) - repeating_first,
        ))  # fmt: skip

    def _number(self, kernel: SensorKernel) -> int:
        if id(kernel) not in self._numbers:
            self._numbers[id(kernel)] = len(self.kernels)
            self.kernels.append(kernel)
        return self._numbers[id(kernel)]

    def _add_writing(self, slot: SensorSlot) -> None:
        writing, numbers = slot.sensor.writing, slot.stream_numbers
        assert writing is not None
        head = self._sensor_arrays.heads.rows[slot.head]
        self.writings.append(
            (slot.head, writing.row, numbers.start, len(numbers), int(head["first"]), int(head["width"]))
        )

    def kind(self, kernel: SensorKernel) -> tuple[int, ...]:
        """Return the row of a kind."""
        *aims, code = codes_of(kernel)
        rows = self._sensor_arrays.rows_of(kernel).rows
        return code, rows.ctypes.data, len(rows), rows.dtype.itemsize, bool(aims), *(*aims, 0, 0)[:2]


def timetable_of(groups: Sequence[Group], sensor_arrays: SensorArrays) -> Timetable:
    """Return the timetable of a world.

    Args:
        groups: in the order of a tick.
        sensor_arrays: the arrays of the sensors.
    """
    made = _Maker(sensor_arrays)
    for group in groups:
        made.add(group)
    kinds = np.array([made.kind(kernel) for kernel in made.kernels], KIND)
    heads = sensor_arrays.heads.rows
    rays, most_heads = _most_rays(made, heads)
    count = len(heads)

    def whole(values: Sequence[int]) -> IntArray:
        return np.array(values, np.int64)

    rows = {
        "groups": np.array(made.groups, GROUP),
        "kinds": kinds,
        "writings": np.array(made.writings, WRITING),
        "repeatings": np.array(made.repeatings, REPEATING),
        "repeated": whole(made.repeated),
        "shares": np.array(made.shares, SHARE),
        "scheduled": whole(made.scheduled),
        "members": whole(made.members),
        "active": np.zeros(len(made.groups), np.int64),
        "due": np.zeros(count, np.int64),
        "turns": np.zeros(count, np.int64),
        "turn": np.zeros(len(kinds), SHARE),
        "place": np.full(len(kinds), -1, np.int64),
        "origin": np.empty((rays, 3)),
        "direction": np.empty((rays, 3)),
        "first": np.zeros(most_heads + 1, np.int64),
        "past": np.zeros(rays, np.int64),
        **no_hits(rays)._asdict(),
    }
    slots = {slot.head: slot for group in groups for slot in group.slots}
    return Timetable(rows, tuple(made.kernels), slots)


def _most_rays(made: _Maker, heads: Any) -> tuple[int, int]:
    """Return the most rays that sensors of one kind cast in a tick, and the most sensors that cast them."""
    casting = [kind for kind, kernel in enumerate(made.kernels) if kernel.aims]
    rays, counts = dict.fromkeys(casting, 0), dict.fromkeys(casting, 0)
    for kind, first, count in made.shares:
        if kind in rays:
            rays[kind] += int(heads["rays"][made.members[first : first + count]].sum())
            counts[kind] += count
    return max(rays.values(), default=0), max(counts.values(), default=0)
