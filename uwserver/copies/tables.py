"""Where the arrays of all copies lie: their tables of addresses, stacked as compiled loops want them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from uwserver.copies.copy import Copy
from uwserver.copies.memory import Memory
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Records
from uwserver.physics.kernel.layout import Forms
from uwserver.physics.kernel.team import ALONE
from uwserver.step import streams

_SLOTS = 16
_CONSTANT = ("shapes", "tables", "lags", "foils", "propellers", "weights", "derivatives", "hulls")
"""Arrays of `Hydrodynamics` that no run changes."""
_WHOLE = np.zeros(0, streams.THINNING)
_NO_LOG, _NO_NUMBERS = np.zeros(0, streams.ENTRY), np.zeros(0)
"""Copies give all samples, or none."""


class Tables:
    """Of n copies of one scenario, whose arrays are therefore alike.

    Attributes:
        worlds, nows, senses, pilots: (n, arrays, 2) tables of the bodies, of what sensors see, of the sensors, and of the autopilots.
        rows: (n, 1, 2) tables of the records of each kind of sensor, by the identity of its bank.
        drifts: (n, k, 1, 2) tables of the drifting currents; `intervals`: (k) ticks from draw to draw.
        steady: (n, 3) steady part of each current in N, m/s.
        room: for samples on their way or delivered at a time, of each copy.
        values, told_values: (n, room, width) numbers of samples on their way, and of those that compiled code hears.
    """

    def __init__(self, copies: Sequence[Copy], threads: int) -> None:
        """So many threads step them, each with work space of its own."""
        from uwserver.copies import kernels

        self._kernels = kernels
        n, first = len(copies), copies[0]
        self._memory, self._first = Memory(n, first.size), first.world
        self._scratch: Records = np.zeros(threads, layout.SCRATCH)
        self.worlds = np.empty((n, *first.world.hydro.table.shape), np.int64)
        self.nows = np.empty((n, *first.world.instruments.now.shape), np.int64)
        self.senses = np.empty((n, len(streams.FORMS), 2), np.int64)
        self.pilots = np.empty((n, *(first.pilots[0].seat.bank.table.shape if first.pilots else (0, 2))), np.int64)
        self.rows: dict[int, IntArray] = {key: np.empty((n, 1, 2), np.int64) for key in first.banks}
        sea = first.world.water.sea
        drifts = sea.drifts if sea is not None else ()
        self.drifts: IntArray = np.empty((n, len(drifts), 1, 2), np.int64)
        self.intervals: IntArray = np.array([drift.ticks for drift in drifts], np.int64)
        self.steady: FloatArray = np.empty((n, 3))
        self._own: list[dict[str, Any]] = [{} for _ in copies]
        self.width = max(1, int(first.world.instruments.streams.rows["width"].max(initial=0)))
        self.room = 0
        self.values = self.told_values = np.empty((n, 0, self.width))
        self._pending = self._told = np.empty((n, 0), streams.ENTRY)
        self._free: IntArray = np.empty((n, 0), np.int64)
        self._wordy: IntArray = np.empty((n, 0), np.int64)
        self._counts: Any = np.zeros((n, 1), streams.COUNTS)
        for i, copy in enumerate(copies):
            self.lay(i, copy)
        self.make_room(_SLOTS)

    def lay(self, i: int, copy: Copy) -> None:
        """Find the arrays of copy i, another one than before; what its ticks write comes to lie beside that of others."""
        world, instruments = copy.world, copy.world.instruments
        copy.move(self._memory.of(i))
        self.worlds[i], self.nows[i] = world.hydro.table, instruments.now
        self._share(self.worlds[i], layout.WORLD, _CONSTANT, vars(world.hydro), vars(self._first.hydro))
        self.worlds[i, list(layout.WORLD).index("scratch")] = self._scratch.ctypes.data, len(self._scratch)
        if copy.pilots:
            self.pilots[i] = copy.pilots[0].seat.bank.table
        for key, rows in self.rows.items():
            records = instruments.rows_of(copy.banks[key]).rows
            rows[i] = layout.addresses({"rows": copy.banks[key].record}, {"rows": records})
        if world.water.sea is not None:
            for k, drift in enumerate(world.water.sea.drifts):
                self.drifts[i, k] = layout.addresses(self._kernels.ENDS, {"ends": drift.ends})
        self._own[i] = {
            "heads": instruments.heads.rows,
            "streams": instruments.streams.rows,
            "operations": instruments.operations.rows,
            "numbers": instruments.numbers.rows,
            "thinnings": _WHOLE,
            "log": _NO_LOG,
            "log_numbers": _NO_NUMBERS,
            "team": ALONE,
        }
        if self.room:
            self._tabulate(i)
        self.forget(i, copy)

    @staticmethod
    def _share(
        table: IntArray, forms: Forms, names: Iterable[str], own: Mapping[str, Any], first: Mapping[str, Any]
    ) -> None:
        """Read of the first copy what no run changes and is the same there: so much less goes through the caches in a tick."""
        for k, name in enumerate(forms):
            if name in names and own[name].tobytes() == first[name].tobytes():
                table[k, 0] = first[name].ctypes.data

    def forget(self, i: int, copy: Copy) -> None:
        """Copy i is at its start: nothing is on its way, and its current is that of its world."""
        self.steady[i] = copy.world.water.current
        self._counts[i], self._free[i] = 0, np.arange(self.room)
        self._counts["next_ns"][i] = streams.NEVER

    def make_room(self, needed: int) -> None:
        """Room for so many samples on their way or delivered at a time, of each copy."""
        if needed <= self.room:
            return
        n, old, room = len(self.worlds), self.room, 2 * needed
        self._pending, self._told = _wider(self._pending, room), _wider(self._told, room)
        self.values, self.told_values = _wider(self.values, room), _wider(self.told_values, room)
        self._wordy = _wider(self._wordy, room)
        self._free = np.concatenate([self._free, np.tile(np.arange(old, room), (n, 1))], axis=1)
        self.room = room
        for i in range(n):
            self._tabulate(i)

    def _tabulate(self, i: int) -> None:
        own = {
            "pending": self._pending[i],
            "free": self._free[i],
            "told": self._told[i],
            "wordy": self._wordy[i],
            "counts": self._counts[i],
        }
        self.senses[i] = layout.addresses(streams.FORMS, {**self._own[i], **own})


def _wider(array: Any, room: int) -> Any:
    wider = np.zeros((len(array), room, *array.shape[2:]), array.dtype)
    wider[:, : array.shape[1]] = array
    return wider
