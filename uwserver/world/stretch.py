"""Stretches of ticks that follow each other in compiled code (`uwserver.world.ticking`): when there can be one, and what has become of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from uwserver.physics import entries
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.layout import addresses
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
"""Ticks of who is near something, until it is tried again to make several without looking at what may touch."""


_BODIES = 256
"""That are moved by a tick in one go, some 1 ms: who posts something waits no longer for the tick in which it is carried out."""


@cache
def _open_water() -> OneByOne:
    """Nothing is met in it. Found once; who has nothing solid needs it for rays alone."""
    from uwserver.physics.rays.casting import Rays

    nothing = Rays().one_by_one()
    assert nothing is not None
    return nothing


class Reached(NamedTuple):
    """Where a stretch has ended: `stage` (`agenda`) of the tick that follows `tick`; `row` of a body whose state is not finite, -1 for none."""

    tick: int
    stage: int
    row: int


class Stretch:
    """Of a world. Its ticks are those of `World.advance`, bit for bit.

    Attributes:
        scene: solid things of the world; None where nothing is solid.
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
        self._others: list[Part] = []
        self._is_plain = False
        self._go_on: Callable[..., None]
        self._table, self._near, self._usual = _NO_TABLE, 0, 1

    def line_up(self, awake: Sequence[Part]) -> None:
        """These parts act in a tick, or hear what others measure."""
        self._others = [part for part in awake if takes_part(type(part))[0] and part is not self._pilots]
        acting = [part for part in awake if takes_part(type(part))[1]]
        self._is_plain = acting == [self._sensing] and not any(part.hears for part in awake)

    def run(self, tick: int, most: int, way: IntArray, samples: list[Sample]) -> Reached | None:
        """Make up to `most` ticks. What was delivered in them, `Sensing` has to tell.

        Args:
            tick: at which the world stands, with nothing posted.
            most: 1 or more.
            way: see `ticking.go_on`.
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
        agenda = self._agenda if self._is_known() else self._settle()
        if agenda is None or not agenda.ahead[tick % len(agenda.ahead)]:
            return None
        if self._pilots.bank is not None:
            self._pilots.follow_switches()
        self._go_on(self._table, *instruments.to_deliver(), way, tick, min(most, self._usual), most, *instruments.room)
        end, stage, row, count, wordy, written = self._reached.tolist()
        if end == tick and not stage:
            return None  # no room
        sensing.tell_all(self._ends[:count].tolist(), bool(wordy), bool(written), samples)
        self._pilots.stand_at(end + (stage in (AT_PILOTS, AT_CONTACTS)))
        if stage == AT_CONTACTS:
            self._near = _NEAR_TICKS
        return Reached(end, stage, row)

    def _is_known(self) -> bool:
        """Whether all lies where it lay."""
        now = self._lies()
        return len(now) == len(self._known) and all(a is b for a, b in zip(now, self._known, strict=True))

    def _lies(self) -> tuple[object, ...]:
        bank = self._pilots.bank
        return (
            self._hydro.table, self._instruments.now, self._sensing.schedule_made,
            None if bank is None else bank.table, *self._solid(),
        )  # fmt: skip

    def _solid(self) -> tuple[Finding | None, OneByOne | None]:
        """How it is found out whether anything may touch, and what rays are cast at; None where compiled code cannot, or nothing may touch."""
        scene, seen = self.scene, self._instruments.solids
        finding = scene.finding() if scene is not None and scene is self._hydro.collider else None
        if isinstance(seen, OpenWater):
            return finding, _open_water()
        return finding, scene.one_by_one() if scene is not None and scene is seen else None

    def _settle(self) -> Agenda | None:
        """Find all again: something lies elsewhere, or others are due."""
        from uwserver.world import delivery, ticking

        self._known, self._agenda = self._lies(), None
        hydro, instruments, bank, dues = self._hydro, self._instruments, self._pilots.bank, self._sensing.by_mask()
        finding, rays = self._solid()
        move, look = entries.codes(hydro.is_fitted)
        step, hear, tell = (0, 0, 0) if bank is None else bank.codes()
        deliver = delivery.code()
        search, table, margin, pairs = finding or (0, _NO_TABLE, 0.0, _NO_TABLE)
        cast, solids = rays or (0, _NO_TABLE)
        needed = [move, look, deliver]
        needed += [step, hear, tell] if bank is not None else []
        needed += [search] if hydro.collider is not None else []
        if dues is None or not all(needed):
            return None
        ticking.load()
        self._go_on = straight(ticking.go_on)
        self._usual = min(USUAL, max(1, _BODIES // max(1, len(hydro))))
        course = np.zeros(1, COURSE)
        course[0] = (
            hydro.dt, margin, self._rate.numerator, self._rate.denominator, step, self._pilots.every, hear, tell,
            search, cast, move, look, deliver,
        )  # fmt: skip
        agenda = agenda_of(*dues, instruments, casts=cast != 0)
        self._kept = agenda.rows | {
            "course": course, "solids": solids, "reached": self._reached, "ends": self._ends, "world": hydro.table, "now": instruments.now,
            "pilots": _NO_TABLE if bank is None else bank.table, "shapes": table, "pairs": pairs,
            "state": hydro.state, "nu_dot": instruments.nu_dot, "tau": instruments.tau,
        }  # fmt: skip
        self._table, self._agenda = addresses(FORMS, self._kept), agenda
        return agenda
