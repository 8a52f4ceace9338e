"""Sensors of one kind as rows of a bank, which compiled code measures all at once.

A kind of a bank has, in one file, its table, its fields, the record of one sensor (`record`), and the kernel ``measure(head, row, now, t, out)``
that reads the world for one of them: ``bank = Bank(RECORD, loop(measure))``, or `ray_loop` where it casts rays.

What `measure` may ask is in `uwserver.sensors.instant`; it sets `valid`, `ready`, `delay_ns` and `since_ns` of its head where these are not those
of a valid reading of this instant, and draws the random numbers of `head.key` and `head.number`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from msgspec import convert

from uwserver.frames import conjugate as conjugated
from uwserver.modifiers.base import Measurement, Memory, plain_of, write_record
from uwserver.modifiers.columns import Columns
from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray, Records
from uwserver.physics.kernel.deferred import Deferred, Elsewhere, compiled, entry, inlined
from uwserver.physics.kernel.pool import Pool
from uwserver.physics.kernel.random import draw_normals
from uwserver.physics.kernel.straight import address_of
from uwserver.physics.rays.raycast import Geometry, no_hits
from uwserver.ports import Json, Value
from uwserver.sensors.base import Pose, Scope, Sensor, Settings
from uwserver.sensors.voices import NO_VOICES

HEAD = np.dtype(
    [
        ("body", "i8"),  # row of the body that carries it
        ("row", "i8"),  # in the bank of its kind
        ("first", "i8"),  # place of its reading among the numbers
        ("width", "i8"),
        ("exact_first", "i8"),  # place of what it would have read without errors; -1 where nobody asks
        ("stream_first", "i8"),  # its own stream, and then the others
        ("stream_count", "i8"),
        ("number", "i8"),  # readings made
        ("key", "u8"),  # of its random numbers
        ("p", "f8", (3,)),  # p_BS, m
        ("q", "f8", (4,)),  # q_BS
        ("to_S", "f8", (4,)),  # its inverse
        ("dt", "f8"),  # time between readings, s
        ("latency_ns", "i8"),
        ("exact", "i8"),  # 1: it has no errors of its own
        ("silent", "i8"),  # 1: a fault keeps it from reading
        ("rays", "i8"),  # how many it casts at most at a time
        ("sees_own", "i8"),  # 1: these meet what carries it, too
        ("voice", "i8"),  # row of its voice among those of all sonars; -1 of who sends no sound
        ("shadow", "i8"),  # 1: it is only asked what it would read without errors, and must act on nothing
        # Of the last reading, as `modifiers.Measurement`:
        ("ready", "i8"),  # 0: it had none to give
        ("valid", "i8"),
        ("exact_valid", "i8"),
        ("delay_ns", "i8"),
        ("since_ns", "i8"),
    ]
)
"""What the rows of all kinds have."""

MISSING = np.nan
"""A number that a reading does not have."""


def _seen(*names: str) -> Iterator[Any]:
    """Questions to the world by their names in `instant`, which needs numba to be imported."""
    return (Elsewhere("uwserver.sensors.instant", name) for name in names)


rotate, multiply, conjugate = _seen("rotate", "multiply", "conjugate")
quat_from_rpy, rpy_from_quat, spin = _seen("quat_from_rpy", "rpy_from_quat", "spin")
p_NB, q_NB, v_NB_B, w_NB_B = _seen("p_NB", "q_NB", "v_NB_B", "w_NB_B")
p_NS, q_NS, p_BS, q_BS, q_SB = _seen("p_NS", "q_NS", "p_BS", "q_BS", "q_SB")
latitude_longitude, velocity_of, specific_force = _seen("latitude_longitude", "velocity_of", "specific_force")
level_turns, inertial_rate = _seen("level_turns", "inertial_rate")
water_property, depth_of, place_of = _seen("water_property", "depth_of", "place_of")
gauge_pressure, water_velocity, submergence = _seen("gauge_pressure", "water_velocity", "submergence")
magnetic_field, nu_dot_at, tau_at, voices_of = _seen("magnetic_field", "nu_dot_at", "tau_at", "voices_of")
sound_absorption, ground_of, echo_of, meet_surface = _seen("absorption", "ground_of", "echo_of", "meet_surface")
shaft_speed, power, supply_voltage, supply = _seen("shaft_speed", "power", "supply_voltage", "supply")
(_team_at,) = _seen("team_at")
_share: Any = Elsewhere("uwserver.physics.kernel.sharing", "share")
_LEAST = 16  # sensors that a thread reads at a time: some 5 us
_MOST_AIMS = 2
_LOOP = "run_"  # how the names of loops begin that are made of what reads one sensor


@compiled
def begins(head: Any) -> bool:
    """Whether a sensor that is due reads; its reading is then valid and of this instant, unless it says otherwise."""
    head.ready, head.valid = 1 - head.silent, 1
    head.delay_ns = head.since_ns = 0
    return bool(head.silent == 0)


@inlined
def reading_of(head: Any, numbers: Array) -> Array:
    """Where it writes its reading."""
    return numbers[head.first : head.first + head.width]


def record(parameters: list[Any], memory: list[Any] | None = None) -> np.dtype[Any]:
    """The record of a sensor: parameters and settings, and as ``m`` what it remembers from reading to reading. In whole numbers of 64 bits."""
    kept = ("m", np.dtype(memory or [("nothing", "i8")]))
    rest = -np.dtype([*parameters, kept]).itemsize % 8
    return np.dtype([*parameters, ("rest", "u1", (rest,)), kept] if rest else [*parameters, kept])


class Bank(NamedTuple):
    """What a kind gives its bank.

    A loop that aims gets what `run` gets, and after it arrays of rays to fill in: `origin` and `direction` (n, 3) in N, and `first` (m + 1), the
    ray with which those of each sensor begin; then `Hits` of the rays that were in these arrays before. It returns how far the rays reach, m.

    Attributes:
        record: of one sensor.
        run: the loop over those that are due; where there are `aims`, with what their last rays hit.
        aims: loops that cast rays, two at most, each after what those of the one before have hit. What carries a sensor is seen by those alone whose
            `sees_own` says so.
        acts: a reading changes what others read: one thread makes them all, in their order. Else, and where no rays are cast, threads share the loop.
    """

    record: np.dtype[Any]
    run: Deferred
    aims: tuple[Deferred, ...] = ()
    acts: bool = False


def loop(measure: Deferred) -> Deferred:
    """The loop over those that are due, of a kind that casts no rays: ``measure(head, row, now, t, out)`` reads one of them."""

    def run(heads: Array, rows: Array, numbers: Array, due: Array, now: Array, t: float) -> None:
        for k in due:
            if begins(heads[k]):
                measure(heads[k], rows[heads[k].row], now, t, reading_of(heads[k], numbers))

    return _named_as(run, measure, _LOOP)


def ray_loop(measure: Deferred) -> Deferred:
    """The same of a kind that has cast rays, those from `begin` to `end`: ``measure(head, row, now, t, out, direction, begin, end, hits)``."""

    def run(
        heads: Array, rows: Array, numbers: Array, due: Array, now: Array, t: float, direction: Array, first: Array, hits: Any
    ) -> None:  # fmt: skip
        for n, k in enumerate(due):
            head = heads[k]
            if head.ready != 0:
                out = reading_of(head, numbers)
                measure(head, rows[head.row], now, t, out, direction, first[n], first[n + 1], hits)

    return _named_as(run, measure, _LOOP)


def aim_loop(aim: Deferred) -> Deferred:
    """The loop that aims, of a kind whose ``aim(head, row, now, t, origin, direction, count)`` lays the rays of one sensor, beginning with that
    number; it returns how many rays there are then, and how far these reach, m."""

    def aim_all(
        heads: Array, rows: Array, numbers: Array, due: Array, now: Array, t: float, origin: Array, direction: Array, first: Array, hits: Any
    ) -> float:  # fmt: skip
        count, reach = 0, 0.0
        for n, k in enumerate(due):
            head = heads[k]
            first[n] = count
            if begins(head):
                count, far = aim(head, rows[head.row], now, t, origin, direction, count)
                reach = max(reach, far)
        first[len(due)] = count
        return reach

    return _named_as(aim_all, aim, _LOOP)


def _named_as(function: Any, written: Deferred, prefix: str = "") -> Deferred:
    """An entry with a name of its own in the cache, and the place of what was written for its kind, of which faults tell."""
    code = written.py_func.__code__
    function.__code__ = function.__code__.replace(co_filename=code.co_filename, co_firstlineno=code.co_firstlineno)
    function.__module__, function.__qualname__ = written.py_func.__module__, prefix + written.py_func.__qualname__
    return entry(function)


@cache
def _shared(run: Deferred) -> Any:
    """The loop over those that are due, which threads share."""
    part = Deferred(run.py_func, "compiled")

    @compiled
    def read_range(
        first: int, end: int, me: int, heads: Array, rows: Array, numbers: Array, due: Array, now: Array, t: float
    ) -> None:
        part(heads, rows, numbers, due[first:end], now, t)

    def read_all(heads: Array, rows: Array, numbers: Array, due: Array, now: Array, t: float) -> None:
        _share(_team_at(now), read_range, (heads, rows, numbers, due, now, t), len(due), _LEAST)

    return _named_as(read_all, run).made()


@cache
def _aiming(aim: Deferred) -> Any:
    """A loop that aims, and says how far as a float whatever its author wrote."""
    part = Deferred(aim.py_func, "compiled")

    def aim_all(
        heads: Array, rows: Array, numbers: Array, due: Array, now: Array, t: float, origin: Array, direction: Array, first: Array, hits: Any
    ) -> float:  # fmt: skip
        return float(part(heads, rows, numbers, due, now, t, origin, direction, first, hits))

    return _named_as(aim_all, aim).made()


def kernels(bank: Bank) -> tuple[Any, ...]:
    """Its loops, as numba has made them."""
    run = bank.run.made() if bank.aims or bank.acts else _shared(bank.run)
    return (*(_aiming(aim) for aim in bank.aims), run)


@cache
def load(bank: Bank) -> None:
    """Have its loops ready, compiled or from the cache, so that no tick waits for them.

    Raises:
        RuntimeError: numba cannot compile one; the text says where it stands and why. Or there are too many.
    """
    none, rays = np.zeros(0, np.int64), np.empty((0, 3))
    given = np.zeros(0, HEAD), np.zeros(0, bank.record), np.empty(0), none, np.zeros((0, 2), np.int64), 0.0
    hit = (rays, none, no_hits(0))
    if len(bank.aims) > _MOST_AIMS:
        where = bank.run.py_func.__code__.co_filename
        raise RuntimeError(f"{where}: {len(bank.aims)} loops that aim, {_MOST_AIMS} are possible")
    rest = (*((rays, *hit) for _ in bank.aims), hit if bank.aims else ())
    for written, kernel, more in zip((*bank.aims, bank.run), kernels(bank), rest, strict=True):
        try:
            kernel.load(*given, *more)
        except Exception as error:  # numba lets pass whatever its own code raises
            code = written.py_func.__code__
            place = f"{code.co_filename}:{code.co_firstlineno}"
            raise RuntimeError(
                f'{place}: numba cannot compile "{written.py_func.__qualname__.removeprefix(_LOOP)}" or what it calls: {error}'
            ) from error


def codes_of(bank: Bank) -> tuple[int, ...]:
    """Where the code of its loops lies that aim, and of the last one, once they are loaded, for kernels that call it (`kernel.calling`)."""
    *aims, run = kernels(bank)
    return (*(address_of(aim, "float64") for aim in aims), address_of(run, "none"))


def read(
    bank: Bank, heads: Array, rows: Array, numbers: FloatArray, due: IntArray, now: IntArray, t: float, solids: Geometry
) -> None:
    """Let sensors of a kind read at a time, outside a world; in one `step.readings` does.

    Args:
        bank: of the kind.
        heads, rows, numbers: arrays in which the sensors lie.
        due: (m) numbers of heads.
        now: what they see (`surroundings.FORMS`).
        t: s.
        solids: what rays can hit.
    """
    *aims, run = kernels(bank)
    if not aims:
        run(heads, rows, numbers, due, now, t)
        return
    most = int(heads["rays"][due].sum())
    (origin, direction), first, hits = np.empty((2, most, 3)), np.zeros(len(due) + 1, np.int64), no_hits(0)
    for aim in aims:
        reach, count = aim(heads, rows, numbers, due, now, t, origin, direction, first, hits), int(first[-1])
        hits = solids.raycast(origin[:count], direction[:count], reach) if count else no_hits(0)
    run(heads, rows, numbers, due, now, t, direction, first, hits)


class BankSensor(Sensor):
    """A sensor whose readings compiled code makes. It lies in arrays: its own, or those of a world that it has entered.

    Attributes:
        bank: of its kind.
        exact: it has no errors of its own.
        rays: how many it casts at most at a time.
        sees_own: whether these meet what carries it, too.
        random: numbers of its record that grow with its random errors, as ``m.error``; not those of what it draws once and keeps.
        heads, head: rows of HEAD, and its number there.
        rows, row: rows of the bank's records, and its number there.
        key: of its random numbers; None until it is switched on.
    """

    bank: ClassVar[Bank]
    memory_type: ClassVar[type[Memory]] = Memory
    exact = sees_own = False
    rays = 0
    random: ClassVar[tuple[str, ...]] = ()

    def __init__(self, mount: Pose, settings: Settings | None = None) -> None:
        self.heads, self.rows = Pool(HEAD, 1), Pool(self.bank.record, 1)
        self.head, self.row = self.heads.take(1), self.rows.take(1)
        head = self.heads.rows[self.head]
        head["p"], head["q"], head["to_S"] = mount.p, mount.q, conjugated(mount.q)
        head["exact_first"] = head["voice"] = -1
        head["exact"], head["rays"], head["sees_own"] = self.exact, self.rays, self.sees_own
        self.key: int | None = None
        if settings is not None:
            self.settings = settings

    def start(self, key: int) -> None:
        """Switch it on, with the random numbers of this key."""
        self.key = key
        head, row = self.heads.rows[self.head], self.rows.rows[self.row]
        head["key"], head["number"] = key, 0
        self.fill(row)
        row["m"] = np.zeros((), self.bank.record["m"])
        self.turn_on_row(row["m"])

    def begin(self, number: int) -> None:
        """As `Sensor.begin`."""
        self.heads.rows["number"][self.head] = number

    def enter(self, heads: Pool, rows: Pool) -> None:
        """Move into these arrays, which take it as it is."""
        head, row = heads.take(1), rows.take(1)
        heads.rows[head], rows.rows[row] = self.heads.rows[self.head], self.rows.rows[self.row]
        heads.rows["row"][head] = row
        self.heads, self.head, self.rows, self.row = heads, head, rows, row

    def leave(self) -> None:
        """Move out again, into arrays of its own."""
        heads, head, rows, row = self.heads, self.head, self.rows, self.row
        self.enter(Pool(HEAD, 1), Pool(self.bank.record, 1))
        heads.give_back(head, 1)
        rows.give_back(row, 1)

    def fill(self, row: Any) -> None:
        """Write parameters and settings into the record."""

    def turn_on_row(self, memory: Any) -> None:
        """Write into the record what is remembered at the start of a run."""

    def drawn(self, count: int) -> FloatArray:
        """(count) normal numbers for the start of a run."""
        return draw_normals(self.key or 0, count)

    @property
    def memory(self) -> Memory:
        """What it remembers."""
        return self.memory_of(self.rows.rows[self.row]["m"])

    @memory.setter
    def memory(self, memory: Memory) -> None:
        write_record(self.rows.rows[self.row]["m"], memory)

    def memory_of(self, row: Any) -> Memory:
        """What a record remembers.

        Raises:
            ValueError: outside the limits of its type.
        """
        return convert(plain_of(row, self.memory_type), self.memory_type)

    def change(self, args: Mapping[str, Json]) -> None:
        """As `Sensor.change`."""
        super().change(args)
        self.fill(self.rows.rows[self.row])

    def loose(self, *, exactly: bool) -> tuple[Value, ...]:
        """The values of its last reading that are no numbers (`Columns.loose`); `exactly`: of what it would have read without errors."""
        return ()

    def voices(self) -> Records:
        """(n) of VOICE: of one that sends sound, its own and those that it may hear."""
        return NO_VOICES

    def sense(self, scope: Scope) -> Measurement | None:
        """A reading alone, outside a world."""
        from uwserver.sensors.alone import Alone

        if self.key is None:
            self.start(0)
        columns, there = Columns(self.fields), Alone(scope, self.voices())
        numbers, heads, rows = np.zeros(max(1, columns.width)), Pool(HEAD, 1), Pool(self.bank.record, 1)
        heads.rows[0], rows.rows[0] = self.heads.rows[self.head], self.rows.rows[self.row]
        head = heads.rows[0]
        head["row"] = head["body"] = head["first"] = head["voice"] = 0
        head["width"], head["dt"] = columns.width, self.dt
        solids = (scope if self.sees_own else scope.without_own_body()).geometry
        read(self.bank, heads.rows, rows.rows, numbers, np.zeros(1, np.int64), there.table, scope.t, solids)
        self.rows.rows[self.row] = rows.rows[0]
        if not head["ready"]:
            return None
        self.heads.rows["number"][self.head] += 1
        values = [*columns.unpack(numbers[: columns.width], self.loose(exactly=False))]
        reading = Measurement(values, bool(head["valid"]))
        reading.delay_ns, reading.since_ns = int(head["delay_ns"]), int(head["since_ns"])
        return reading
