"""The steps of a world (`uwserver.step.tick`): what they get from Python, and the Python work at their stops."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.kernel.straight import straight
from uwserver.ports import Sample
from uwserver.step import rows
from uwserver.step.streams import NEVER
from uwserver.world.parts.part import Before, Part, PartSchedule
from uwserver.world.parts.profile import Profile, kind_of
from uwserver.world.sensing.timetable import needs_of
from uwserver.world.stepping.step_table import LONGEST, StepTable

_SERVED, _ALONE = 5120, 25_600
"""Most ticks in one step for a world with one body; half as many with two; never more than `LONGEST`. In a server they take 20 ms at most, about;
then their samples are handed on. In a program that steps its own world they take 0.1 s at most, about; then it can be interrupted."""

REASONS = {
    rows.PILOTS: "autopilots", rows.FORCES: "forces", rows.FIND: "contacts", rows.DRAW: "drifting currents",
    rows.FLOW: "led bodies and modems", rows.ARRIVALS: "arrivals",
    rows.PYTHON: "readings in Python", rows.WRITE: "frozen texts", rows.KEEP: "values that are no numbers", rows.ROOM: "room",
    rows.CALLED: "called sensors",
}  # fmt: skip
"""Why a step has stopped, in words."""

_UNITS = {
    rows.PILOTS: ("autopilots", "autopilots"), rows.FIND: ("contact", "detection"), rows.MOVE: ("physics", "bodies"),
    rows.RATES: ("sensors", "accelerations"),
    rows.REPEAT: ("sensors", "compound"), rows.WRITE: ("sensors", "status"),
    rows.DELIVER: ("delivery", "errors, delays"), rows.LISTEN: ("listening", "autopilots"),
}  # fmt: skip
"""Stage and kind of the work of compiled code, as in a profile."""
_WORK = {rows.UNIT: 0, rows.PILOTS: rows.PILOTS, rows.DIVERGED: rows.MOVE}
"""Stops behind such work, and which work it was if the stop tells."""

_CHANGING = (rows.PILOTS, rows.FORCES, rows.FIND, rows.FLOW)
"""Stops after which arrays may have moved."""
QUIET = (rows.FIND, rows.DRAW)
"""Stops whose Python work changes nothing else."""

_NAMES = rows.RUN.names or ()
_TICK, _STAGE, _ROUND, _NEEDS, _DUE, _KINDS, _TURN, _BEGUN, _ENDS, _WRITTEN, _WHICH, _UNIT = (
    _NAMES.index(name) for name in ("tick", "stage", "round", "needs", "due", "kinds", "turn", "begun", "ends", "written", "which", "unit")
)  # fmt: skip
_ASKED = slice(_NAMES.index("first"), _NAMES.index("measured") + 1)


class Stepping:
    """Makes the ticks of a world.

    Attributes:
        given: the table that steps get.
        schedule: the work of the parts.
        stops: how often steps have stopped, by `REASONS`.
        profile: measures each unit of work; None for none.
    """

    def __init__(self, given: StepTable, set_tick: Callable[[int], None], has_to_tell: Callable[[], bool]) -> None:
        """Load the step.

        Args:
            given: the table that steps get.
            set_tick: tells the world which tick it has reached.
            has_to_tell: returns whether something waits for clients, so that no further tick is to be made.
        """
        from uwserver.step import tick

        tick.load()
        self.given = given
        self._hydro, self._water, self._sensor_arrays, self._sensing, self._pilots = (
            given.hydro, given.water, given.sensor_arrays, given.sensing, given.pilots,
        )  # fmt: skip
        self._set_world_tick, self._has_to_tell = set_tick, has_to_tell
        self._step = straight(tick.step)
        self._first = 0
        self._samples: list[Sample] = []
        self.schedule = PartSchedule([], [], [], [], [], {})
        self.stops = dict.fromkeys(REASONS.values(), 0)
        self.profile: Profile | None = None
        self._answers = {
            rows.PILOTS: lambda: self._pilots.attend(self._now[1]), rows.FORCES: lambda: run_parts(self.schedule.forces, *self._now),
            rows.FIND: given.hydro.find_contacts, rows.DRAW: self._draw, rows.FLOW: self._follow,
            rows.ARRIVALS: lambda: self._sensing.pending_jobs.arrive(self._now[1]),
            rows.PYTHON: lambda: self._sensing.python_readings.sense(self._due, self._now[1]), rows.WRITE: self._write, rows.KEEP: self._keep,
            rows.ROOM: self._make_room, rows.CALLED: self._call,
        }  # fmt: skip

    # -- ticks ----------------------------------------------------------------------------------------------------------------------

    def go_on(self, tick: int, most: int, posted: IntArray | None, samples: list[Sample]) -> int:
        """Make up to `most` ticks, and at least one.

        Args:
            tick: the present tick of the world; everything before autopilots has been done.
            most: 1 or more.
            posted: as for `tick.step`; None for a world to which no other thread posts.
            samples: takes the samples that `Sensing` does not keep.

        Returns:
            The row of the first body whose state is not finite; -1 if there is none.
        """
        longest = max(1, (_ALONE if posted is None else _SERVED) // max(1, len(self._hydro)))
        until = tick + min(most, LONGEST, longest)
        lost, why, stopped, asks = -1, rows.DONE, False, True
        if self.begin(tick, samples):
            until = tick + 1
        try:
            while lost < 0:
                if asks:
                    # In a server, requests may come at any time, so a step that has needed Python ends with its tick.
                    ends = stopped and (posted is not None or self._has_to_tell())
                    until = tick + 1 if ends else min(until, self.next_tick(tick))
                    self.ask(tick, until)
                why = self._make(rows.NOTHING_POSTED if posted is None else posted)
                if why in (rows.DONE, rows.END):
                    break
                if why == rows.DIVERGED:
                    lost = self.lost
                elif why != rows.UNIT:
                    asks, stopped = not stopped or why not in QUIET, True
                    self.answer(why)
        finally:  # A kernel may raise.
            self.end(why)
        return lost

    def begin(self, tick: int, samples: list[Sample]) -> bool:
        """Prepare for ticks from this one on; everything before autopilots has been done. Returns whether only one can be made
        (`StepTable.begin_at`).

        `samples` takes the samples that `Sensing` does not keep.
        """
        run, self._samples, self._first = self.given.run, samples, self._sensor_arrays.logged
        run[: _ASKED.start] = 0  # 0 in `stage` is BEGIN
        run[_TICK] = tick
        if self._pilots.arrays is not None:
            self._pilots.follow_switches()
        is_one = self.given.begin_at(tick)
        self.given.refresh()
        return is_one

    def end(self, why: int) -> None:
        """Finish a call of the step, which has stopped for this reason: the world gets its tick, and samples are handed on."""
        run, sensor_arrays, samples = self.given.run, self._sensor_arrays, self._samples
        reached = run[: _ASKED.start].tolist()
        self._set_world_tick(reached[_TICK])
        sensor_arrays.take_over()
        if reached[_WRITTEN]:
            self._sensing.take_texts()
        with_loose = why == rows.END and bool(reached[_BEGUN] and sensor_arrays.loose_count)
        if reached[_ENDS] or with_loose:
            self._sensing.tell(self._first, self.given.ends[: reached[_ENDS]].tolist(), with_loose, samples)
        if why == rows.END:
            self._sensing.pending_jobs.purge()
            for act in self.schedule.last:
                act(*self._now, samples)

    @property
    def lost(self) -> int:
        """Row of the body whose state is not finite, after a step has stopped for that."""
        return int(self.given.run[_WHICH])

    def next_tick(self, tick: int) -> int:
        """Return the next tick before which a part acts that does so before autopilots."""
        return max(tick + 1, next_tick((*self.schedule.first, *self.schedule.watch)))

    def ask(self, first: int, until: int) -> None:
        """Set what Python decides before a step: the first tick, the tick at which it ends, and when Python is needed."""
        sensing, schedule, collider = self._sensing, self.schedule, self._hydro.collider
        follow_ns = min([NEVER, *(part.after_ns for part, _ in schedule.follow)])
        self.given.run[_ASKED] = (
            first, until, next_tick(schedule.forces), collider is not None and self.given.finding() is None, follow_ns, sensing.call_ns,
            sensing.callable, not sensing.pending_jobs.is_idle, 2 if schedule.last else bool(schedule.listeners), self.profile is not None,
        )  # fmt: skip

    def ask_again(self) -> None:
        """Do the same after a stop, as others may be due then. If something waits for clients, no further tick is made."""
        first, until = self.given.run[_ASKED][:2].tolist()
        self.ask(first, 0 if self._has_to_tell() else min(until, self.next_tick(first)))

    def _make(self, posted: IntArray) -> int:
        step = (self._step, self.given.table, *self._sensor_arrays.to_deliver(), posted, *self._sensor_arrays.room)
        if self.profile is None:
            return int(step[0](*step[1:]))
        return self.profile.unit(*step, name=self._unit)

    def _unit(self, why: int) -> tuple[str, str, int] | None:
        """Return what compiled code has just done, for a profile; None if it was nothing of its own."""
        if why not in _WORK:
            return None
        unit = _WORK[why] or int(self.given.run[_UNIT])
        if unit == rows.MOVE and self._hydro.touching.is_kept:
            return "contact", "response", 0
        if unit != rows.READ:
            return (*_UNITS[unit], 0)
        heads = self._turn(int(self.given.run[_WHICH]))
        return "sensors", kind_of(self.given.timetable.slots[int(heads[0])].sensor), len(heads)

    def _set_tick(self) -> None:
        self._set_world_tick(int(self.given.run[_TICK]))

    @property
    def _now(self) -> tuple[int, int]:
        tick = int(self.given.run[_TICK])
        return tick, self.given.ticks.time_of(tick)

    # -- the stops ------------------------------------------------------------------------------------------------------------------

    def answer(self, why: int) -> None:
        """Do the Python work for which a step has stopped (`REASONS`)."""
        self.stops[REASONS[why]] += 1
        if why not in QUIET:
            self._set_tick()
            self._sensor_arrays.take_over()
        self._answers[why]()
        if why in _CHANGING:
            self.given.refresh()

    def _draw(self) -> None:
        if self._water.sea is not None:
            self._water.sea.draw(self._now[0])

    def _follow(self) -> None:
        tick, t_ns = self._now
        for part, act in self.schedule.follow:
            if t_ns >= part.after_ns:
                act(tick, t_ns, self._samples)

    def _call(self) -> None:
        """Let sensors that are called read in a round of their own, if there are any."""
        run, called = self.given.run, self._sensing.called(self.given.ticks.second(self._now[0]))
        if not called:
            run[_ROUND] = rows.WHEN_DUE
            return
        needs = needs_of(called)
        if needs & rows.NEEDS_TEXTS:  # Compiled code writes texts for whole groups only.
            needs = needs & ~rows.NEEDS_TEXTS | rows.NEEDS_PYTHON
        run[_STAGE], run[_NEEDS], run[_DUE] = rows.RATES, needs, len(called)
        self.given.rows["due"][: len(called)] = [slot.head for slot in called]
        count = turn = 0
        for kind, kernel in enumerate(self.given.timetable.kernels):
            heads = [slot.head for slot in called if getattr(slot.sensor, "kernel", None) is kernel]
            if heads:
                self.given.rows["turns"][count : count + len(heads)] = heads
                self.given.rows["turn"][turn] = kind, count, len(heads)
                count, turn = count + len(heads), turn + 1
        run[_KINDS] = turn

    @property
    def _due(self) -> IntArray:
        due: IntArray = self.given.rows["due"][: self.given.run[_DUE]]
        return due

    def _turn(self, number: int) -> IntArray:
        """Return the heads of a kind that read together."""
        _, first, count = self.given.rows["turn"][number].tolist()
        heads: IntArray = self.given.rows["turns"][first : first + count]
        return heads

    def _write(self) -> None:
        self._sensing.take_texts()
        self._sensing.python_readings.write(self._due)

    def _keep(self) -> None:
        for slot in self._sensing.python_readings.keep(self._due):
            self._sensing.pending_jobs.take(slot, self._now[1])

    def _make_room(self) -> None:
        self._sensor_arrays.make_room(int(self.given.run[_WHICH]))
        self._first = self._sensor_arrays.logged


def next_tick(parts: Iterable[tuple[Part, Before]]) -> int:
    """Return the first tick in which one of these parts has something to do; NEVER if none has."""
    return min([part.next_tick for part, _ in parts if part.next_tick is not None], default=NEVER)


def run_parts(parts: Iterable[tuple[Part, Before]], tick: int, t_ns: int) -> None:
    """Call those of these parts that have something to do in a tick."""
    for part, before in parts:
        if part.next_tick is not None and tick >= part.next_tick:
            before(tick, t_ns)
