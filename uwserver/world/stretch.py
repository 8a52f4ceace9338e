"""Stretches of ticks that follow each other in compiled code (`uwserver.world.ticking`): when there can be one, and what has become of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from uwserver.physics import entries
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.layout import addresses
from uwserver.physics.kernel.right_of_way import NOBODY
from uwserver.physics.kernel.straight import straight
from uwserver.physics.rays.raycast import OpenWater
from uwserver.ports import Sample
from uwserver.units import NANOSECONDS
from uwserver.world.agenda import AT_CONTACTS, AT_PILOTS, COURSE, FORMS, LONGEST, REACHED_SIZE, USUAL, Agenda, agenda_of
from uwserver.world.instruments import Instruments
from uwserver.world.part import Part, takes_part
from uwserver.world.piloting import Pilots
from uwserver.world.sensing import Sensing

if TYPE_CHECKING:  # what is solid needs numba to be imported
    from uwserver.physics.collision.solids import Finding
    from uwserver.physics.rays.casting import OneByOne
    from uwserver.physics.scene import Scene

_NO_TABLE: IntArray = np.zeros((0, 2), np.int64)
_NEAR_TICKS = 16
"""Once bodies have come near something, so many ticks are made one by one before it is tried again."""
_PORTS = 8
"""Where something has changed, for each so many ports one tick is made by itself before all that may be due is put together: of a swarm that takes as
long as some dozen ticks, and programs change one thing after the other."""
_BODIES, _BODIES_ALONE = 256, 25_600
"""Ticks of one body, or half as many of two: some 1 ms, which is how long who looks from outside waits at most; and some 0.1 s, for who breaks off a
program that steps a world of its own."""


class Reached(NamedTuple):
    """How a stretch has ended: `stage` (`agenda`) of the tick that follows `Stretch.tick`; `row` of a body whose state is not finite, -1 for none."""

    stage: int
    row: int


class Stretch:
    """Of a world. Its ticks are those of `World.advance`, bit for bit.

    Attributes:
        scene: solid things of the world; None where nothing is solid.
        tick: that the last one has reached, also where a kernel raised.
    """

    def __init__(
        self, hydro: Hydrodynamics, instruments: Instruments, sensing: Sensing, pilots: Pilots, rate_hz: Fraction
    ) -> None:
        """Of a world of these bodies, sensors and autopilots."""
        self._hydro, self._instruments, self._sensing, self._pilots = hydro, instruments, sensing, pilots
        self._rate = rate_hz
        # Beyond, the times of ticks are no whole numbers of 64 bits any more, or no exact floats.
        self._last = min(2**62 // (2 * NANOSECONDS * rate_hz.denominator), 2**53 // rate_hz.denominator) - LONGEST
        self._known: tuple[object, ...] = ()
        self._agenda: Agenda | None = None
        self._reached: IntArray = np.zeros(REACHED_SIZE, np.int64)
        self._ends: IntArray = np.zeros(LONGEST, np.int64)
        self._kept: dict[str, Any] = {}
        self.scene: Scene | None = None
        self.tick = 0
        self._others: list[Part] = []
        self._has_rays = False
        self._is_plain = False
        self._go_on: Callable[..., None]
        self._table, self._near, self._wait = _NO_TABLE, 0, 0
        self._usual = self._alone = 1

    def line_up(self, awake: Sequence[Part]) -> None:
        """These parts act in a tick, or hear what others measure."""
        self._others = [part for part in awake if takes_part(type(part))[0] and part is not self._pilots]
        acting = [part for part in awake if takes_part(type(part))[1]]
        self._is_plain = acting == [self._sensing] and not any(part.hears for part in awake)

    def run(self, tick: int, most: int, way: IntArray | None, samples: list[Sample]) -> Reached | None:
        """Make up to `most` ticks. What was delivered in them, `Sensing` has to tell.

        Args:
            tick: at which the world stands, with nothing posted.
            most: 1 or more.
            way: see `World.go_on`.
            samples: receives those that `Sensing` does not keep to tell.

        Returns:
            None where the next tick is not one for compiled code: then nothing was done.
        """
        if self._near:
            self._near -= 1
            return None
        quiet = [part.next_tick - tick for part in self._others if part.next_tick is not None]
        most = min(most, LONGEST, *quiet)
        if most < 1 or not self._is_plain:
            return None
        instruments, sensing = self._instruments, self._sensing
        if instruments.roused or not self._hydro.is_plain or tick > self._last:
            return None
        agenda = self._agenda_now()
        if agenda is None or not agenda.ahead[tick % len(agenda.ahead)]:
            return None
        if self._pilots.bank is not None:
            self._pilots.follow_switches()
        usual, way = (self._alone, NOBODY) if way is None else (self._usual, way)
        try:
            self._go_on(self._table, *instruments.to_deliver(), way, tick, min(most, usual), most, *instruments.room)
        finally:  # a kernel may raise
            self.tick, stage, row, count, wordy, written = self._reached.tolist()
            sensing.tell_all(self._ends[:count].tolist(), bool(wordy), bool(written), samples)
        if self.tick == tick and not stage:
            return None  # no room
        self._pilots.stand_at(self.tick + (stage in (AT_PILOTS, AT_CONTACTS)))
        if stage == AT_CONTACTS:
            self._near = _NEAR_TICKS
        return Reached(stage, row)

    def _agenda_now(self) -> Agenda | None:
        """As all lies now; None where there is none, or not yet."""
        now = self._lies()
        if len(now) != len(self._known) or any(a is not b for a, b in zip(now, self._known, strict=True)):
            self._known, self._agenda = now, None
            self._wait = len(self._sensing.numbers) // _PORTS
        if self._wait > 0:
            self._wait -= 1
        elif self._wait == 0:
            self._wait -= 1
            self._agenda = self._settle()
        return self._agenda

    def _lies(self) -> tuple[object, ...]:
        bank = self._pilots.bank
        return (
            self._hydro.table, self._instruments.now, self._sensing.schedule_made,
            None if bank is None else bank.table, self._hydro.collider, self._finding(), self._instruments.solids, self._met(),
        )  # fmt: skip

    def _finding(self) -> Finding | None:
        """How it is found out whether anything may touch; None where nothing may, or compiled code cannot."""
        return self.scene.finding() if self.scene is not None and self.scene is self._hydro.collider else None

    def _met(self) -> OneByOne | None:
        """What rays are cast at; None where there are none or they meet nothing, or compiled code cannot."""
        is_met = self._has_rays and self.scene is not None and self.scene is self._instruments.solids
        return self.scene.one_by_one() if is_met and self.scene is not None else None

    def _settle(self) -> Agenda | None:
        """Find all again: something lies elsewhere, or others are due. None where that is nothing for compiled code."""
        from uwserver.world import delivery, ticking

        hydro, instruments, bank, dues = self._hydro, self._instruments, self._pilots.bank, self._sensing.by_mask()
        # What rays meet is put together when there are some: a scene may be large.
        self._has_rays = bool(instruments.heads.rows["rays"].any())
        self._known = self._lies()
        finding, met = self._finding(), self._met()
        move, look = entries.codes(hydro.is_fitted)
        step, hear, tell = (0, 0, 0) if bank is None else bank.codes()
        deliver = delivery.code()
        search, table, margin, pairs = finding or (0, _NO_TABLE, 0.0, _NO_TABLE)
        cast, solids = met or (0, _NO_TABLE)
        casts = met is not None or isinstance(instruments.solids, OpenWater)
        needed = [move, look, deliver]
        needed += [step, hear, tell] if bank is not None else []
        needed += [search] if hydro.collider is not None else []
        if dues is None or not all(needed):
            return None
        ticking.load()
        self._go_on = straight(ticking.go_on)
        self._usual, self._alone = (
            min(ticks, max(1, bodies // max(1, len(hydro)))) for ticks, bodies in ((USUAL, _BODIES), (LONGEST, _BODIES_ALONE))
        )  # fmt: skip
        course = np.zeros(1, COURSE)
        course[0] = (
            hydro.dt, margin, self._rate.numerator, self._rate.denominator, step, self._pilots.every, hear, tell,
            search, cast, move, look, deliver,
        )  # fmt: skip
        agenda = agenda_of(*dues, instruments, casts=casts)
        self._kept = agenda.rows | {
            "course": course, "solids": solids, "reached": self._reached, "ends": self._ends, "world": hydro.table, "now": instruments.now,
            "pilots": _NO_TABLE if bank is None else bank.table, "shapes": table, "pairs": pairs,
            "state": hydro.state, "nu_dot": instruments.nu_dot, "tau": instruments.tau,
        }  # fmt: skip
        self._table = addresses(FORMS, self._kept)
        return agenda
