"""The arrays in which all sensors of a world lie, and the calls of compiled code that read and deliver them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.modifiers.operations import OPERATION
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.pool import Pool
from uwserver.physics.rays.raycast import Geometry
from uwserver.sensors.alone import place_row, water_arrays
from uwserver.sensors.bank import HEAD, Bank, load, read
from uwserver.sensors.wiring import ELECTRIC, Wiring

_SLOTS = 64


class Around(NamedTuple):
    """What sensors see besides bodies and water: where N lies, solid things, and the backscatter of their materials."""

    earth: Earth
    solids: Geometry
    lambert: FloatArray


class Delivered(NamedTuple):
    """A sample that somebody reads: its stream, and the rest as in a `Sample`; `values` is a row of numbers."""

    stream: int
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    values: FloatArray


class Instruments:
    """Sensors as rows. Who is here is decided elsewhere; here it is known where they lie.

    Attributes:
        heads, streams, operations, numbers: of all sensors (`sensors.bank`, `world.delivery`, `modifiers.operations`).
        nu_dot, tau: (n, 6) of the bodies, where a sensor needs them: see `Hydrodynamics.rates_of_change`.
        next_ns: when the next sample on its way arrives.
        read_count: how many of the samples of this tick somebody reads in Python.
    """

    def __init__(self, hydro: Hydrodynamics, water: Water, around: Callable[[], Around]) -> None:
        """Of a world with these bodies and this water; `around` tells what else there is."""
        from uwserver.world import delivery

        self._delivery = delivery
        delivery.load()
        self._hydro, self._water, self._around = hydro, water, around
        self.heads, self.streams, self.operations, self.numbers = (
            Pool(HEAD), Pool(delivery.STREAM), Pool(OPERATION), Pool(np.float64),
        )  # fmt: skip
        self._banks: dict[int, Pool] = {}
        self._pending, self._told = np.zeros(_SLOTS, delivery.ENTRY), np.zeros(_SLOTS, delivery.ENTRY)
        self._free, self._counts = np.arange(_SLOTS), np.zeros(1, delivery.COUNTS)
        self._values, self._told_values = np.zeros((_SLOTS, 1)), np.zeros((_SLOTS, 1))
        self.next_ns, self.read_count, self._counted = delivery.NEVER, 0, (0, 0)
        self.gather(())

    def rows_of(self, bank: Bank) -> Pool:
        """Where the records of a kind lie; its kernels are then ready."""
        if id(bank) not in self._banks:
            load(bank)
            self._banks[id(bank)] = Pool(bank.record)
        return self._banks[id(bank)]

    def gather(self, wirings: Iterable[Wiring]) -> None:
        """Find all arrays again: after sensors or bodies came or went."""
        hydro, around = self._hydro, self._around()
        self.nu_dot, self.tau = np.zeros((len(hydro), 6)), np.zeros((len(hydro), 6))
        self._place = place_row(self._water, around.earth)
        electrics: Any = np.zeros(len(hydro.thrusters), ELECTRIC)
        for wiring in wirings:
            wiring.fill(electrics)
        from uwserver.sensors import instant

        self._seen = {
            "state": hydro.state,
            "nu_dot": self.nu_dot,
            "tau": self.tau,
            "bodies": hydro.bodies,
            "thrusters": hydro.thrusters,
            "electrics": electrics,
            "lags": hydro.lags,
            "place": self._place,
            "lambert": around.lambert,
            **water_arrays(self._water),
            "team": hydro.team,
        }
        self.now: IntArray = layout.addresses(instant.FORMS, self._seen)
        self._make_room(0)
        self._tabulate()

    def _tabulate(self) -> None:
        rows = {
            "heads": self.heads.rows,
            "streams": self.streams.rows,
            "operations": self.operations.rows,
            "numbers": self.numbers.rows,
            "pending": self._pending,
            "free": self._free,
            "told": self._told,
            "counts": self._counts,
            "team": self._hydro.team,
        }
        self._kept = rows
        self.table: IntArray = layout.addresses(self._delivery.FORMS, rows)

    def _make_room(self, needed: int) -> None:
        """Room for so many samples on their way or delivered, of the widest stream."""
        have, width = self._values.shape
        room = have if needed <= have else 2 * needed
        wide = max(width, int(self.streams.rows["width"].max(initial=0)))
        if (room, wide) == (have, width):
            return
        self._pending, self._told = _grown(self._pending, room), _grown(self._told, room)
        self._values, self._told_values = _grown(self._values, room, wide), _grown(self._told_values, room, wide)
        self._free = np.concatenate([self._free, np.arange(have, room)])
        self._tabulate()

    def on_their_way(self) -> tuple[int, list[tuple[int, int, int, int, int, bool, FloatArray]]]:
        """How many were on their way before, and those that are: time of delivery, order, stream, seq, t_ns, valid, numbers; sorted."""
        entries = []
        for t_sent, n, k, seq, t_ns, valid, slot in sorted(self._pending[: self._counted[0]].tolist()):
            entries.append((t_sent, n, k, seq, t_ns, valid != 0, self._values[slot].copy()))
        return int(self._counts["order"][0]), entries

    def send_on_their_way(
        self, order: int, entries: Sequence[tuple[int, int, int, int, int, bool, FloatArray]]
    ) -> None:
        """Put these on their way, and no others; sorted."""
        self._make_room(len(entries))
        self._free[:] = np.arange(len(self._free))
        for slot, (t_sent, n, k, seq, t_ns, valid, numbers) in enumerate(entries):
            self._pending[slot] = t_sent, n, k, seq, t_ns, valid, slot
            self._values[slot, : len(numbers)] = numbers
        self._counted = len(entries), 0
        self._counts["pending"], self._counts["told"], self._counts["order"] = len(entries), 0, order
        self.next_ns = entries[0][0] if entries else self._delivery.NEVER

    def newest(self, stream: int) -> Delivered | None:
        """The newest delivered sample of a stream."""
        row = self.streams.rows[stream]
        if not row["newest"]:
            return None
        numbers = self.numbers.rows[row["newest_first"] : row["newest_first"] + row["width"]].copy()
        return Delivered(stream, int(row["seq"]), int(row["t_ns"]), int(row["t_sent_ns"]), bool(row["valid"]), numbers)

    def forget_newest(self) -> None:
        """The time was set: what was read at another time does not count."""
        self.streams.rows["newest"] = 0

    def sea_moves(self) -> None:
        """The steady part of the current was changed."""
        self._place["current"] = self._water.current

    def set_time(self, t_ns: int) -> None:
        """What is read from now on belongs to this instant."""
        self._place["t_ns"] = t_ns

    def look(self, t: float) -> None:
        """Fill in `nu_dot` and `tau` at the present state."""
        self._hydro.rates_into(t, self.nu_dot, self.tau)

    def read(self, bank: Bank, due: IntArray, t: float) -> None:
        """Let sensors of a kind (numbers of heads) read the world."""
        rows = self._banks[id(bank)].rows
        read(bank, self.heads.rows, rows, self.numbers.rows, due, self.now, t, self._around().solids)

    def deliver(self, due: IntArray, t_ns: int, begins: bool, most: int) -> int:
        """See `delivery.deliver`; `most`: so many samples can come of these readings. Returns how many samples of this tick somebody reads."""
        on_their_way, told = self._counted
        self._make_room(on_their_way + most + (0 if begins else told))
        self._delivery.deliver(self.table, due, t_ns, begins, self._values, self._told_values)
        on_their_way, told, _, self.next_ns, self.read_count = self._counts.tolist()[0]
        self._counted = on_their_way, told
        return int(told)

    @property
    def delivered(self) -> tuple[Any, FloatArray]:
        """Where samples of this tick stand that somebody reads or hears: entries, and their numbers."""
        return self._told, self._told_values

    def told(self, first: int, count: int) -> list[Delivered]:
        """Samples of this tick that somebody reads, from one on."""
        entries = self._told[first:count]
        return [
            Delivered(stream, seq, t_ns, sent, valid != 0, values)
            for (sent, _, stream, seq, t_ns, valid, _), values in zip(
                entries.tolist(), self._told_values[first:count], strict=True
            )
        ]


def _grown(array: Any, *shape: int) -> Any:
    """A copy of an array in the corner of a larger one."""
    grown = np.zeros(shape, array.dtype)
    grown[tuple(slice(extent) for extent in array.shape)] = array
    return grown
