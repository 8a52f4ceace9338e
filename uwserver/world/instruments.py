"""The arrays in which all sensors of a world lie, and the calls of compiled code that read and deliver them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from uwserver.environment.earth import Earth
from uwserver.environment.materials import Sediment
from uwserver.environment.water import Water
from uwserver.modifiers.operations import OPERATION
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.pool import Pool
from uwserver.physics.rays.raycast import Geometry, OpenWater
from uwserver.ports.thinning import Thinning
from uwserver.ports.told import Log
from uwserver.sensors import Scope, surroundings
from uwserver.sensors.bank import HEAD, Bank, load
from uwserver.sensors.sight import Sight
from uwserver.sensors.surroundings import place_row, water_arrays
from uwserver.sensors.voices import VOICE
from uwserver.sensors.wiring import ELECTRIC, Wiring
from uwserver.step.streams import COUNTS, ENTRY, FORMS, NEVER, NO_INTERVAL, STREAM, THINNING
from uwserver.world.computing import Computing
from uwserver.world.vehicle import Vehicle

_SLOTS, _OPEN = 64, OpenWater()
_LOGGED, _LOGGED_NUMBERS = 4096, 1 << 17
"""Samples of a log, and numbers that it has room for, as most samples are of few; more where a tick may need them."""
_NONE: FloatArray = np.zeros(0)
_TOUCHING = list(surroundings.FORMS).index("touching")
"""Place of the contacts in `now`."""


class Around(NamedTuple):
    """What sensors see besides water: bodies by name, where N lies, solid things, the backscatter of their materials, and their looks."""

    vehicles: Mapping[str, Vehicle]
    earth: Earth
    solids: Geometry
    lambert: FloatArray
    sediments: tuple[Sediment, ...] = ()
    sight: Sight | None = None


class Delivered(NamedTuple):
    """A delivered sample: its stream, and the rest as in a `Sample`; `values` is a row of numbers."""

    stream: int
    seq: int
    t_ns: int
    t_sent_ns: int
    valid: bool
    values: FloatArray


class Instruments:
    """Sensors as rows. Who is here is decided elsewhere; here it is known where they lie.

    Attributes:
        heads, streams, operations, numbers: of all sensors (`sensors.bank`, `step.streams`, `modifiers.operations`).
        voices: of all sonars (`sensors.voices`).
        nu_dot, tau: (n, 6) of the bodies, where a sensor needs them: see `Hydrodynamics.rates_of_change`.
        next_ns: when the next sample on its way arrives.
        roused: sensors that have something to tell, whatever their rate (`Sensor.rouse`).
        wordy_count: how many of the samples of the last tick have values that are no numbers.
        log: what was read of late, and `logged` how many of its places are taken.
        computing: of readings that take time.
        is_read: whether somebody reads samples.
    """

    now: IntArray
    table: IntArray

    def __init__(self, hydro: Hydrodynamics, water: Water, around: Callable[[], Around]) -> None:
        """Of a world with these bodies and this water; `around` tells what else there is."""
        from uwserver.step import delivery

        delivery.load()
        self._hydro, self._water, self._around, self.computing = hydro, water, around, Computing()
        self.heads, self.streams, self.operations, self.numbers = (
            Pool(HEAD), Pool(STREAM), Pool(OPERATION), Pool(np.float64),
        )  # fmt: skip
        self.voices = Pool(VOICE)
        self._banks: dict[int, Pool] = {}
        self.is_read = True
        self.roused: dict[Any, None] = {}  # slots, which stand above this module
        self._pending, self._told = np.zeros(_SLOTS, ENTRY), np.zeros(_SLOTS, ENTRY)
        self._free, self._counts = np.arange(_SLOTS), np.zeros(1, COUNTS)
        self._told_counts = self._counts.view(np.int64)  # quicker to look at than a record
        self._values, self._told_values, self._room = np.zeros((_SLOTS, 1)), np.zeros((_SLOTS, 1)), _SLOTS
        self._wordy, self._thinnings = np.zeros(_SLOTS, np.int64), np.zeros(0, THINNING)
        self.next_ns, self.wordy_count, self._on_their_way = NEVER, 0, 0
        self.log, self.logged = Log(np.zeros(0, ENTRY), np.zeros(0)), 0
        self._log_room = 0
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
            "voices": self.voices.rows,
        }
        self._find_seen()
        self._make_room(0, int(self.streams.rows["width"].max(initial=0)))
        self._tabulate()

    def _find_seen(self) -> None:
        self._seen["touching"] = self._hydro.touching.table
        self.now = layout.addresses(surroundings.FORMS, self._seen)

    def follow_contacts(self) -> None:
        """The contacts of the world lie elsewhere, as when there was no room for more. `now` stays where it is: others have its address."""
        self._seen["touching"] = table = self._hydro.touching.table
        self.now[_TOUCHING] = table.ctypes.data, len(table)

    def move(self, place: Callable[[Any], Any]) -> None:
        """Have all that a tick writes lie elsewhere, after the bodies' rows: `place` gives a copy of an array in other memory."""
        for pool in (self.heads, *self._banks.values(), self.streams, self.operations, self.numbers, self.voices):
            pool.move(place)
        self._counts, self._pending, self._free = place(self._counts), place(self._pending), place(self._free)
        self._told_counts = self._counts.view(np.int64)
        self._values, self._told, self._told_values = place(self._values), place(self._told), place(self._told_values)
        self.nu_dot, self.tau, self._place = place(self.nu_dot), place(self.tau), place(self._place)
        own = {"nu_dot": self.nu_dot, "tau": self.tau, "place": self._place, "voices": self.voices.rows}
        self._seen |= own | {name: getattr(self._hydro, name) for name in ("state", "bodies", "thrusters")}
        self._find_seen()
        self._tabulate()
        self.now, self.table = place(self.now), place(self.table)

    def _tabulate(self) -> None:
        rows = {
            "heads": self.heads.rows,
            "streams": self.streams.rows,
            "operations": self.operations.rows,
            "numbers": self.numbers.rows,
            "pending": self._pending,
            "free": self._free,
            "told": self._told,
            "thinnings": self._thinnings,
            "wordy": self._wordy,
            "log": self.log.entries,
            "log_numbers": self.log.numbers,
            "counts": self._counts,
            "team": self._hydro.team,
        }
        self._kept, self._told_table = rows, self._told.view(np.int64).reshape(-1, ENTRY.itemsize // 8)
        self.table = layout.addresses(FORMS, rows)

    def _make_room(self, needed: int, width: int = 0) -> None:
        """Room for so many samples on their way or delivered, of so many numbers."""
        room, wide = self._values.shape
        if needed <= room and width <= wide:
            return
        if width > wide:
            self._log_room = 0  # its numbers are for fewer
        more, wide = (room if needed <= room else needed + needed // 4), max(wide, width)
        self._pending, self._told = _grown(self._pending, more), _grown(self._told, more)
        self._values, self._told_values = _grown(self._values, more, wide), _grown(self._told_values, more, wide)
        self._free, self._room = np.concatenate([self._free, np.arange(room, more)]), more
        self._wordy = _grown(self._wordy, more)  # within a tick, sensors measure more than once
        self._tabulate()

    def on_their_way(self) -> tuple[int, Any, FloatArray]:
        """How many were on their way before; ENTRY of each that is, as they will be delivered; and their numbers, one after the other."""
        entries = self._pending[: self._on_their_way]
        if not len(entries):
            return int(self._counts["order"][0]), entries, _NONE
        entries = entries[np.lexsort((entries["order"], entries["t_sent_ns"]))]
        values = self._values[entries["slot"]]
        return int(self._counts["order"][0]), entries, values[self._used(entries, values.shape[1])]

    def _used(self, entries: Any, width: int) -> Any:
        """(n, width) which numbers of rows that wide belong to each of n entries."""
        return np.arange(width) < self.streams.rows["width"][entries["stream"]][:, None]

    def send_on_their_way(self, order: int, entries: Any, numbers: FloatArray) -> None:
        """Put these on their way, and no others; as `on_their_way` gives them."""
        n = len(entries)
        self._make_room(n)
        self._free[:] = np.arange(len(self._free))
        self._pending[:n] = entries
        self._pending["slot"][:n] = np.arange(n)
        self._values[:n][self._used(entries, self._values.shape[1])] = numbers
        self._on_their_way = n
        self._counts["pending"], self._counts["told"], self._counts["order"] = n, 0, order
        self._counts["next_ns"] = self.next_ns = int(entries["t_sent_ns"][0]) if n else NEVER

    def arriving(self, t_ns: int) -> list[tuple[int, int, int]]:
        """Place, stream and number of each sample that is on its way and due at a time."""
        entries = self._pending[: self._on_their_way]
        places = np.flatnonzero(entries["t_sent_ns"] <= t_ns)
        return list(
            zip(places.tolist(), entries["stream"][places].tolist(), entries["seq"][places].tolist(), strict=True)
        )

    def spoil(self, place: int) -> None:
        """The sample on its way in a place is invalid; until others come or go."""
        self._pending["valid"][place] = 0

    def lose(self, is_lost: Callable[[int, int], bool]) -> None:
        """Samples are lost on their way, by stream and number. Between two deliveries."""
        order, entries, numbers = self.on_their_way()
        stays = np.array([not is_lost(k, n) for k, n in entries[["stream", "seq"]].tolist()], bool)
        if not stays.all():
            widths = self.streams.rows["width"][entries["stream"]]
            self.send_on_their_way(order, entries[stays], numbers[np.repeat(stays, widths)])

    def newest(self, stream: int) -> Delivered | None:
        """The newest delivered sample of a stream."""
        row = self.streams.rows[stream]
        if not row["newest"]:
            return None
        numbers = self.numbers.rows[row["newest_first"] : row["newest_first"] + row["width"]].copy()
        return Delivered(stream, int(row["seq"]), int(row["t_ns"]), int(row["t_sent_ns"]), bool(row["valid"]), numbers)

    def forget_newest(self) -> None:
        """The time was set: what was read at another time does not count."""
        self.streams.rows["newest"] = self.streams.rows["unordered"] = 0

    def thin(self, thinned: Mapping[int, Collection[Thinning]]) -> None:
        """Choose, of the samples of these streams, by number, those alone that one of these takes; of all others each one."""
        rows = self.streams.rows
        rows["thinning_count"] = 0
        if not thinned:
            return
        each_one = [(each.rate_hz, each.start_ns, NO_INTERVAL) for some in thinned.values() for each in some]
        streams, counts = list(thinned), [len(some) for some in thinned.values()]
        rows["thinning_count"][streams] = counts
        rows["thinning_first"][streams] = np.cumsum(counts) - counts
        self._thinnings = np.array(each_one, THINNING)
        self._tabulate()

    def sea_moves(self) -> None:
        """The steady part of the current was changed."""
        self._place["current"] = self._water.current

    def scopes(self, t_ns: int, with_rates: bool) -> Callable[[int, Wiring | None], Scope]:
        """What sensors in Python see at this instant, by the row of their body and its inside; made once a body. With rates: after `look`."""
        seen: dict[int, Scope] = {}
        state, water, around = self._hydro.state, self._water, self._around()

        def scope_of(row: int, wiring: Wiring | None) -> Scope:
            scope = seen.get(row)
            if scope is None:
                x = state[row].tolist()
                scope = seen[row] = Scope(
                    t_ns, tuple(x[0:3]), tuple(x[3:7]), tuple(x[7:10]), tuple(x[10:13]), water,
                    geometry=around.solids, vehicles=around.vehicles, earth=around.earth, wiring=wiring,
                    lambert=around.lambert, sediments=around.sediments, sight=around.sight, row=row,
                )  # fmt: skip
                if with_rates:
                    scope.nu_dot, scope.tau = tuple(self.nu_dot[row].tolist()), tuple(self.tau[row].tolist())
            return scope

        return scope_of

    @property
    def solids(self) -> Geometry:
        """What rays can hit."""
        return self._around().solids

    def to_deliver(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """What `delivery.deliver` gets besides, until sensors come or go or there is another log."""
        return self.table, self._values, self._told_values

    @property
    def room(self) -> tuple[int, int]:
        """For how many samples there is some, on their way or delivered in a tick, and in the log, which takes none where nobody reads any."""
        return self._room, self._log_room if self.is_read else NEVER

    def make_room(self, most: int) -> None:
        """So many samples may come of the readings of a tick: have room for them. Between two ticks of which all is told."""
        needed = self._on_their_way + most
        if needed > self._room:
            self._make_room(needed)
        numbers = int(self._counts["log_width"][0]) + needed * self._values.shape[1]
        if self.is_read and (self.logged + needed > self._log_room or numbers > len(self.log.numbers)):
            self._begin_log(needed)

    def take_over(self) -> None:
        """Compiled code has delivered."""
        self._on_their_way, _, _, self.next_ns, _, self.wordy_count, self.logged, _ = self._told_counts.tolist()

    def _begin_log(self, needed: int) -> None:
        """Go on in another log, with room for so many samples at least; who has the samples of this one keeps it."""
        room, numbers = max(2 * needed, _LOGGED), max(2 * needed * self._values.shape[1], _LOGGED_NUMBERS)
        self.log = Log(np.zeros(room, ENTRY), np.zeros(numbers))
        self.logged, self._log_room = 0, room
        self._counts["logged"] = self._counts["log_width"] = 0
        self._tabulate()

    @property
    def wordy(self) -> list[tuple[int, int, int]]:
        """Stream and number of each sample of this tick with values that are no numbers, and its place in the log; -1 where nobody reads it."""
        entries = self._told_table[self._wordy[: self.wordy_count]].tolist()
        return [(stream, seq, slot) for _, _, stream, seq, _, _, slot in entries]


def _grown(array: Any, *shape: int) -> Any:
    """A copy of an array in the corner of a larger one."""
    grown = np.zeros(shape, array.dtype)
    grown[tuple(slice(extent) for extent in array.shape)] = array
    return grown
