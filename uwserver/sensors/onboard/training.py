"""Training of pilots: tasks to do one after the other, judged by the true state of the vehicle, with time, collisions and a score."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from itertools import accumulate
from typing import Annotated, Literal

from msgspec import Meta, structs

from uwserver.frames import Vec3, multiply, quat_from_rpy
from uwserver.modifiers import Measurement
from uwserver.modifiers.base import Memory
from uwserver.ports import Argument, Field, Json, Value
from uwserver.sensors.base import Named, Pose, Scope, Sensor, SensorTable, Settings, Traits
from uwserver.sensors.onboard.tasks import (
    Follow,
    Gate,
    HoldDepth,
    Inspect,
    Moment,
    Points,
    Reach,
    Task,
    Verdict,
    eye_at,
)
from uwserver.table import NonNegative
from uwserver.units import NANOSECONDS

State = Literal["ready", "running", "done", "failed", "off"]
MOVED_M, STEERED_W = 0.3, 1.0
"""Time begins when the thrusters draw this power. If their power is not known, it begins when the vehicle has moved this far."""
_SAME_COLLISION_NS = NANOSECONDS
"""A touch within this time after another one is the same collision."""
_NAME = re.compile(r"[\w -]{1,60}")
_MOST_TASKS = 64
_MOST_PIECES = 4096
_MOST_LOST = 1e12


class TrainingConfig(SensorTable, tag="training", kw_only=True, frozen=True):
    """Tasks for a pilot. Simulation time counts, from the first thrust on. The mount is that of the pilot's camera.

    Attributes:
        tasks: the tasks by name, in the order of the file.
        limit_s: time limit for all tasks; after it the training has failed.
        collision_points: points that a collision costs.
        collision_Ns: smallest impulse that counts as a collision. Contacts are checked at `rate_hz`.
        points_per_s_left: points for each second that is left when all tasks are done.
        view_deg: full angle of the cone about the camera's x axis in which the pilot sees things well.
    """

    message = "Training"
    tasks: dict[str, Reach | HoldDepth | Gate | Inspect | Follow]
    limit_s: Annotated[float, Meta(gt=0, le=1e6)] = 600.0
    collision_points: Points = 10.0
    collision_Ns: NonNegative = 0.5
    points_per_s_left: Points = 1.0
    view_deg: Annotated[float, Meta(ge=1, le=170)] = 60.0

    def __post_init__(self) -> None:
        """Raise ValueError if there is no task, if there are too many, or if a name would not fit into a list on a page."""
        if not 0 < len(self.tasks) <= _MOST_TASKS:
            raise ValueError(f"a training has 1 to {_MOST_TASKS} tasks, not {len(self.tasks)}")
        pieces = sum(len(task.worth()) for task in self.tasks.values())
        if pieces > _MOST_PIECES:
            raise ValueError(
                f"the tasks have {pieces} metres, structures and findings in all: at most {_MOST_PIECES} are possible"
            )
        findings = [name for task in self.tasks.values() if isinstance(task, Follow) for name in task.findings]
        for name in (*self.tasks, *findings):
            if not _NAME.fullmatch(name):
                raise ValueError(
                    f'"{name[:60]}" cannot name a task or a finding: letters, digits, _, - and spaces, at most 60'
                )

    def traits(self) -> Traits:
        """Declare the structures that the pilot has to inspect."""
        inspected = (
            Named(("tasks", name, "structures", k), "structures", structure)
            for name, task in self.tasks.items()
            if isinstance(task, Inspect)
            for k, structure in enumerate(task.structures)
        )
        return Traits(names=tuple(inspected))

    def build(self, mount: Pose) -> Training:
        """Return the judge, with the pilot's camera on this mount."""
        return Training(self, mount)


class TrainingSettings(Settings, frozen=True):
    """Whether the training runs."""

    running: bool = True


class TrainingMemory(Memory):
    """Attributes:
    place, before: position of the vehicle at the first reading and at the last one, m in N.
    seen: there was a reading.
    begun_ns, ended_ns: time at which this try began and ended; -1 before that.
    step: number of tasks that are over.
    done: which pieces of all tasks are done.
    piece: piece of the present task that was met at the last reading; -1 for none.
    since_ns: time since which it has been met; -1 for none.
    collisions, touched_ns: number of collisions, and time of the last touch; -1 before it.
    mark: the pilot has marked something since the last reading.
    lost: points that wrong marks have cost."""

    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    before: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seen: bool = False
    begun_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    ended_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    step: Annotated[int, Meta(ge=0, le=_MOST_TASKS)] = 0
    done: Annotated[tuple[bool, ...], Meta(max_length=_MOST_PIECES)] = ()
    piece: Annotated[int, Meta(ge=-1, lt=_MOST_PIECES)] = -1
    since_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    collisions: Annotated[int, Meta(ge=0, le=2**31)] = 0
    touched_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    mark: bool = False
    lost: Annotated[float, Meta(ge=0, le=_MOST_LOST)] = 0.0


class Training(Sensor):
    """The judge of a pilot, who knows the truth."""

    doc = (
        "Tasks for a pilot: the present task, time, collisions and score. Time begins when the thrusters push. `set` with `running` = true begins "
        "a new try, and with false it stops. With `mark` = true the pilot marks what the camera shows."
    )
    fields = (
        Field("state", "1", "ready, running, done, failed (out of time) or off", type="str"),
        Field("task", "1", "the present task", type="str"),
        Field("number", "1", "number of the present task, from 1", type="int"),
        Field("count", "1", "number of all tasks", type="int"),
        Field("time", "s", "time since the thrusters pushed for the first time"),
        Field("left", "s", "time that is left"),
        Field("held", "s", "time for which the task has been met without a break"),
        Field("hold", "s", "time for which it has to be met"),
        Field("goal_p_NB", "m", "the place to go to, or to look at", "N", (3,)),
        Field("distance", "m", "distance from there"),
        Field("collisions", "1", "collisions in this try", type="int"),
        Field("score", "1", "points of what is done, minus collisions and wrong marks; plus points for the time left when all is done"),
        Field("part", "1", "part of the present task that is done, 0 to 1"),
        Field("hint", "1", "what the pilot should do or change; empty if the task says it all", type="str"),
        Field("found", "1", "names of what is inspected or marked in the present task", type="str"),
        Field("missing", "1", "how many are not inspected or marked yet", type="int"),
        Field("marks", "1", "whether the present task has things to mark with `mark`", type="bool"),
        Field("lost", "1", "points that wrong marks cost", type="float"),
    )  # fmt: skip
    arguments = (
        Argument("running", "bool", "true begins a new try, false stops it", required=False),
        Argument("mark", "bool", "true marks what the camera shows", required=False),
    )
    paces = True
    settings: TrainingSettings
    memory: TrainingMemory

    def __init__(self, config: TrainingConfig, mount: Pose = Pose()) -> None:  # noqa: B008 - frozen
        self._config, self._mount = config, mount
        self._tasks: tuple[tuple[str, Task], ...] = tuple(
            (task.text or name, task) for name, task in config.tasks.items()
        )
        self._worth = tuple(points for _, task in self._tasks for points in task.worth())
        self._first = tuple(accumulate((len(task.worth()) for _, task in self._tasks), initial=0))
        super().__init__(TrainingSettings())

    def turn_on(self) -> TrainingMemory:
        """Return the memory of a new try."""
        return TrainingMemory(done=(False,) * len(self._worth))

    def properties(self) -> dict[str, Json]:
        """Return the settings, and whether a mark waits to be judged."""
        return {**super().properties(), "mark": self.memory.mark}

    def change(self, args: Mapping[str, Json]) -> None:
        """Change settings. `running` = true begins a new try. A mark is judged at the next reading."""
        super().change({name: value for name, value in args.items() if name != "mark"})
        if args.get("running"):
            self.memory = self.turn_on()
        if "mark" in args:
            self.memory = structs.replace(self.memory, mark=bool(args["mark"]))

    def valid(self, record: Memory | Settings) -> None:
        """Check a record. A memory must fit the number of tasks and pieces, and have ended if all tasks are done."""
        if isinstance(record, TrainingMemory) and record.step > len(self._tasks):
            raise ValueError(f"{record.step} tasks are done, but there are {len(self._tasks)}")
        if isinstance(record, TrainingMemory) and record.step == len(self._tasks) and record.ended_ns < 0:
            raise ValueError("all tasks are done, but the training has not ended")
        super().valid(record)
        if isinstance(record, TrainingMemory) and record.piece >= len(self._pieces(record)):
            raise ValueError(f"piece {record.piece} is met, but its task has only {len(self._pieces(record))}")

    def sense(self, scope: Scope) -> Measurement:
        """Judge this instant, and report the state; always valid."""
        verdict = self._verdict(scope)
        if self.settings.running:
            step = self.memory.step
            self.memory = self._updated_memory(scope, verdict)
            verdict = verdict if self.memory.step == step else self._verdict(scope)
        return Measurement(self._report(scope, verdict), True)

    # -- the present task -----------------------------------------------------------------------------------------------------------

    @property
    def _task(self) -> tuple[str, Task]:
        """Text and task of the present step; the last one when all are over."""
        return self._tasks[min(self.memory.step, len(self._tasks) - 1)]

    def _pieces(self, memory: TrainingMemory) -> tuple[bool, ...]:
        """Return which pieces of the present task of a memory are done."""
        step = min(memory.step, len(self._tasks) - 1)
        return memory.done[self._first[step] : self._first[step + 1]]

    def _moment(self, scope: Scope) -> Moment:
        tilt = 0.0 if self.joint is None else float(self.joint.memory.tilt)
        q = multiply(self._mount.q, quat_from_rpy(0.0, tilt, 0.0)) if tilt else self._mount.q
        return Moment(
            self.memory.before if self.memory.seen else scope.p_NB,
            scope.p_NB,
            eye_at(scope.position(self._mount.p), scope.attitude(q), self._config.view_deg),
            math.hypot(*scope.v_NB_B),
            math.hypot(*scope.w_NB_B),
            scope.geometry,
            self.outlines,
        )

    def _verdict(self, scope: Scope) -> Verdict:
        return self._task[1].judge(self._moment(scope), self._pieces(self.memory), self.memory.piece)

    def _updated_memory(self, scope: Scope, verdict: Verdict) -> TrainingMemory:
        m, now, p = self.memory, scope.t_ns, scope.p_NB
        new = structs.replace(m, place=m.place if m.seen else p, before=p, seen=True, mark=False)
        if m.ended_ns >= 0:
            return new
        if m.begun_ns < 0:
            if not _is_steered(scope, new.place):
                return new
            new.begun_ns = now
        if self._is_hit(scope):
            new.collisions += m.touched_ns < 0 or now - m.touched_ns > _SAME_COLLISION_NS
            new.touched_ns = now
        if (now - new.begun_ns) / NANOSECONDS > self._config.limit_s:
            new.ended_ns = now
            return new
        if m.mark:
            self._mark(new, scope)
        self._advance(new, verdict, now)
        return new

    def _mark(self, new: TrainingMemory, scope: Scope) -> None:
        """Judge a mark of the pilot."""
        _, task = self._task
        piece = task.marked(self._moment(scope), self._pieces(new))
        if piece >= 0:
            self._finish(new, piece)
        elif isinstance(task, Follow) and task.has_marks():
            new.lost = min(new.lost + task.wrong_mark_points, _MOST_LOST)

    def _advance(self, new: TrainingMemory, verdict: Verdict, now: int) -> None:
        """Finish a piece that was met long enough, and go on to the next task if this one is over."""
        _, task = self._task
        if verdict.piece < 0:
            new.piece, new.since_ns = -1, -1
        else:
            if verdict.piece != new.piece or new.since_ns < 0:
                new.piece, new.since_ns = verdict.piece, now
            if (now - new.since_ns) / NANOSECONDS >= task.for_s:
                self._finish(new, verdict.piece)
                new.piece, new.since_ns = -1, -1
        if task.is_over(self._pieces(new)):
            new.step += 1
            new.ended_ns = now if new.step == len(self._tasks) else -1

    def _finish(self, new: TrainingMemory, piece: int) -> None:
        at = self._first[new.step] + piece
        new.done = (*new.done[:at], True, *new.done[at + 1 :])

    def _is_hit(self, scope: Scope) -> bool:
        touches = [] if scope.wiring is None else scope.wiring.touches()
        return any(math.hypot(*touch.impulse) >= self._config.collision_Ns for touch in touches)

    def _report(self, scope: Scope, verdict: Verdict) -> list[Value]:
        m, now, config = self.memory, scope.t_ns, self._config
        end = m.ended_ns if m.ended_ns >= 0 else now
        time = (end - m.begun_ns) / NANOSECONDS if m.begun_ns >= 0 else 0.0
        left = max(0.0, config.limit_s - time)
        is_done = m.step == len(self._tasks)
        name, task = self._task
        state: State = "done" if is_done else "failed" if m.ended_ns >= 0 else "running" if m.begun_ns >= 0 else "ready"
        score = math.fsum(points for points, done in zip(self._worth, m.done, strict=True) if done) - m.lost
        score += config.points_per_s_left * left * is_done - config.collision_points * m.collisions
        held = (now - m.since_ns) / NANOSECONDS if m.since_ns >= 0 else 0.0
        pieces = self._pieces(m)
        named = [(each, done) for each, done in zip(task.names(), pieces, strict=True) if each]
        found = ", ".join(each for each, done in named if done)
        return [
            state if self.settings.running else "off", name, min(m.step + 1, len(self._tasks)), len(self._tasks), time, left, held, task.for_s,
            verdict.goal, math.dist(scope.p_NB, verdict.goal), m.collisions, score,
            task.part(pieces), verdict.hint if m.ended_ns < 0 else "", found, sum(not done for _, done in named), task.has_marks(), m.lost,
        ]  # fmt: skip


def _is_steered(scope: Scope, place: Vec3) -> bool:
    wiring = scope.wiring
    return (
        wiring.power() > STEERED_W
        if wiring is not None and wiring.electrics
        else math.dist(scope.p_NB, place) > MOVED_M
    )
