"""The arrays of all sensors of a world, and what compiled code needs to read the sensors and deliver their samples."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from uwserver.environment.acoustics.boundaries import Sediment
from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.modifiers.operations import OPERATION
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import FloatArray, IntArray, Pool
from uwserver.physics.rays.raycast import Geometry
from uwserver.ports.decimation import Decimation
from uwserver.ports.sample_batch import SampleLog
from uwserver.sensors import Scope
from uwserver.sensors.base import Sight
from uwserver.sensors.compiled import HEAD, SensorKernel, load
from uwserver.sensors.surroundings import FORMS as SURROUNDINGS
from uwserver.sensors.surroundings import place_row, water_arrays
from uwserver.sensors.voices import VOICE
from uwserver.sensors.wiring import ELECTRIC, Wiring
from uwserver.step.streams import COUNTS, DECIMATION, ENTRY, FORMS, NEVER, NO_INTERVAL, STREAM
from uwserver.world.parts.vehicle import Vehicle
from uwserver.world.sensing.computing import Computing

_SLOTS = 64
_LOGGED, _LOGGED_NUMBERS = 4096, 1 << 17
"""Samples in a log, and numbers in it: most samples have few numbers. A log is larger if one tick needs more."""
_NONE: FloatArray = np.zeros(0)
_TOUCHING = list(SURROUNDINGS).index("touching")
"""Place of the contacts in `surroundings`."""


class Around(NamedTuple):
    """What sensors see besides water: bodies by name, the place of N on the Earth, solids, the backscatter of their materials, the bottom's
    layers, and what cameras see."""

    vehicles: Mapping[str, Vehicle]
    earth: Earth
    solids: Geometry
    lambert: FloatArray
    sediments: tuple[Sediment, ...] = ()
    sight: Sight | None = None


class SensorArrays:
    """The rows of all sensors. Other parts decide which sensors there are; this class knows where their rows are.

    Attributes:
        surroundings: addresses of the arrays that sensors see (`sensors.surroundings`).
        table: addresses of the arrays of the sensors themselves (`step.streams.FORMS`).
        heads, streams, operations, numbers: those of all sensors (`sensors.compiled`, `step.streams`, `modifiers.operations`).
        voices: voices of all sonars (`sensors.voices`).
        nu_dot, tau: (n, 6) of the bodies, made in ticks in which a sensor needs them: see `Hydrodynamics.rates_of_change`.
        next_ns: time at which the next sample in flight arrives.
        roused: sensors that have something to report, whatever their rate (`Sensor.rouse`).
        loose_count: how many samples of the last tick have values that are no numbers.
        log, logged: samples that were read lately, and how many places of the log are taken.
        computing: computes readings that take time.
        is_read: whether anything reads samples.
    """

    surroundings: IntArray
    table: IntArray

    def __init__(self, hydro: Hydrodynamics, water: Water, around: Callable[[], Around]) -> None:
        """Begin without sensors, in a world with these bodies and this water; `around` gives everything else that sensors see."""
        from uwserver.step import delivery

        delivery.load()
        self._hydro, self._water, self._around, self.computing = hydro, water, around, Computing()
        self.heads, self.streams, self.operations, self.numbers = (
            Pool(HEAD), Pool(STREAM), Pool(OPERATION), Pool(np.float64),
        )  # fmt: skip
        self.voices = Pool(VOICE)
        self._records: dict[int, Pool] = {}
        self.is_read = True
        self.roused: dict[Any, None] = {}  # slots, whose class imports this module
        self._pending, self._delivered = np.zeros(_SLOTS, ENTRY), np.zeros(_SLOTS, ENTRY)
        self._free, self._counts = np.arange(_SLOTS), np.zeros(1, COUNTS)
        self._counts_as_int64 = self._counts.view(np.int64)  # An array of int64 is quicker to read than a record.
        self._values, self._delivered_values = np.zeros((_SLOTS, 1)), np.zeros((_SLOTS, 1))
        self._loose, self._decimations = np.zeros(_SLOTS, np.int64), np.zeros(0, DECIMATION)
        self.next_ns, self.loose_count, self._in_flight = NEVER, 0, 0
        self.log, self.logged = SampleLog(np.zeros(0, ENTRY), np.zeros(0)), 0
        self._log_room = 0
        self.gather(())

    def rows_of(self, kernel: SensorKernel) -> Pool:
        """Return the pool of the records of a kind, and load its kernels."""
        if id(kernel) not in self._records:
            load(kernel)
            self._records[id(kernel)] = Pool(kernel.record)
        return self._records[id(kernel)]

    def gather(self, wirings: Iterable[Wiring]) -> None:
        """Find all arrays again. Called after sensors or bodies were added or removed."""
        hydro, around = self._hydro, self._around()
        self.nu_dot, self.tau = np.zeros((len(hydro), 6)), np.zeros((len(hydro), 6))
        self._place = place_row(self._water, around.earth)
        electrics: Any = np.zeros(len(hydro.thrusters), ELECTRIC)
        for wiring in wirings:
            wiring.fill(electrics)
        self._visible = {
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
        self._tabulate_visible()
        self._make_room(0, int(self.streams.rows["width"].max(initial=0)))
        self._tabulate()

    def _tabulate_visible(self) -> None:
        self._visible["touching"] = self._hydro.touching.table
        self.surroundings = layout.addresses(SURROUNDINGS, self._visible)

    def follow_contacts(self) -> None:
        """Find the contacts of the world again, as their array moves when it grows. `surroundings` itself stays where it is, because others have its
        address."""
        self._visible["touching"] = table = self._hydro.touching.table
        self.surroundings[_TOUCHING] = table.ctypes.data, len(table)

    def move(self, place: Callable[[Any], Any]) -> None:
        """Move everything that a tick writes to other memory, after the rows of the bodies: `place` returns a copy of an array there."""
        for pool in (self.heads, *self._records.values(), self.streams, self.operations, self.numbers, self.voices):
            pool.move(place)
        self._counts, self._pending, self._free = place(self._counts), place(self._pending), place(self._free)
        self._counts_as_int64 = self._counts.view(np.int64)
        self._values, self._delivered, self._delivered_values = (
            place(self._values),
            place(self._delivered),
            place(self._delivered_values),
        )
        self.nu_dot, self.tau, self._place = place(self.nu_dot), place(self.tau), place(self._place)
        own = {"nu_dot": self.nu_dot, "tau": self.tau, "place": self._place, "voices": self.voices.rows}
        self._visible |= own | {name: getattr(self._hydro, name) for name in ("state", "bodies", "thrusters")}
        self._tabulate_visible()
        self._tabulate()
        self.surroundings, self.table = place(self.surroundings), place(self.table)

    def _tabulate(self) -> None:
        rows = {
            "heads": self.heads.rows,
            "streams": self.streams.rows,
            "operations": self.operations.rows,
            "numbers": self.numbers.rows,
            "pending": self._pending,
            "free": self._free,
            "delivered": self._delivered,
            "decimations": self._decimations,
            "loose": self._loose,
            "log": self.log.entries,
            "log_numbers": self.log.numbers,
            "counts": self._counts,
            "team": self._hydro.team,
        }
        self._kept, self._delivered_table = rows, self._delivered.view(np.int64).reshape(-1, ENTRY.itemsize // 8)
        self.table = layout.addresses(FORMS, rows)

    def _make_room(self, needed: int, width: int = 0) -> None:
        """Have room for `needed` samples, in flight or delivered, of up to `width` numbers each."""
        room, wide = self._values.shape
        if needed <= room and width <= wide:
            return
        if width > wide:
            self._log_room = 0  # The present log has room for narrower samples only.
        more, wide = (room if needed <= room else needed + needed // 4), max(wide, width)
        self._pending, self._delivered = _grown(self._pending, more), _grown(self._delivered, more)
        self._values, self._delivered_values = (
            _grown(self._values, more, wide),
            _grown(self._delivered_values, more, wide),
        )
        self._free = np.concatenate([self._free, np.arange(room, more)])
        self._loose = _grown(self._loose, more)  # In a tick, sensors measure in several rounds.
        self._tabulate()

    def in_flight(self) -> tuple[int, Any, FloatArray]:
        """Return how many samples were ever in flight, the ENTRY of each that is in flight now, in the order of delivery, and their numbers
        one after the other."""
        entries = self._pending[: self._in_flight]
        if not len(entries):
            return int(self._counts["order"][0]), entries, _NONE
        entries = entries[np.lexsort((entries["order"], entries["t_sent_ns"]))]
        values = self._values[entries["slot"]]
        return int(self._counts["order"][0]), entries, values[self._number_mask(entries, values.shape[1])]

    def _number_mask(self, entries: Any, width: int) -> Any:
        """Return a mask (n, width) of the numbers that belong to each of n entries, in rows of that width."""
        return np.arange(width) < self.streams.rows["width"][entries["stream"]][:, None]

    def put_in_flight(self, order: int, entries: Any, numbers: FloatArray) -> None:
        """Put these samples in flight, and no others; the arguments are as `in_flight` returns them."""
        n = len(entries)
        self._make_room(n)
        self._free[:] = np.arange(len(self._free))
        self._pending[:n] = entries
        self._pending["slot"][:n] = np.arange(n)
        self._values[:n][self._number_mask(entries, self._values.shape[1])] = numbers
        self._in_flight = n
        self._counts["pending"], self._counts["delivered"], self._counts["order"] = n, 0, order
        self._counts["next_ns"] = self.next_ns = int(entries["t_sent_ns"][0]) if n else NEVER

    def arriving(self, t_ns: int) -> list[tuple[int, int, int]]:
        """Return place, stream and number of each sample in flight that is due at a time."""
        entries = self._pending[: self._in_flight]
        places = np.flatnonzero(entries["t_sent_ns"] <= t_ns)
        return list(
            zip(places.tolist(), entries["stream"][places].tolist(), entries["seq"][places].tolist(), strict=True)
        )

    def invalidate(self, place: int) -> None:
        """Mark the sample in flight at a place as invalid. Places hold until other samples are added or removed."""
        self._pending["valid"][place] = 0

    def lose(self, is_lost: Callable[[int, int], bool]) -> None:
        """Remove samples in flight, chosen by stream and number. Called between two deliveries."""
        order, entries, numbers = self.in_flight()
        stays = np.array([not is_lost(k, n) for k, n in entries[["stream", "seq"]].tolist()], bool)
        if not stays.all():
            widths = self.streams.rows["width"][entries["stream"]]
            self.put_in_flight(order, entries[stays], numbers[np.repeat(stays, widths)])

    def forget_newest(self) -> None:
        """Forget the newest samples, as the time was set and they belong to another time."""
        self.streams.rows["newest"] = self.streams.rows["unordered"] = 0

    def decimate(self, decimations: Mapping[int, Collection[Decimation]]) -> None:
        """Let only those samples of these streams (by number) be read that one of their decimations takes. Of all other streams, every
        sample is read."""
        rows = self.streams.rows
        rows["decimation_count"] = 0
        if not decimations:
            return
        each_one = [(each.rate_hz, each.start_ns, NO_INTERVAL) for some in decimations.values() for each in some]
        streams, counts = list(decimations), [len(some) for some in decimations.values()]
        rows["decimation_count"][streams] = counts
        rows["decimation_first"][streams] = np.cumsum(counts) - counts
        self._decimations = np.array(each_one, DECIMATION)
        self._tabulate()

    def current_changed(self) -> None:
        """Take over the steady part of the current after a change."""
        self._place["current"] = self._water.current

    def scopes(self, t_ns: int, with_rates: bool) -> Callable[[int, Wiring | None], Scope]:
        """Return a function that gives what sensors in Python see at this instant, by the row of their body and the inside of their
        vehicle. The scope of each body is made once. `with_rates`: the accelerations have been found."""
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
        """The solids that rays can hit."""
        return self._around().solids

    def to_deliver(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the table and the two arrays of values for `delivery.deliver`. They hold until sensors are added or removed, or another
        log begins."""
        return self.table, self._values, self._delivered_values

    @property
    def room(self) -> tuple[int, int]:
        """Room for samples in flight or delivered in a tick, and room in the log. A log that nothing reads takes no samples, so its room is
        unlimited."""
        return len(self._values), self._log_room if self.is_read else NEVER

    def make_room(self, most: int) -> None:
        """Have room for the samples of a tick, at most `most`. Called between two ticks, when all samples of the first have been handed on."""
        needed = self._in_flight + most
        self._make_room(needed)
        numbers = int(self._counts["log_width"][0]) + needed * self._values.shape[1]
        if self.is_read and (self.logged + needed > self._log_room or numbers > len(self.log.numbers)):
            self._begin_log(needed)

    def take_over(self) -> None:
        """Read the counts after compiled code has delivered samples."""
        self._in_flight, _, _, self.next_ns, _, self.loose_count, self.logged, _ = self._counts_as_int64.tolist()

    def _begin_log(self, needed: int) -> None:
        """Begin another log, with room for at least `needed` samples. Readers of samples in the old log keep it alive."""
        room, numbers = max(2 * needed, _LOGGED), max(2 * needed * self._values.shape[1], _LOGGED_NUMBERS)
        self.log = SampleLog(np.zeros(room, ENTRY), np.zeros(numbers))
        self.logged, self._log_room = 0, room
        self._counts["logged"] = self._counts["log_width"] = 0
        self._tabulate()

    @property
    def loose(self) -> list[tuple[int, int, int]]:
        """Stream, number and place in the log of each sample of this tick with values that are no numbers; the place is -1 if nothing reads
        the sample."""
        entries = self._delivered_table[self._loose[: self.loose_count]].tolist()
        return [(stream, seq, slot) for _, _, stream, seq, _, _, slot in entries]


def _grown(array: Any, *shape: int) -> Any:
    """Return a larger array with a copy of an array in its corner."""
    grown = np.zeros(shape, array.dtype)
    grown[tuple(slice(extent) for extent in array.shape)] = array
    return grown
