"""The manoeuvres: which sticks are moved, and which figures are read from the track. All in SI and radians."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uwserver.frames import rpy_from_quat
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import Q
from uwserver.units import rad
from uwserver.validation.manoeuvres.helm import Sticks
from uwserver.validation.manoeuvres.runs import Plan, Track, Waters, hold, still, then

Value = float | None
"""None where there is nothing to tell: it did not get there."""

THROTTLES = (0.3, 0.6, 1.0)
LOOK_S = 20.0
"""After which a straight run and a dive are looked at."""
APPROACH_S, TURNING_S, LONG_S = 120.0, 180.0, 600.0
RUDDER, ZIGZAG, ZIGZAG_BY_THRUST, PLANES, HEEL = rad(15.0), rad(10.0), rad(20.0), rad(5.0), rad(10.0)


@dataclass(frozen=True)
class Column:
    """What is read: its name and unit; `key` for programs."""

    key: str
    name: str
    unit: str


@dataclass(frozen=True)
class Row:
    """Figures of one run, in the order of the trial's columns."""

    condition: str
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Trial:
    """One manoeuvre.

    Attributes:
        key: for programs.
        text: how it is done.
        rows: none where it does not apply.
        reason: why it does not.
    """

    key: str
    title: str
    text: str
    columns: tuple[Column, ...] = ()
    rows: tuple[Row, ...] = ()
    reason: str = ""

    def value(self, condition: str, key: str) -> Value:
        """One figure; None too where there is no such run."""
        k = next((k for k, column in enumerate(self.columns) if column.key == key), -1)
        return next((row.values[k] for row in self.rows if row.condition == condition), None) if k >= 0 else None


BY_THRUST, ON_THE_SPOT = "ahead 50 %, yaw 50 %", "on the spot, yaw 100 %"
"""How turns by thrusters are called."""


def ahead(throttle: float) -> str:
    """How a straight run is called."""
    return f"{'astern' if throttle < 0.0 else 'ahead'} {abs(100.0 * throttle):g} %"


def turn_told(throttle: float, angle: float) -> str:
    """How a turn by rudder (rad) is called."""
    return f"{ahead(throttle)}, rudder {_degrees(angle)}"


def _mean(values: FloatArray) -> float:
    return float(values.mean())


def _settled(values: FloatArray) -> Value:
    """The mean of what no longer changes by more than a tenth of it; None of anything else."""
    mean = _mean(values)
    return mean if float(np.ptp(values)) <= 0.1 * abs(mean) + 0.005 else None


def _first(t: FloatArray, reached: FloatArray) -> Value:
    """When a condition (k) holds for the first time, s."""
    k = np.flatnonzero(reached)
    return float(t[k[0]]) if len(k) else None


def left_alone(waters: Waters) -> Trial:
    """Without any command: whether it is trimmed, and how it rises or sinks."""
    (track,) = waters.sail([still], APPROACH_S)
    end = track.steady
    columns = (Column("roll", "roll", "rad"), Column("pitch", "pitch", "rad"), Column("sink", "sinks at", "m/s"))
    row = Row("hands off", (_mean(end.roll), _mean(end.pitch), _mean(end.down)))
    return Trial("rest", "Left alone", f"Let go level, {APPROACH_S:g} s without any command.", columns, (row,))


STRAIGHT = (
    Column("speed", "speed then", "m/s"),
    Column("tilt", "largest tilt until then", "rad"),
    Column("pitch", "pitch then", "rad"),
    Column("heading", "change of heading", "rad"),
    Column("way", "way ahead", "m"),
    Column("depth", "change of depth", "m"),
    Column("steady", "steady speed", "m/s"),
)


def straight(waters: Waters, throttles: Sequence[float] = THROTTLES) -> Trial:
    """From rest, throttle stepped, all else at neutral."""
    title = "Straight line"
    if not waters.helm.has("surge"):
        return Trial("straight", title, "", reason="nothing pushes it ahead")
    asked = (*throttles, -1.0) if waters.helm.has("yaw") else tuple(throttles)
    tracks = waters.sail([hold(Sticks(surge=throttle)) for throttle in asked], APPROACH_S)
    rows = []
    for throttle, track in zip(asked, tracks, strict=True):
        begin = track.until(LOOK_S)
        values = (
            float(begin.speed[-1]), float(begin.tilt.max()), float(begin.pitch[-1]),
            float(begin.heading[-1] - begin.heading[0]), float(begin.p[-1, 0]), float(begin.p[-1, 2]), _settled(track.steady.speed),
        )  # fmt: skip
        rows.append(Row(ahead(throttle), values))
    text = f"From rest, throttle stepped, everything else at neutral; looked at after {LOOK_S:g} s. Steady: mean of 108 to 120 s."
    return Trial("straight", title, text, STRAIGHT, tuple(rows))


CIRCLE = (
    Column("approach", "speed before", "m/s"),
    Column("advance", "advance", "m"),
    Column("tactical", "tactical diameter", "m"),
    Column("diameter", "steady diameter", "m"),
    Column("rate", "rate of turn", "rad/s"),
    Column("speed", "speed in the turn", "m/s"),
    Column("roll", "roll", "rad"),
    Column("sink", "sinks at", "m/s"),
)


def turning_circle(waters: Waters, more: Sequence[tuple[float, float]] = ()) -> Trial:
    """At full throttle, rudder or yaw to starboard; `more` runs at (throttle, rudder angle in rad)."""
    title, helm = "Turning circle", waters.helm
    turns: list[tuple[str, Sticks, Sticks]] = []
    if helm.has("rudder") and helm.has("surge"):
        for throttle, angle in dict.fromkeys([(1.0, min(RUDDER, helm.rudder)), *more]):
            turns.append((turn_told(throttle, angle), Sticks(surge=throttle), Sticks(surge=throttle, rudder=angle)))
    if helm.has("yaw"):
        if helm.has("surge"):
            turns.append((BY_THRUST, Sticks(surge=0.5), Sticks(surge=0.5, yaw=0.5)))
        turns.append((ON_THE_SPOT, Sticks(), Sticks(yaw=1.0)))
    if not turns:
        return Trial("turn", title, "", reason="it has neither rudder nor a pair of thrusters that turns it")
    tracks = waters.sail([then(before, APPROACH_S, after) for _, before, after in turns], APPROACH_S + TURNING_S)
    rows = tuple(Row(told, _circle(track)) for (told, _, _), track in zip(turns, tracks, strict=True))
    text = f"After {APPROACH_S:g} s straight ahead, to starboard for {TURNING_S:g} s; advance at 90, tactical diameter at 180 degrees."
    return Trial("turn", title, text, CIRCLE, rows)


def _circle(track: Track) -> tuple[Value, ...]:
    turn, before = track.since(APPROACH_S), float(track.until(APPROACH_S).u[-1])
    turned, end = turn.heading - turn.heading[0], turn.steady
    rate, speed = _mean(np.diff(end.heading)) / float(end.t[1]), _mean(np.hypot(*_level(end)))
    spot = abs(before) < 0.01
    quarter, half = (_first(turn.t, np.abs(turned) >= angle) for angle in (0.5 * math.pi, math.pi))
    advance = None if quarter is None or spot else float(turn.until(quarter).p[-1, 0])
    tactical = None if half is None or spot else abs(float(turn.until(half).p[-1, 1]))
    diameter = None if spot or abs(rate) < 1e-4 else 2.0 * speed / abs(rate)
    return before, advance, tactical, diameter, rate, speed, _mean(end.roll), _mean(end.down)


def _level(track: Track) -> tuple[FloatArray, FloatArray]:
    """North and east velocity, m/s."""
    dt = float(track.t[1] - track.t[0])
    return np.gradient(track.states[:, 0], dt), np.gradient(track.states[:, 1], dt)


def _degrees(angle: float) -> str:
    return f"{round(angle / rad(1.0), 2):g} degrees"


class _ZigZag:
    """Rudder to one side until the heading has changed by an angle, then to the other side, and so on."""

    def __init__(self, one: Sticks, other: Sticks, angle: float) -> None:
        self._sticks, self._angle, self._side = (one, other), angle, 0
        self._start: float | None = None

    def __call__(self, _t: float, state: FloatArray) -> Sticks:
        heading = rpy_from_quat(state[Q : Q + 4])[2]
        if self._start is None:
            self._start = heading
        turned = math.remainder(heading - self._start, 2.0 * math.pi)
        if (turned if self._side == 0 else -turned) >= self._angle:
            self._side = 1 - self._side
        return self._sticks[self._side]


ZIGZAGGED = (
    Column("approach", "speed before", "m/s"),
    Column("execute", "heading reached after", "s"),
    Column("first", "first overshoot", "rad"),
    Column("second", "second overshoot", "rad"),
    Column("period", "period", "s"),
)


def zig_zag(waters: Waters) -> Trial:
    """Rudder and heading by the same angle; vehicles steered by two thrusters by half of the yaw."""
    title, helm = "Zig-zag", waters.helm
    if not helm.has("surge"):
        return Trial("zigzag", title, "", reason="nothing pushes it ahead")
    if helm.has("rudder"):
        angle = min(ZIGZAG, helm.rudder)
        before, one, other = (Sticks(surge=1.0, rudder=side * angle) for side in (0.0, 1.0, -1.0))
        told = f"ahead 100 %, rudder and heading {_degrees(angle)}"
    elif helm.has("yaw") and not helm.has("sway"):
        angle = ZIGZAG_BY_THRUST
        before, one, other = (Sticks(surge=0.5, yaw=0.5 * side) for side in (0.0, 1.0, -1.0))
        told = f"ahead 50 %, yaw 50 %, heading {_degrees(angle)}"
    else:
        return Trial("zigzag", title, "", reason="it has no rudder: thrusters turn it on the spot and push it sideways")
    (track,) = waters.sail([then(before, APPROACH_S, _ZigZag(one, other, angle))], APPROACH_S + TURNING_S)
    text = f"After {APPROACH_S:g} s straight ahead, first to starboard. Overshoot: of the heading beyond that of the order."
    return Trial("zigzag", title, text, ZIGZAGGED, (Row(told, _overshoots(track, angle)),))


def _overshoots(track: Track, angle: float) -> tuple[Value, ...]:
    run, before = track.since(APPROACH_S), float(track.until(APPROACH_S).speed[-1])
    turned = run.heading - run.heading[0]
    first = _first(run.t, turned >= angle)
    second = None if first is None else _first(run.t, (run.t > first) & (turned <= -angle))
    third = None if second is None else _first(run.t, (run.t > second) & (turned >= angle))
    one = None if first is None or second is None else float(turned[run.t <= second].max()) - angle
    two = None if second is None or third is None else -float(turned[run.t <= third].min()) - angle
    period = None if first is None or third is None else third - first
    return before, first, one, two, period


RISE = (
    Column("sink", "sinks at", "m/s"),
    Column("pitch", "pitch", "rad"),
    Column("tilt", "largest tilt", "rad"),
    Column("speed", "speed", "m/s"),
    Column("depth", "change of depth", "m"),
)


def dive(waters: Waters) -> Trial:
    """By vertical thrust, by planes at full throttle, by ballast; whatever there is."""
    title, helm = "Dive", waters.helm
    if waters.floats:
        return Trial("dive", title, "", reason="it stays at the surface")
    rows: list[Row] = []
    if helm.has("heave"):
        rows += _risen(
            waters, (("down 100 %", hold(Sticks(heave=1.0))), ("up 100 %", hold(Sticks(heave=-1.0)))), 0.0, 60.0
        )
    if helm.has("planes") and helm.has("surge"):
        angle = min(PLANES, helm.planes)
        plans = [
            (f"planes {_degrees(angle)} to {word}", then(Sticks(surge=1.0), APPROACH_S, Sticks(surge=1.0, planes=side * angle)))
            for word, side in (("dive", 1.0), ("rise", -1.0))
        ]  # fmt: skip
        rows += _risen(waters, plans, APPROACH_S, LOOK_S)
    if helm.has("sink"):
        plans = [
            (f"ballast as {word} as it gets", hold(Sticks(sink=side)))
            for word, side in (("heavy", 1.0), ("light", -1.0))
        ]
        rows += _risen(waters, plans, 0.0, LONG_S)
    if not rows:
        return Trial("dive", title, "", reason="it has neither vertical thrust nor planes nor ballast")
    text = (
        f"Vertical thrust for 60 s from rest; planes for {LOOK_S:g} s after {APPROACH_S:g} s ahead at full throttle; ballast for "
        f"{LONG_S:g} s from rest. Rates are means of the last tenth."
    )
    return Trial("dive", title, text, RISE, tuple(rows))


def _risen(waters: Waters, plans: Sequence[tuple[str, Plan]], begin: float, seconds: float) -> list[Row]:
    rows = []
    for (told, _), track in zip(plans, waters.sail([plan for _, plan in plans], begin + seconds), strict=True):
        run = track.since(begin)
        end = run.steady
        values = (_mean(end.down), _mean(end.pitch), float(run.tilt.max()), _mean(end.speed), float(run.p[-1, 2]))
        rows.append(Row(told, values))
    return rows


GLIDE = (
    Column("speed", "speed", "m/s"),
    Column("angle", "angle of the path below the horizon", "rad"),
    Column("pitch", "pitch", "rad"),
    Column("sink", "sinks at", "m/s"),
)


def glide(waters: Waters) -> Trial:
    """Heavy and nose down, then light and nose up, without thrust: for what has ballast, a moving mass and no propulsor."""
    helm = waters.helm
    if not (helm.has("sink") and helm.has("nose_down")) or helm.has("surge"):
        return Trial(
            "glide", "Glide", "", reason="it is no glider: that needs ballast and a moving mass, and no propulsor"
        )
    sticks = {"down": Sticks(sink=1.0, nose_down=1.0), "up": Sticks(sink=-1.0, nose_down=-1.0)}
    rows = []
    for told, track in zip(sticks, waters.sail([hold(each) for each in sticks.values()], LONG_S), strict=True):
        end = track.steady
        down = _mean(end.down)
        angle = math.atan2(down, _mean(np.hypot(*_level(end))))
        rows.append(Row(told, (_mean(end.speed), angle, _mean(end.pitch), down)))
    return Trial(
        "glide",
        "Glide",
        f"Ballast and moving mass as far as they go, {LONG_S:g} s from rest; the last tenth.",
        GLIDE,
        tuple(rows),
    )


def sway(waters: Waters) -> Trial:
    """Full sideways thrust from rest."""
    if not waters.helm.has("sway"):
        return Trial("sway", "Sideways", "", reason="nothing pushes it sideways")
    (track,) = waters.sail([hold(Sticks(sway=1.0))], 60.0)
    end = track.steady
    columns = (
        Column("speed", "speed", "m/s"),
        Column("tilt", "largest tilt", "rad"),
        Column("heading", "change of heading", "rad"),
    )
    row = Row(
        "to starboard 100 %", (_mean(end.speed), float(track.tilt.max()), float(track.heading[-1] - track.heading[0]))
    )
    return Trial("sway", "Sideways", "From rest, 60 s; the speed is the mean of the last tenth.", columns, (row,))


DECAY = (
    Column("period", "period", "s"),
    Column("ratio", "damping ratio", "1"),
    Column("settle", "falls to 1/e after", "s"),
)


def free_decay(waters: Waters) -> Trial:
    """Heeled and pitched by 10 degrees at rest, and let go, beside one that is not."""
    rolled, pitched, level = waters.sail([still] * 3, APPROACH_S, ((HEEL, 0.0, 0.0), (0.0, HEEL, 0.0), (0.0, 0.0, 0.0)))
    rows = (
        Row("roll", _swing(level.t, rolled.roll - level.roll)),
        Row("pitch", _swing(level.t, pitched.pitch - level.pitch)),
    )
    text = (
        "At rest, turned by 10 degrees and let go; the angle over that of one let go level. Period from the zero crossings, damping ratio from\n"
        "the decrement of the first swings; no period: it creeps back without a swing."
    )
    return Trial("decay", "Free decay", text, DECAY, rows)


def _swing(t: FloatArray, angle: FloatArray) -> tuple[Value, ...]:
    crossings = np.flatnonzero(angle[:-1] * angle[1:] < 0.0)
    size = np.abs(angle)
    late = np.flatnonzero(size > size[0] / math.e)
    settle = float(t[late[-1]]) if late[-1] < len(t) - 1 else None
    edges = [0, *crossings.tolist()]
    peaks = [float(size[a : b + 1].max()) for a, b in zip(edges, [*edges[1:], len(t)], strict=True)]
    peaks = [peak for peak in peaks if peak > 0.01 * size[0]][:4]
    if len(peaks) < 2:
        return None, None, settle
    decrement = math.log(peaks[0] / peaks[-1]) / (len(peaks) - 1)
    moments = t[crossings[: max(len(peaks), 2)]]
    # A swing crosses zero first between a quarter and a half of its period; what comes much later is another, slower motion.
    if len(moments) < 2 or float(moments[1]) > 3.2 * float(moments[0]):
        return None, None, settle
    return 2.0 * float(np.diff(moments).mean()), decrement / math.hypot(math.pi, decrement), settle


STOP = (Column("approach", "speed before", "m/s"), Column("time", "after", "s"), Column("way", "way", "m"))


def stop(waters: Waters) -> Trial:
    """From full speed: thrust off until a tenth of it is left, and full astern until it stands."""
    helm = waters.helm
    if not helm.has("surge"):
        return Trial("stop", "Stop", "", reason="nothing pushes it ahead")
    full = Sticks(surge=1.0)
    plans = [then(full, APPROACH_S, still), then(full, APPROACH_S, Sticks(surge=-1.0))]
    parts: tuple[tuple[str, Callable[[Track, float], FloatArray]], ...] = (
        ("thrust off, to a tenth of the speed", lambda run, before: run.u <= 0.1 * before),
        ("full astern, to a standstill", lambda run, _: run.u <= 0.0),
    )
    rows = []
    for (told, reached), track in zip(parts, waters.sail(plans, APPROACH_S + TURNING_S), strict=True):
        run, before = track.since(APPROACH_S), float(track.until(APPROACH_S).u[-1])
        at = _first(run.t, reached(run, before))
        way = None if at is None else float(np.linalg.norm(np.diff(run.until(at).p, axis=0), axis=1).sum())
        rows.append(Row(told, (before, at, way)))
    return Trial("stop", "Stop", f"After {APPROACH_S:g} s at full throttle.", STOP, tuple(rows))
