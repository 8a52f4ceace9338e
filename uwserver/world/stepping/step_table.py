"""The times of ticks, and the table that the steps of a world get (`uwserver.step.rows`): addresses of all arrays, the sensors that are due,
and the addresses of compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from uwserver.environment.water import Water
from uwserver.physics import entries
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.collision.contacts import NO_FINDING, Finding
from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.rays.raycast import Geometry
from uwserver.step import rows
from uwserver.units import NANOSECONDS
from uwserver.world.sensing.sensing import Sensing
from uwserver.world.sensing.sensor_arrays import SensorArrays
from uwserver.world.sensing.timetable import Timetable, timetable_of
from uwserver.world.stepping.piloting import Pilots

if TYPE_CHECKING:  # importing them imports numba
    from uwserver.physics.rays.casting import RayTargets
    from uwserver.physics.scene import Scene


Number = TypeVar("Number", int, IntArray)
_NO_TABLE: IntArray = np.zeros((0, 2), np.int64)
_FOUND = ("pairs", "line_first", "lines", "overlapping", "bodies", "numbers", "keys", "coefficients", "led")
LONGEST = 1024
"""Most ticks in one call of the step."""
_NO_TIMES = 0, 0, 0, 0, 0.0, 0.0


class Ticks:
    """The times at which a world stands."""

    def __init__(self, rate_hz: Fraction) -> None:
        """Take the number of ticks per second, Hz (> 0)."""
        # As integers, because arithmetic with Fractions would take as long as a sensor.
        self._parts, self._rate = rate_hz.denominator, rate_hz.numerator
        self._double_ns = 2 * NANOSECONDS * self._parts

    def time_of(self, tick: Number) -> Number:
        """Return the simulation time of a tick, or of an array of ticks, ns (rounded half up). It is computed from the number of the tick,
        never accumulated."""
        return (tick * self._double_ns + self._rate) // (2 * self._rate)

    def second(self, tick: int) -> float:
        """Return the simulation time of a tick, s."""
        return tick * self._parts / self._rate

    def first_at(self, t_ns: int) -> int:
        """Return the first tick whose time is t_ns (ns) or later."""
        return -((self._rate - 2 * self._rate * t_ns) // self._double_ns)

    def at(self, t_s: float) -> int:
        """Return the first tick at simulation time t_s (s, finite, >= 0) or later.

        A tick 1 ns earlier also counts: reported times are whole nanoseconds, and a float made of one is not exact. So the time in a status
        leads back to its own tick. (After 97 days, floats are coarser than 1 ns; then a tick two steps of a float earlier counts.)
        """
        slack_ns = max(1, math.ceil(2 * math.ulp(t_s) * NANOSECONDS))
        return max(0, self.first_at(round(t_s * NANOSECONDS) - slack_ns))


class StepTable:
    """The table of a world.

    Attributes:
        hydro, water, sensor_arrays, sensing, pilots: the parts that have the arrays.
        rate_hz: ticks per second.
        ticks: the times of the ticks.
        table: addresses, made with `step.rows.FORMS`. `rows` has the arrays by name, and keeps them alive.
        run: the state of the step (`step.rows.RUN`).
        ends: for each tick with samples, the end of its samples in the log.
        timetable: when the sensors read.
        scene: the solids of the world; None if there are none.
        last: up to this tick, compiled code computes the times of ticks itself (`begin_at`).
    """

    def __init__(
        self,
        hydro: Hydrodynamics,
        water: Water,
        sensor_arrays: SensorArrays,
        sensing: Sensing,
        pilots: Pilots,
        rate_hz: Fraction,
    ) -> None:
        """Make the table of a world with these bodies, this water, these sensors and autopilots."""
        self.hydro, self.water, self.sensor_arrays, self.sensing, self.pilots = (
            hydro,
            water,
            sensor_arrays,
            sensing,
            pilots,
        )
        self.rate_hz, self.ticks = rate_hz, Ticks(rate_hz)
        self.run: IntArray = np.zeros(len(rows.RUN.names or ()), np.int64)
        self.ends: IntArray = np.zeros(LONGEST, np.int64)
        # Kept alive, so that no new object can have the identity of one of them.
        self._kept: tuple[object, ...] = ()
        self._ids: tuple[int, ...] = ()
        parts = rate_hz.denominator
        self.last = min(2**62 // (2 * NANOSECONDS * parts), 2**53 // parts) - LONGEST
        self._given_times: tuple[float, ...] = _NO_TIMES
        self.timetable: Timetable
        self.rows: dict[str, Any] = {}
        self.table: IntArray = _NO_TABLE
        self.scene: Scene | None = None

    def move(self, place: Callable[[Any], Any]) -> None:
        """Move everything that a tick reads and writes here to other memory, until other sensors are due: `place` returns a copy of an
        array there."""
        self.run = place(self.run)
        self._tabulate()
        self.rows |= {name: place(self.rows[name]) for name in ("course", *self.timetable.rows)}
        self.table = place(addresses(rows.FORMS, self.rows))

    def begin_at(self, tick: int) -> bool:
        """Prepare for ticks from this one on. Returns whether only one tick can be made, with times that are given to the step: beyond some
        tick, the times are no longer exact in integers of 64 bits or in floats."""
        is_given = tick > self.last
        if is_given or self._given_times is not _NO_TIMES:
            self._ids, time_of, second = (), self.ticks.time_of, self.ticks.second
            times = 1, tick, time_of(tick), time_of(tick + 1), second(tick), second(tick + 1)
            self._given_times = times if is_given else _NO_TIMES
        return is_given

    def refresh(self) -> None:
        """Make the table again if an array has moved, or other sensors are due."""
        now = self._dependencies()
        if tuple(map(id, now)) != self._ids:
            self._tabulate()

    def _dependencies(self) -> tuple[object, ...]:
        """Return the objects on which the table depends."""
        autopilots, sensor_arrays, hydro, solids = (
            self.pilots.arrays,
            self.sensor_arrays,
            self.hydro,
            self.sensor_arrays.solids,
        )
        return (
            hydro.table, sensor_arrays.surroundings, sensor_arrays.heads.rows, self.sensing.groups, None if autopilots is None else autopilots.table,
            hydro.collider, hydro.touching, hydro.contact_nu_dot, self.finding(), solids, self._ray_targets(solids),
        )  # fmt: skip

    def finding(self) -> Finding | None:
        """Return how contacts are found; None if there can be none, or compiled code cannot find them."""
        return self.scene.finding() if self.scene is not None and self.scene is self.hydro.collider else None

    def _ray_targets(self, solids: Geometry) -> RayTargets | None:
        """Return the surfaces at which rays are cast; None if no sensor casts rays, or there is nothing to meet."""
        has_targets = self.sensing.casts_rays and self.scene is solids
        return self.scene.ray_targets() if has_targets and self.scene is not None else None

    def _tabulate(self) -> None:
        from uwserver.step import delivery

        hydro, sensor_arrays, autopilots = self.hydro, self.sensor_arrays, self.pilots.arrays
        targets = self._ray_targets(sensor_arrays.solids)
        self.timetable = made = timetable_of(self.sensing.groups, sensor_arrays)
        sensor_arrays.follow_contacts()
        self._kept = self._dependencies()
        self._ids = tuple(map(id, self._kept))
        step, listen, tell = (0, 0, 0) if autopilots is None else autopilots.codes()
        sea = self.water.sea
        no_drifts, no_intervals = np.zeros((0, 2, 3)), np.zeros(0, np.int64)
        drifts, intervals = (no_drifts, no_intervals) if sea is None else (sea.ends, sea.intervals)
        finding = self.finding() or NO_FINDING
        cast, solids = (0, _NO_TABLE) if targets is None else targets[:2]
        codes = entries.codes(hydro.is_fitted, hydro.collider is not None)
        course = np.zeros(1, rows.COURSE)
        last_round = max((group.round for group in self.sensing.groups), default=rows.WHEN_DUE)
        course[0] = (
            hydro.dt, finding.margin, self.rate_hz.numerator, self.rate_hz.denominator, *self._given_times, step, self.pilots.every, listen, tell,
            0 if sea is None else entries.flow_code(), *finding[:3], cast, codes, delivery.code(), max(last_round, rows.WHEN_DUE),
        )  # fmt: skip
        self.rows = made.rows | {
            "course": course, "run": self.run.view(rows.RUN), "ends": self.ends, "solids": solids, "world": hydro.table,
            "surroundings": sensor_arrays.surroundings, "pilots": _NO_TABLE if autopilots is None else autopilots.table,
            "shapes": finding.table, "touching": hydro.touching.table,
            **dict(zip(_FOUND, finding[5:], strict=True)), "contact_nu_dot": hydro.contact_nu_dot,
            "drifts": drifts, "intervals": intervals, "state": hydro.state, "nu_dot": sensor_arrays.nu_dot, "tau": sensor_arrays.tau,
        }  # fmt: skip
        self.table = addresses(rows.FORMS, self.rows)
