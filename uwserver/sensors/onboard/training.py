"""Training: tasks that a pilot carries out one after the other, judged by where the vehicle truly is; with time, collisions and a score."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta

from uwserver.frames import Vec3
from uwserver.modifiers import Measurement
from uwserver.modifiers.base import Memory
from uwserver.ports import Argument, Field, Json, Value
from uwserver.sensors.base import Pose, Scope, Sensor, SensorTable, Settings
from uwserver.table import NonNegative, Positive, Table, Vector3
from uwserver.units import NANOSECONDS, rad

Kind = Literal["reach", "hold_depth", "gate"]
State = Literal["ready", "running", "done", "failed", "off"]
_Extent = Annotated[float, Meta(gt=0.0, le=1e4)]
MOVED_M, STEERED_W = 0.3, 1.0
"""Time begins when the thrusters draw so much; of a vehicle without such ones when it is so far from where it stood."""
_APART_NS = NANOSECONDS
"""A touch so soon after another one is the same collision."""
_MOST_TASKS = 64


class Task(Table, kw_only=True, frozen=True):
    """One task of a pilot.

    Attributes:
        kind: "reach": be inside a box for `for_s`; "hold_depth": keep a depth for `for_s`; "gate": go through an opening, the way it points.
        position_ned_m: middle of the box or the opening.
        size_m: whole edges of the box, north, east, down; of a gate the second is its width and the third its height.
        heading_deg: way through a gate.
        depth_m, tolerance_m: to keep, and how far off it may be.
        for_s: how long without a break.
        points: what it is worth.
        text: what the pilot is told; default: the task's name.
    """

    kind: Kind
    position_ned_m: Vector3 = (0.0, 0.0, 0.0)
    size_m: tuple[_Extent, _Extent, _Extent] = (2.0, 2.0, 2.0)
    heading_deg: float = 0.0
    depth_m: float = 0.0
    tolerance_m: Positive = 0.25
    for_s: NonNegative = 0.0
    points: NonNegative = 100.0
    text: Annotated[str, Meta(max_length=200)] = ""

    def __post_init__(self) -> None:
        """ValueError where a task would be done at once."""
        if self.kind == "hold_depth" and self.for_s == 0.0:
            raise ValueError("hold_depth needs for_s: for how long the depth is kept")

    def goal(self, p: Vec3) -> Vec3:
        """Where the pilot is to go, m in N; of a depth below or above the vehicle."""
        return (p[0], p[1], self.depth_m) if self.kind == "hold_depth" else self.position_ned_m

    def is_met(self, before: Vec3, p: Vec3) -> bool:
        """Whether it is met at p, which was reached in a straight line."""
        if self.kind == "hold_depth":
            return abs(p[2] - self.depth_m) <= self.tolerance_m
        if self.kind == "reach":
            edges = zip(p, self.position_ned_m, self.size_m, strict=True)
            return all(abs(own - middle) <= 0.5 * size for own, middle, size in edges)
        return self._is_passed(before, p)

    def _is_passed(self, before: Vec3, p: Vec3) -> bool:
        c, s = math.cos(rad(self.heading_deg)), math.sin(rad(self.heading_deg))
        (n0, e0, d0), (n1, e1, d1) = (
            (q[0] - self.position_ned_m[0], q[1] - self.position_ned_m[1], q[2] - self.position_ned_m[2])
            for q in (before, p)
        )
        ahead0, ahead1 = c * n0 + s * e0, c * n1 + s * e1
        if not ahead0 < 0.0 <= ahead1:
            return False
        part = ahead0 / (ahead0 - ahead1)
        across = (c * e0 - s * n0) + part * ((c * e1 - s * n1) - (c * e0 - s * n0))
        down = d0 + part * (d1 - d0)
        return abs(across) <= 0.5 * self.size_m[1] and abs(down) <= 0.5 * self.size_m[2]


class TrainingConfig(SensorTable, tag="training", kw_only=True, frozen=True):
    """Tasks for a pilot. Time begins when its thrusters push; it is the simulation's.

    Attributes:
        tasks: by name, in the order of the file.
        limit_s: time for all of them; then the training has failed.
        collision_points: what a collision costs.
        collision_Ns: a weaker touch counts for none; it is felt at the instants of `rate_hz`.
        points_per_s_left: for time that is left when all is done.
    """

    tasks: dict[str, Task]
    limit_s: Positive = 600.0
    collision_points: NonNegative = 10.0
    collision_Ns: NonNegative = 0.5
    points_per_s_left: NonNegative = 1.0

    def __post_init__(self) -> None:
        """ValueError without a task, or with too many."""
        if not 0 < len(self.tasks) <= _MOST_TASKS:
            raise ValueError(f"a training has 1 to {_MOST_TASKS} tasks, not {len(self.tasks)}")

    def build(self, mount: Pose) -> Training:
        """The judge; its mount does not matter."""
        return Training(self)


class TrainingSettings(Settings, frozen=True):
    """Whether the pilot is judged."""

    running: bool = True


class TrainingMemory(Memory):
    """Attributes:
    place, before: where the vehicle stood at first, and at the last reading; m in N.
    seen: there was a reading.
    begun_ns, ended_ns: of this try; -1 before.
    step: tasks done.
    since_ns: since when the present task has been met; -1 while it is not.
    collisions, touched_ns: counted, and when the last touch was felt; -1 before."""

    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    before: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seen: bool = False
    begun_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    ended_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    step: Annotated[int, Meta(ge=0, le=_MOST_TASKS)] = 0
    since_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1
    collisions: Annotated[int, Meta(ge=0, le=2**31)] = 0
    touched_ns: Annotated[int, Meta(ge=-1, le=2**62)] = -1


class Training(Sensor):
    """Judges a pilot by the truth."""

    doc = (
        "Tasks for a pilot: which one it is, time, collisions and score. Time begins when its thrusters push. "
        "`set` with `running` = true begins anew, with false it ends."
    )
    fields = (
        Field("state", "1", "ready, running, done, failed (the time is over) or off", type="str"),
        Field("task", "1", "what is to be done now", type="str"),
        Field("number", "1", "of this task, from 1", type="int"),
        Field("count", "1", "of all tasks", type="int"),
        Field("time", "s", "since its thrusters pushed for the first time"),
        Field("left", "s", "until the time is over"),
        Field("held", "s", "for how long the task has been met without a break"),
        Field("hold", "s", "for how long it has to be"),
        Field("goal_p_NB", "m", "where to go", "N", (3,)),
        Field("distance", "m", "from there"),
        Field("collisions", "1", "in this try", type="int"),
        Field("score", "1", "tasks done, less collisions; when all is done with what the time left is worth"),
    )
    arguments = (Argument("running", "bool", "true begins anew, false ends it", required=False),)
    paces = True
    settings: TrainingSettings
    memory: TrainingMemory

    def __init__(self, config: TrainingConfig) -> None:
        self._config = config
        self._tasks = tuple((task.text or name, task) for name, task in config.tasks.items())
        super().__init__(TrainingSettings())

    def turn_on(self) -> TrainingMemory:
        """Nothing is done yet."""
        return TrainingMemory()

    def change(self, args: Mapping[str, Json]) -> None:
        """As of `Sensor`; to run means to begin anew."""
        super().change(args)
        if args.get("running"):
            self.memory = TrainingMemory()

    def valid(self, record: Memory | Settings) -> None:
        """As of `Sensor`; of a memory also that there are so many tasks, and that it has ended when all are done."""
        if isinstance(record, TrainingMemory) and record.step > len(self._tasks):
            raise ValueError(f"{record.step} tasks are done, and there are {len(self._tasks)}")
        if isinstance(record, TrainingMemory) and record.step == len(self._tasks) and record.ended_ns < 0:
            raise ValueError("all tasks are done, and it has not ended")
        super().valid(record)

    def sense(self, scope: Scope) -> Measurement:
        """How it stands; always valid."""
        if self.settings.running:
            self.memory = self._judged(scope)
        return Measurement(self._told(scope), True)

    def _judged(self, scope: Scope) -> TrainingMemory:
        m, now, p = self.memory, scope.t_ns, scope.p_NB
        place, begun, step, since, ended = m.place if m.seen else p, m.begun_ns, m.step, m.since_ns, m.ended_ns
        collisions, touched = m.collisions, m.touched_ns
        if ended < 0:
            if begun < 0 and _is_steered(scope, place):
                begun = now
            if begun >= 0 and self._is_hit(scope):
                collisions += touched < 0 or now - touched > _APART_NS
                touched = now
            if begun >= 0 and (now - begun) / NANOSECONDS > self._config.limit_s:
                ended = now
            elif begun >= 0:
                step, since = self._advanced(m.before if m.seen else p, p, now)
                ended = now if step == len(self._tasks) else -1
        return TrainingMemory(place, p, True, begun, ended, step, since, collisions, touched)

    def _advanced(self, before: Vec3, p: Vec3, now: int) -> tuple[int, int]:
        """Tasks done, and since when the next has been met."""
        step, since = self.memory.step, self.memory.since_ns
        _, task = self._tasks[step]
        if not task.is_met(before, p):
            return step, -1
        since = now if since < 0 else since
        return (step + 1, -1) if (now - since) / NANOSECONDS >= task.for_s else (step, since)

    def _is_hit(self, scope: Scope) -> bool:
        touches = [] if scope.wiring is None else scope.wiring.touches()
        return any(math.hypot(*touch.impulse) >= self._config.collision_Ns for touch in touches)

    def _told(self, scope: Scope) -> list[Value]:
        m, now, config = self.memory, scope.t_ns, self._config
        end = m.ended_ns if m.ended_ns >= 0 else now
        time = (end - m.begun_ns) / NANOSECONDS if m.begun_ns >= 0 else 0.0
        left = max(0.0, config.limit_s - time)
        is_done = m.step == len(self._tasks)
        name, task = self._tasks[min(m.step, len(self._tasks) - 1)]
        state: State = "done" if is_done else "failed" if m.ended_ns >= 0 else "running" if m.begun_ns >= 0 else "ready"
        score = sum(done.points for _, done in self._tasks[: m.step]) - config.collision_points * m.collisions
        score += config.points_per_s_left * left if is_done else 0.0
        held = (now - m.since_ns) / NANOSECONDS if m.since_ns >= 0 else 0.0
        goal = task.goal(scope.p_NB)
        return [
            state if self.settings.running else "off", name, min(m.step + 1, len(self._tasks)), len(self._tasks), time, left, held, task.for_s,
            goal, math.dist(scope.p_NB, goal), m.collisions, score,
        ]  # fmt: skip


def _is_steered(scope: Scope, place: Vec3) -> bool:
    wiring = scope.wiring
    return (
        wiring.power() > STEERED_W
        if wiring is not None and wiring.electrics
        else math.dist(scope.p_NB, place) > MOVED_M
    )
