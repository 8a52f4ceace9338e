"""When which sensors of the copies measure: all copies that are due for the same sensors in one call a kind."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from uwserver.copies.clocks import Clocks
from uwserver.copies.copy import Copy
from uwserver.copies.ranges import Ranges
from uwserver.copies.tables import Tables
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import Fitted
from uwserver.physics.rays.raycast import no_hits
from uwserver.sensors.bank import Bank, BankSensor
from uwserver.sensors.onboard.battery import Battery
from uwserver.world.sensor_slot import SensorSlot


class _Read(NamedTuple):
    """Sensors of one kind that read together: the compiled loop, their records' tables, and what else the loop takes in each range of copies."""

    loop: Any
    rows: IntArray
    more: tuple[tuple[Any, ...], ...]


class _Round(NamedTuple):
    """Sensors that read together, as in `world.sensing`.

    Attributes:
        reads: by kind.
        heads: numbers of all.
        needs_rates: whether one of them needs accelerations.
        exactly: those that also tell what they would read without errors.
    """

    reads: tuple[_Read, ...]
    heads: IntArray
    needs_rates: bool
    exactly: tuple[str, ...]


class Rounds:
    """The sensors of all copies. They are alike, so those of the first copy say which there are.

    Attributes:
        measured: paths of the sensors that measure.
    """

    def __init__(self, copies: Sequence[Copy], tables: Tables, ranges: Ranges, sensors: Collection[str] | None) -> None:
        """Let sensors of these paths measure, and those that decide how the run goes on; None for all."""
        from uwserver.copies import kernels, loops

        self._kernels, self._loops = kernels, loops
        self._copies, self._tables, self._ranges = copies, tables, ranges
        heard = {port for pilot in copies[0].pilots for port in pilot.craft.hearing.ports}
        slots = [
            slot
            for slot in copies[0].world.sensors.values()
            if isinstance(slot.sensor, BankSensor) and (sensors is None or slot.path in sensors or _acts(slot, heard))
        ]
        self.measured = tuple(slot.path for slot in slots)
        by_divisor: dict[int, list[SensorSlot]] = {}
        for slot in slots:
            by_divisor.setdefault(slot.divisor, []).append(slot)
        self._groups = sorted(by_divisor.items())
        self._divisors: IntArray = np.array([divisor for divisor, _ in self._groups], np.int64)
        self._most = sum(len(slot.streams) for slot in slots)
        self._rounds: dict[int, _Round] = {}
        first = copies[0].world.hydro
        self._has_sea = first.sea is not None
        self._look = kernels.look_fitted if is_fitted(first) else kernels.look
        n = len(copies)
        self.told: IntArray = np.zeros((n, 3), np.int64)
        self.forget(np.arange(n))

    def forget(self, which: IntArray) -> None:
        """These copies are at their start: nothing is on its way."""
        self.told[which] = 0
        self.told[which, 2] = np.iinfo(np.int64).max

    def make_room(self, which: IntArray) -> None:
        """Let these copies have room for what they may have on its way after a tick, and for some more."""
        self._tables.make_room(int(self.told[which, 1].max()) + self._most)

    def has_room(self, which: IntArray) -> bool:
        """Whether these have, for another tick."""
        return int(self.told[which, 1].max()) + self._most <= self._tables.room

    def measure(self, which: IntArray, clocks: Clocks, me: int) -> None:
        """Let sensors of these copies read that are due, and deliver; by the thread `me`."""
        due, masks = np.empty((2, len(which)), np.int64)
        count = self._kernels.find_due(which, clocks, self._divisors, self.told, self._tables.nows, due, masks)
        if count > 0:
            self._measure(due[:count], int(masks[0]), clocks, me)
        elif count < 0:
            due, masks = due[: -1 - count], masks[: -1 - count]
            for mask in np.unique(masks).tolist():
                self._measure(due[masks == mask], mask, clocks, me)

    def _measure(self, which: IntArray, mask: int, clocks: Clocks, me: int) -> None:
        tables, kernels, (_, ts, t_ns, _) = self._tables, self._kernels, clocks
        due = self._rounds.get(mask) or self._round(mask)
        if due.needs_rates:
            self._look_around(which, ts, me)
        for path in due.exactly:
            for i in which.tolist():
                self._copies[i].world.sensors[path].read_exactly(float(ts[i]))
        for loop, rows, more in due.reads:
            loop(which, tables.senses, rows, tables.nows, ts, *more[me])
        told_values, told = tables.told_values, self.told
        kernels.deliver(which, tables.senses, due.heads, t_ns, True, tables.values, told_values, told)
        if self._copies[0].pilots:
            kernels.hear(which, tables.pilots, tables.senses, told_values, told, t_ns)

    def _look_around(self, which: IntArray, ts: FloatArray, me: int) -> None:
        tables = self._tables
        if self._has_sea:
            self._kernels.fill_flows(which, tables.worlds, tables.nows, ts, 0.0)
        self._look(which, tables.worlds, tables.nows, ts, me)

    def _round(self, mask: int) -> _Round:
        slots = [slot for k, (_, slots) in enumerate(self._groups) if mask >> k & 1 for slot in slots]
        banks: dict[int, tuple[Bank, list[SensorSlot]]] = {}
        for slot in slots:
            assert isinstance(slot.sensor, BankSensor)
            banks.setdefault(id(slot.sensor.bank), (slot.sensor.bank, []))[1].append(slot)
        made = self._rounds[mask] = _Round(
            tuple(self._read(bank, of_kind) for bank, of_kind in banks.values()),
            np.array([slot.head for slot in slots], np.int64),
            any(slot.sensor.needs_rates for slot in slots),
            tuple(slot.path for slot in slots if slot.wants_exact),
        )
        return made

    def _read(self, bank: Bank, slots: Sequence[SensorSlot]) -> _Read:
        due, heads = np.array([slot.head for slot in slots]), self._copies[0].world.instruments.heads.rows
        rays = int(heads["rays"][due].sum()) if bank.aims else 0
        more = tuple(
            (due, np.empty((2, rays, 3)), np.zeros(len(due) + 1, np.int64), no_hits(rays)) if bank.aims else (due,)
            for _ in range(self._ranges.count)
        )
        return _Read(self._loops.loop_of(bank), self._tables.rows[id(bank)], more)


def is_fitted(hydro: Hydrodynamics) -> bool:
    """Whether a body has appendages."""
    return any(len(getattr(hydro, name)) for name in Fitted._fields if name != "values")


def _acts(slot: SensorSlot, heard: Collection[str]) -> bool:
    """Whether what a sensor measures decides how the run goes on: a battery supplies the thrusters, and autopilots hear."""
    return isinstance(slot.sensor, Battery) or any(stream.port.path in heard for stream in slot.streams)
