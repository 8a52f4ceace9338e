"""Sensors whose readings compiled code makes: all sensors of a kind are rows of arrays, and one kernel reads those that are due.

Such a kind has, in one file, its table, its fields, the record of one sensor (`record`), and the kernel
``measure(head, row, surroundings, t, out)``, which reads the world for one sensor: ``kernel = SensorKernel(RECORD, loop(measure))``, or
`ray_loop` if it casts rays.

`measure` asks the world through the functions of `uwserver.sensors.instant`. A reading is valid, and of this instant, unless `measure` sets
`valid`, `ready`, `delay_ns` or `since_ns` of its head. It draws the random numbers of `head.key` and `head.number`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from msgspec import convert

from uwserver.frames import conjugate as conjugated
from uwserver.modifiers.base import Measurement, Memory, plain_of, write_record
from uwserver.modifiers.columns import Columns
from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray, Pool, Records
from uwserver.physics.kernel.deferred import Deferred, Elsewhere, compiled, entry, inlined
from uwserver.physics.kernel.random import draw_normals
from uwserver.physics.kernel.straight import address_of
from uwserver.physics.rays.raycast import Geometry, no_hits
from uwserver.ports import Json, Value
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, Settings
from uwserver.sensors.surroundings import HEAD as HEAD
from uwserver.sensors.voices import NO_VOICES

MISSING = np.nan
"""Stands for a number that a reading does not have."""
_LEAST = 16  # sensors that a thread reads at a time: about 5 us
_MOST_AIMS = 2
_LOOP = "run_"  # prefix of the name of a loop that is made of a kernel for one sensor


def _from_instant(*names: str) -> Iterator[Any]:
    """Return functions of `instant` by name. They are imported when a kernel is compiled, because `instant` imports numba."""
    return (Elsewhere("uwserver.sensors.instant", name) for name in names)


rotate, multiply, conjugate = _from_instant("rotate", "multiply", "conjugate")
quat_from_rpy, rpy_from_quat, spin = _from_instant("quat_from_rpy", "rpy_from_quat", "spin")
p_NB, q_NB, v_NB_B, w_NB_B = _from_instant("p_NB", "q_NB", "v_NB_B", "w_NB_B")
p_NS, q_NS, p_BS, q_BS, q_SB = _from_instant("p_NS", "q_NS", "p_BS", "q_BS", "q_SB")
latitude_longitude, velocity_of, specific_force = _from_instant("latitude_longitude", "velocity_of", "specific_force")
level_turns, inertial_rate = _from_instant("level_turns", "inertial_rate")
water_property, depth_of, place_of = _from_instant("water_property", "depth_of", "place_of")
gauge_pressure, water_velocity, submergence = _from_instant("gauge_pressure", "water_velocity", "submergence")
magnetic_field, nu_dot_at, tau_at, voices_of = _from_instant("magnetic_field", "nu_dot_at", "tau_at", "voices_of")
sound_absorption, ground_of, echo_of, meet_surface = _from_instant("absorption", "ground_of", "echo_of", "meet_surface")
shaft_speed, power, supply_voltage, supply = _from_instant("shaft_speed", "power", "supply_voltage", "supply")
(_team_at,) = _from_instant("team_at")
_share: Any = Elsewhere("uwserver.physics.kernel.sharing", "share")


@compiled
def begins(head: Any) -> bool:
    """Return whether a sensor that is due reads. Its reading then counts as valid and of this instant, until the kernel says otherwise."""
    head.ready, head.valid = 1 - head.silent, 1
    head.delay_ns = head.since_ns = 0
    return bool(head.silent == 0)


@inlined
def reading_of(head: Any, numbers: Array) -> Array:
    """Return the part of `numbers` into which a sensor writes its reading."""
    return numbers[head.first : head.first + head.width]


def record(parameters: list[Any], memory: list[Any] | None = None) -> np.dtype[Any]:
    """Return the record type of a sensor: parameters and settings, and its memory as ``m``. The size is padded to a multiple of 64 bits."""
    kept = ("m", np.dtype(memory or [("nothing", "i8")]))
    rest = -np.dtype([*parameters, kept]).itemsize % 8
    return np.dtype([*parameters, ("rest", "u1", (rest,)), kept] if rest else [*parameters, kept])


class SensorKernel(NamedTuple):
    """The record type and the kernels of a kind.

    A loop that aims has the arguments of `run`, and then arrays of rays to fill in: `origin` and `direction` (n, 3) in N, and `first` (m + 1), the
    number of the first ray of each sensor. The last argument is the `Hits` of the rays that these arrays held before. The loop returns how far the
    rays reach, m.

    Attributes:
        record: record type of one sensor.
        run: the loop over the sensors that are due. If there are `aims`, it gets what their last rays hit.
        aims: loops that aim rays, at most two. The second one knows what the rays of the first have hit. Rays meet the body that carries their
            sensor only if the sensor has `sees_own`.
        acts: a reading changes what other sensors read, so one thread makes all of them, in order. Otherwise threads share the loop, if the kind
            casts no rays.
    """

    record: np.dtype[Any]
    run: Deferred
    aims: tuple[Deferred, ...] = ()
    acts: bool = False


def loop(measure: Deferred) -> Deferred:
    """Return the loop of a kind that casts no rays. ``measure(head, row, surroundings, t, out)`` reads one sensor."""

    def run(heads: Array, rows: Array, numbers: Array, due: Array, surroundings: Array, t: float) -> None:
        for k in due:
            if begins(heads[k]):
                measure(heads[k], rows[heads[k].row], surroundings, t, reading_of(heads[k], numbers))

    return _named_as(run, measure, _LOOP)


def ray_loop(measure: Deferred) -> Deferred:
    """Return the loop of a kind that casts rays. ``measure(head, row, surroundings, t, out, direction, begin, end, hits)`` gets rays
    `begin` to `end`."""

    def run(
        heads: Array, rows: Array, numbers: Array, due: Array, surroundings: Array, t: float, direction: Array, first: Array, hits: Any
    ) -> None:  # fmt: skip
        for n, k in enumerate(due):
            head = heads[k]
            if head.ready != 0:
                out = reading_of(head, numbers)
                measure(head, rows[head.row], surroundings, t, out, direction, first[n], first[n + 1], hits)

    return _named_as(run, measure, _LOOP)


def aim_loop(aim: Deferred) -> Deferred:
    """Return the loop that aims the rays of a kind. ``aim(head, row, surroundings, t, origin, direction, count)`` writes the rays of one sensor from
    number `count` on, and returns the number of rays so far and how far its own rays reach, m."""

    def aim_all(
        heads: Array, rows: Array, numbers: Array, due: Array, surroundings: Array, t: float, origin: Array, direction: Array, first: Array, hits: Any
    ) -> float:  # fmt: skip
        count, reach = 0, 0.0
        for n, k in enumerate(due):
            head = heads[k]
            first[n] = count
            if begins(head):
                count, far = aim(head, rows[head.row], surroundings, t, origin, direction, count)
                reach = max(reach, far)
        first[len(due)] = count
        return reach

    return _named_as(aim_all, aim, _LOOP)


def _named_as(function: Any, written: Deferred, prefix: str = "") -> Deferred:
    """Return an entry with a name of its own in the cache. Errors report the place of the function that was written for the kind."""
    code = written.py_func.__code__
    function.__code__ = function.__code__.replace(co_filename=code.co_filename, co_firstlineno=code.co_firstlineno)
    function.__module__, function.__qualname__ = written.py_func.__module__, prefix + written.py_func.__qualname__
    return entry(function)


@cache
def _shared(run: Deferred) -> Any:
    """Return the loop over the sensors that are due, shared by threads."""
    part = Deferred(run.py_func, "compiled")

    @compiled
    def read_range(
        first: int,
        end: int,
        me: int,
        heads: Array,
        rows: Array,
        numbers: Array,
        due: Array,
        surroundings: Array,
        t: float,
    ) -> None:
        part(heads, rows, numbers, due[first:end], surroundings, t)

    def read_all(heads: Array, rows: Array, numbers: Array, due: Array, surroundings: Array, t: float) -> None:
        _share(_team_at(surroundings), read_range, (heads, rows, numbers, due, surroundings, t), len(due), _LEAST)

    return _named_as(read_all, run).made()


@cache
def _aiming(aim: Deferred) -> Any:
    """Return a loop that aims, and that returns a float even if its author returns an int."""
    part = Deferred(aim.py_func, "compiled")

    def aim_all(
        heads: Array, rows: Array, numbers: Array, due: Array, surroundings: Array, t: float, origin: Array, direction: Array, first: Array, hits: Any
    ) -> float:  # fmt: skip
        return float(part(heads, rows, numbers, due, surroundings, t, origin, direction, first, hits))

    return _named_as(aim_all, aim).made()


def loops_of(kernel: SensorKernel) -> tuple[Any, ...]:
    """Return the compiled loops of a kind: those that aim, then `run`."""
    run = kernel.run.made() if kernel.aims or kernel.acts else _shared(kernel.run)
    return (*(_aiming(aim) for aim in kernel.aims), run)


@cache
def load(kernel: SensorKernel) -> None:
    """Load the loops of a kind, from the cache or by compiling them, so that no tick waits for them.

    Raises:
        RuntimeError: numba cannot compile a loop (the text says where it is and why), or there are too many loops that aim.
    """
    none, rays = np.zeros(0, np.int64), np.empty((0, 3))
    given = np.zeros(0, HEAD), np.zeros(0, kernel.record), np.empty(0), none, np.zeros((0, 2), np.int64), 0.0
    hit = (rays, none, no_hits(0))
    if len(kernel.aims) > _MOST_AIMS:
        where = kernel.run.py_func.__code__.co_filename
        raise RuntimeError(f"{where}: {len(kernel.aims)} loops that aim, at most {_MOST_AIMS} are possible")
    rest = (*((rays, *hit) for _ in kernel.aims), hit if kernel.aims else ())
    for written, made, more in zip((*kernel.aims, kernel.run), loops_of(kernel), rest, strict=True):
        try:
            made.load(*given, *more)
        except Exception as error:  # numba may raise anything
            code = written.py_func.__code__
            place = f"{code.co_filename}:{code.co_firstlineno}"
            raise RuntimeError(
                f'{place}: numba cannot compile "{written.py_func.__qualname__.removeprefix(_LOOP)}" or what it calls: {error}'
            ) from error


def codes_of(kernel: SensorKernel) -> tuple[int, ...]:
    """Return the addresses of the loops that aim and of `run`, for kernels that call them (`kernel.calling`). They must be loaded."""
    *aims, run = loops_of(kernel)
    return (*(address_of(aim, "float64") for aim in aims), address_of(run, "none"))


def read(
    kernel: SensorKernel,
    heads: Array,
    rows: Array,
    numbers: FloatArray,
    due: IntArray,
    surroundings: IntArray,
    t: float,
    solids: Geometry,
) -> None:
    """Let sensors of a kind read outside a world. In a world `step.readings` does this.

    Args:
        kernel: the kind.
        heads, rows, numbers: the arrays of the sensors.
        due: (m) numbers of heads.
        surroundings: the table of what they see (`surroundings.FORMS`).
        t: simulation time, s.
        solids: the things that rays can hit.
    """
    *aims, run = loops_of(kernel)
    if not aims:
        run(heads, rows, numbers, due, surroundings, t)
        return
    most = int(heads["rays"][due].sum())
    (origin, direction), first, hits = np.empty((2, most, 3)), np.zeros(len(due) + 1, np.int64), no_hits(0)
    for aim in aims:
        reach, count = aim(heads, rows, numbers, due, surroundings, t, origin, direction, first, hits), int(first[-1])
        hits = solids.raycast(origin[:count], direction[:count], reach) if count else no_hits(0)
    run(heads, rows, numbers, due, surroundings, t, direction, first, hits)


class CompiledSensor(Sensor):
    """A sensor whose readings compiled code makes. Its data are rows of arrays: arrays of its own, or those of a world that it has entered.

    Attributes:
        kernel: record type and kernels of its kind.
        exact: it has no errors of its own.
        rays: most rays that it casts in a reading.
        sees_own: its rays also meet the body that carries it.
        random: names of numbers of its record that scale with its random errors, such as ``m.error``; not of errors that are drawn once and kept.
        heads, head: the array of HEAD, and its number there.
        rows, row: the array of records of its kind, and its number there.
        key: key of its random numbers; None until it is switched on.
    """

    kernel: ClassVar[SensorKernel]
    memory_type: ClassVar[type[Memory]] = Memory
    exact = sees_own = False
    rays = 0
    random: ClassVar[tuple[str, ...]] = ()

    def __init__(self, mount: Pose = Pose(), settings: Settings | None = None) -> None:  # noqa: B008 - frozen
        self.heads, self.rows = Pool(HEAD, 1), Pool(self.kernel.record, 1)
        self.head, self.row = self.heads.take(1), self.rows.take(1)
        head = self.heads.rows[self.head]
        head["p"], head["q"], head["to_S"] = mount.p, mount.q, conjugated(mount.q)
        head["exact_first"] = head["voice"] = -1
        head["exact"], head["rays"], head["sees_own"] = self.exact, self.rays, self.sees_own
        self.key: int | None = None
        if settings is not None:
            self.settings = settings

    def start(self, key: int) -> None:
        """Switch it on with the random numbers of this key."""
        self.key = key
        head, row = self.heads.rows[self.head], self.rows.rows[self.row]
        head["key"], head["number"] = key, 0
        self.fill(row)
        row["m"] = np.zeros((), self.kernel.record["m"])
        self.turn_on_row(row["m"])

    def begin(self, number: int) -> None:
        """Give the next reading this number, and so its random numbers."""
        self.heads.rows["number"][self.head] = number

    def enter(self, heads: Pool, rows: Pool) -> None:
        """Move into these arrays, with its present state."""
        head, row = heads.take(1), rows.take(1)
        heads.rows[head], rows.rows[row] = self.heads.rows[self.head], self.rows.rows[self.row]
        heads.rows["row"][head] = row
        self.heads, self.head, self.rows, self.row = heads, head, rows, row

    def leave(self) -> None:
        """Move out again, into arrays of its own."""
        heads, head, rows, row = self.heads, self.head, self.rows, self.row
        self.enter(Pool(HEAD, 1), Pool(self.kernel.record, 1))
        heads.give_back(head, 1)
        rows.give_back(row, 1)

    def fill(self, row: Any) -> None:
        """Write parameters and settings into the record."""

    def turn_on_row(self, memory: Any) -> None:
        """Write the memory at the start of a run into the record."""

    def drawn(self, count: int) -> FloatArray:
        """Return (count) normal numbers for the start of a run."""
        return draw_normals(self.key or 0, count)

    @property
    def memory(self) -> Memory:
        """The memory of its record."""
        return self.memory_of(self.rows.rows[self.row]["m"])

    @memory.setter
    def memory(self, memory: Memory) -> None:
        write_record(self.rows.rows[self.row]["m"], memory)

    def memory_of(self, row: Any) -> Memory:
        """Return the memory that a record holds.

        Raises:
            ValueError: a value is outside the limits of its type.
        """
        return convert(plain_of(row, self.memory_type), self.memory_type)

    def change(self, args: Mapping[str, Json]) -> None:
        """Change settings: all of them, or none. See `Sensor.change`."""
        super().change(args)
        self.fill(self.rows.rows[self.row])

    def loose(self, *, exactly: bool) -> tuple[Value, ...]:
        """Return the values of its last reading that are no numbers (`Columns.loose`); with `exactly`, those of the reading without errors."""
        return ()

    def voices(self) -> Records:
        """Return (n) VOICE: its own voice and those that it may hear, if it sends sound."""
        return NO_VOICES

    def sense(self, scope: Scope) -> Measurement | None:
        """Return a reading outside a world."""
        from uwserver.sensors.surroundings import ScopeArrays

        if self.key is None:
            self.start(0)
        columns, there = Columns(self.fields), ScopeArrays(scope, self.voices())
        numbers, heads, rows = np.zeros(max(1, columns.width)), Pool(HEAD, 1), Pool(self.kernel.record, 1)
        heads.rows[0], rows.rows[0] = self.heads.rows[self.head], self.rows.rows[self.row]
        head = heads.rows[0]
        head["row"] = head["body"] = head["first"] = head["voice"] = 0
        head["width"], head["dt"] = columns.width, self.dt
        solids = (scope if self.sees_own else scope.without_own_body()).geometry
        read(self.kernel, heads.rows, rows.rows, numbers, np.zeros(1, np.int64), there.table, scope.t, solids)
        self.rows.rows[self.row] = rows.rows[0]
        if not head["ready"]:
            return None
        self.heads.rows["number"][self.head] += 1
        values = [*columns.unpack(numbers[: columns.width], self.loose(exactly=False))]
        reading = Measurement(values, bool(head["valid"]))
        reading.delay_ns, reading.since_ns = int(head["delay_ns"]), int(head["since_ns"])
        return reading


_Config = TypeVar("_Config", bound=SensorTable)


class TableSensor(CompiledSensor, Generic[_Config]):
    """A compiled sensor that keeps its table. If the table has the key `ideal`, it decides whether the sensor is exact."""

    def __init__(self, mount: Pose, config: _Config, settings: Settings | None = None) -> None:
        self._config, self.exact = config, getattr(config, "ideal", self.exact)
        super().__init__(mount, settings)
