"""What a world's steps are given (`uwserver.step.rows`): where all lies, who is due when, and which code is called."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from uwserver.environment.water import Water
from uwserver.physics import entries
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.collision.finding import NO_FINDING, Finding
from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.rays.raycast import Geometry
from uwserver.step import rows
from uwserver.units import NANOSECONDS
from uwserver.world.instruments import Instruments
from uwserver.world.piloting import Pilots
from uwserver.world.sensing import Sensing
from uwserver.world.ticks import Ticks
from uwserver.world.timetable import Timetable, timetable_of

if TYPE_CHECKING:  # what is solid needs numba to be imported
    from uwserver.physics.rays.casting import Met
    from uwserver.physics.scene import Scene

_NO_TABLE: IntArray = np.zeros((0, 2), np.int64)
_FOUND = ("pairs", "line_first", "lines", "overlapping", "bodies", "numbers", "keys", "coefficients", "led")
LONGEST = 1024
"""Ticks that are made in one go at most."""
_NOTHING_TOLD = 0, 0, 0, 0, 0.0, 0.0


class StepTable:
    """Of a world.

    Attributes:
        hydro, water, instruments, sensing, pilots: what it is made of.
        rate_hz: of its ticks.
        table: of addresses, made by `step.rows.FORMS`; `rows` has the arrays by name, and keeps them.
        run: where its tick stands (`step.rows.RUN`).
        ends: of the log, of each tick that had samples.
        timetable: when which sensors read.
        scene: solid things of the world; None where nothing is solid.
        last: up to this tick times are worked out in compiled code (`stands_at`).
    """

    def __init__(
        self,
        hydro: Hydrodynamics,
        water: Water,
        instruments: Instruments,
        sensing: Sensing,
        pilots: Pilots,
        rate_hz: Fraction,
    ) -> None:
        """Of a world of these bodies, in this water, with these sensors and autopilots."""
        self.hydro, self.water, self.instruments, self.sensing, self.pilots = hydro, water, instruments, sensing, pilots
        self.rate_hz, self._ticks = rate_hz, Ticks(rate_hz)
        self.run: IntArray = np.zeros(len(rows.RUN.names or ()), np.int64)
        self.ends: IntArray = np.zeros(LONGEST, np.int64)
        # Kept, so that no other object has the identity of one of them.
        self._known: tuple[object, ...] = ()
        self._ids: tuple[int, ...] = ()
        parts = rate_hz.denominator
        self.last = min(2**62 // (2 * NANOSECONDS * parts), 2**53 // parts) - LONGEST
        self._told: tuple[float, ...] = _NOTHING_TOLD
        self.timetable: Timetable
        self.rows: dict[str, Any] = {}
        self.table: IntArray = _NO_TABLE
        self.scene: Scene | None = None

    def move(self, place: Callable[[Any], Any]) -> None:
        """Have what a tick reads and writes here lie elsewhere, until others are due: `place` gives a copy of an array in other memory."""
        self.run = place(self.run)
        self._tabulate()
        self.rows |= {name: place(self.rows[name]) for name in ("course", *self.timetable.rows)}
        self.table = place(addresses(rows.FORMS, self.rows))

    def stands_at(self, tick: int) -> bool:
        """Ticks are to be made from this one on. Returns whether one alone, whose times are told: beyond some tick they are no quotients of whole
        numbers of 64 bits any more, or no exact floats."""
        is_told = tick > self.last
        if is_told or self._told is not _NOTHING_TOLD:
            self._ids, time_of, second = (), self._ticks.time_of, self.second
            times = 1, tick, time_of(tick), time_of(tick + 1), second(tick), second(tick + 1)
            self._told = times if is_told else _NOTHING_TOLD
        return is_told

    def second(self, tick: int) -> float:
        """Time of a tick, s."""
        return tick * self.rate_hz.denominator / self.rate_hz.numerator

    def settle(self) -> None:
        """Find all again where something lies elsewhere, or others are due."""
        now = self._lies()
        if tuple(map(id, now)) != self._ids:
            self._tabulate()

    def _lies(self) -> tuple[object, ...]:
        bank, instruments, hydro, solids = self.pilots.bank, self.instruments, self.hydro, self.instruments.solids
        return (
            hydro.table, instruments.now, instruments.heads.rows, self.sensing.groups, None if bank is None else bank.table,
            hydro.collider, hydro.touching, hydro.contact_nu_dot, self.finding(), solids, self._met(solids),
        )  # fmt: skip

    def finding(self) -> Finding | None:
        """How it is found out whether anything may touch; None where nothing may, or compiled code cannot."""
        return self.scene.finding() if self.scene is not None and self.scene is self.hydro.collider else None

    def _met(self, solids: Geometry) -> Met | None:
        """What rays are cast at; None where there are none or they meet nothing."""
        is_met = self.sensing.casts and self.scene is solids
        return self.scene.met() if is_met and self.scene is not None else None

    def _tabulate(self) -> None:
        from uwserver.step import delivery

        hydro, instruments, bank = self.hydro, self.instruments, self.pilots.bank
        met = self._met(instruments.solids)
        self.timetable = made = timetable_of(self.sensing.groups, instruments)
        instruments.follow_contacts()
        self._known = self._lies()
        self._ids = tuple(map(id, self._known))
        step, hear, tell = (0, 0, 0) if bank is None else bank.codes()
        sea = self.water.sea
        no_drifts, no_intervals = np.zeros((0, 2, 3)), np.zeros(0, np.int64)
        drifts, intervals = (no_drifts, no_intervals) if sea is None else (sea.ends, sea.intervals)
        finding = self.finding() or NO_FINDING
        cast, solids = (0, _NO_TABLE) if met is None else met[:2]
        codes = entries.codes(hydro.is_fitted, hydro.collider is not None)
        course = np.zeros(1, rows.COURSE)
        last_round = max((group.round for group in self.sensing.groups), default=rows.WHEN_DUE)
        course[0] = (
            hydro.dt, finding.margin, self.rate_hz.numerator, self.rate_hz.denominator, *self._told, step, self.pilots.every, hear, tell,
            0 if sea is None else entries.flow_code(), *finding[:3], cast, codes, delivery.code(), max(last_round, rows.WHEN_DUE),
        )  # fmt: skip
        self.rows = made.rows | {
            "course": course, "run": self.run.view(rows.RUN), "ends": self.ends, "solids": solids, "world": hydro.table,
            "now": instruments.now, "pilots": _NO_TABLE if bank is None else bank.table, "shapes": finding.table, "touching": hydro.touching.table,
            **dict(zip(_FOUND, finding[5:], strict=True)), "contact_nu_dot": hydro.contact_nu_dot,
            "drifts": drifts, "intervals": intervals, "state": hydro.state, "nu_dot": instruments.nu_dot, "tau": instruments.tau,
        }  # fmt: skip
        self.table = addresses(rows.FORMS, self.rows)
