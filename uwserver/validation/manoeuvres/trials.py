"""All manoeuvres: which sticks are moved, and which figures are read from the track, in SI units and radians."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from uwserver.frames import rpy_from_quat
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import Q
from uwserver.units import rad
from uwserver.validation.manoeuvres.helm import GLIDE_DOWN, Sticks
from uwserver.validation.manoeuvres.runs import (
    APPROACH_S,
    BY_THRUST,
    ON_THE_SPOT,
    TURNING_S,
    Column,
    Plan,
    Row,
    Track,
    Trial,
    Value,
    Waters,
    ahead,
    degrees,
    first_time,
    hold,
    level,
    mean,
    steady_mean,
    still,
    then,
    turn_told,
)

THROTTLES = (0.3, 0.6, 1.0)
SHORT_S, LONG_S = 20.0, 600.0
"""Times after which the figures of straight runs and dives, and those of ballast, which is slow, are read."""
PLANES, HEEL = rad(5.0), rad(10.0)
RUDDER, ZIGZAG, ZIGZAG_BY_THRUST = rad(15.0), rad(10.0), rad(20.0)
ZIGZAGGED = (
    Column("approach", "speed before", "m/s"),
    Column("execute", "heading reached after", "s"),
    Column("first", "first overshoot", "rad"),
    Column("second", "second overshoot", "rad"),
    Column("period", "period", "s"),
)


def left_alone(waters: Waters) -> Trial:
    """Run without any command, which shows whether the vehicle is trimmed, and how it rises or sinks."""
    (track,) = waters.sail([still], APPROACH_S)
    end = track.steady
    columns = (Column("roll", "roll", "rad"), Column("pitch", "pitch", "rad"), Column("sink", "sinks at", "m/s"))
    row = Row("hands off", (mean(end.roll), mean(end.pitch), mean(end.down)))
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
    """Step the throttle from rest, with everything else at neutral."""
    key, title = "straight", "Straight line"
    if not waters.helm.has("surge"):
        return Trial(key, title, reason="nothing pushes it ahead")
    asked = (*throttles, -1.0) if waters.helm.has("yaw") else tuple(throttles)
    tracks = waters.sail([hold(Sticks(surge=throttle)) for throttle in asked], APPROACH_S)
    rows = []
    for throttle, track in zip(asked, tracks, strict=True):
        begin = track.until(SHORT_S)
        values = (
            float(begin.speed[-1]), float(begin.tilt.max()), float(begin.pitch[-1]),
            float(begin.heading[-1] - begin.heading[0]), float(begin.p[-1, 0]), float(begin.p[-1, 2]), steady_mean(track.steady.speed),
        )  # fmt: skip
        rows.append(Row(ahead(throttle), values))
    text = f"From rest, throttle stepped, everything else at neutral; figures after {SHORT_S:g} s. Steady: mean of 108 to 120 s."
    return Trial(key, title, text, STRAIGHT, tuple(rows))


RISE = (
    Column("sink", "sinks at", "m/s"),
    Column("pitch", "pitch", "rad"),
    Column("tilt", "largest tilt", "rad"),
    Column("speed", "speed", "m/s"),
    Column("depth", "change of depth", "m"),
)


def dive(waters: Waters) -> Trial:
    """Dive and rise by vertical thrust, by planes at full throttle, and by ballast, as far as the vehicle has them."""
    key, title, helm = "dive", "Dive", waters.helm
    if waters.floats:
        return Trial(key, title, reason="it stays at the surface")
    rows: list[Row] = []
    if helm.has("heave"):
        plans = {f"{word} 100 %": hold(Sticks(heave=side)) for word, side in (("down", 1.0), ("up", -1.0))}
        rows += _risen(waters, plans, 0.0, 60.0)
    if helm.has("planes") and helm.has("surge"):
        angle, full = min(PLANES, helm.planes), Sticks(surge=1.0)
        plans = {
            f"planes {degrees(angle)} to {word}": then(full, APPROACH_S, full._replace(planes=side * angle))
            for word, side in (("dive", 1.0), ("rise", -1.0))
        }
        rows += _risen(waters, plans, APPROACH_S, SHORT_S)
    if helm.has("sink"):
        plans = {
            f"ballast as {word} as it gets": hold(Sticks(sink=side)) for word, side in (("heavy", 1.0), ("light", -1.0))
        }
        rows += _risen(waters, plans, 0.0, LONG_S)
    if not rows:
        return Trial(key, title, reason="it has neither vertical thrust nor planes nor ballast")
    text = (
        f"Vertical thrust for 60 s from rest; planes for {SHORT_S:g} s after {APPROACH_S:g} s ahead at full throttle; ballast for "
        f"{LONG_S:g} s from rest. Rates are means of the last tenth."
    )
    return Trial(key, title, text, RISE, tuple(rows))


def _risen(waters: Waters, plans: Mapping[str, Plan], begin: float, seconds: float) -> Iterator[Row]:
    """Yield the figures of each run from a time (s) on."""
    for told, track in zip(plans, waters.sail(list(plans.values()), begin + seconds), strict=True):
        run = track.since(begin)
        end = run.steady
        values = (mean(end.down), mean(end.pitch), float(run.tilt.max()), mean(end.speed), float(run.p[-1, 2]))
        # Planes that are held overcome a short righting arm at speed, and the means over a loop are no rate of descent.
        yield Row(f"{told} (it loops)" if run.tilt.max() > math.pi / 2 else told, values)


GLIDE = (
    Column("speed", "speed", "m/s"),
    Column("angle", "angle of the path below the horizon", "rad"),
    Column("pitch", "pitch", "rad"),
    Column("sink", "sinks at", "m/s"),
)


def glide(waters: Waters) -> Trial:
    """Glide down heavy and up light, without thrust, by ballast alone and with the moving mass."""
    key, title = "glide", "Glide"
    if not waters.helm.glides:
        return Trial(key, title, reason="it is no glider: that needs ballast and a moving mass, and no propulsor")
    sticks = {
        "down": Sticks(sink=1.0),
        "up": Sticks(sink=-1.0),
        "down, mass forward": GLIDE_DOWN,
        "up, mass aft": Sticks(sink=-1.0, nose_down=-1.0),
    }
    rows = []
    for told, track in zip(sticks, waters.sail([hold(each) for each in sticks.values()], LONG_S), strict=True):
        end = track.steady
        down = mean(end.down)
        angle = math.atan2(down, mean(np.hypot(*level(end))))
        rows.append(Row(told, (mean(end.speed), angle, mean(end.pitch), down)))
    text = f"Ballast, and moving mass, as far as they go, {LONG_S:g} s from rest; means of the last tenth."
    return Trial(key, title, text, GLIDE, tuple(rows))


def sway(waters: Waters) -> Trial:
    """Give full sideways thrust from rest."""
    key, title = "sway", "Sideways"
    if not waters.helm.has("sway"):
        return Trial(key, title, reason="nothing pushes it sideways")
    (track,) = waters.sail([hold(Sticks(sway=1.0))], 60.0)
    end = track.steady
    columns = (
        Column("speed", "speed", "m/s"),
        Column("tilt", "largest tilt", "rad"),
        Column("heading", "change of heading", "rad"),
    )
    row = Row(
        "to starboard 100 %", (mean(end.speed), float(track.tilt.max()), float(track.heading[-1] - track.heading[0]))
    )
    return Trial(key, title, "From rest, 60 s; the speed is the mean of the last tenth.", columns, (row,))


DECAY = (
    Column("period", "period", "s"),
    Column("ratio", "damping ratio", "1"),
    Column("settle", "falls to 1/e after", "s"),
)


def free_decay(waters: Waters) -> Trial:
    """Let the vehicle go at rest, heeled and pitched by 10 degrees, beside one that is level."""
    rolled, pitched, level = waters.sail([still] * 3, APPROACH_S, ((HEEL, 0.0, 0.0), (0.0, HEEL, 0.0), (0.0, 0.0, 0.0)))
    rows = (
        Row("roll", _swing(level.t, rolled.roll - level.roll)),
        Row("pitch", _swing(level.t, pitched.pitch - level.pitch)),
    )
    text = (
        "At rest, turned by 10 degrees and let go; angles are relative to a vehicle that is let go level. The period follows from zero crossings,\n"
        "the damping ratio from the decrement of the first swings. Without a period the vehicle creeps back without a swing."
    )
    return Trial("decay", "Free decay", text, DECAY, rows)


def _swing(t: FloatArray, angle: FloatArray) -> tuple[Value, ...]:
    """Return the period (s), the damping ratio, and the time after which the angle stays below 1/e of its beginning (s)."""
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
    # A swing first crosses zero after a quarter to a half of its period. A second crossing much later belongs to another, slower motion.
    if len(moments) < 2 or float(moments[1]) > 3.2 * float(moments[0]):
        return None, None, settle
    return 2.0 * float(np.diff(moments).mean()), decrement / math.hypot(math.pi, decrement), settle


STOP = (Column("approach", "speed before", "m/s"), Column("time", "after", "s"), Column("way", "way", "m"))


def stop(waters: Waters) -> Trial:
    """Stop from full speed: thrust off until a tenth of the speed is left, and full astern until the vehicle stands."""
    key, title = "stop", "Stop"
    if not waters.helm.has("surge"):
        return Trial(key, title, reason="nothing pushes it ahead")
    full = Sticks(surge=1.0)
    plans = [then(full, APPROACH_S, still), then(full, APPROACH_S, Sticks(surge=-1.0))]
    parts: tuple[tuple[str, Callable[[Track, float], npt.NDArray[np.bool_]]], ...] = (
        ("thrust off, to a tenth of the speed", lambda run, before: run.u <= 0.1 * before),
        ("full astern, to a standstill", lambda run, _: run.u <= 0.0),
    )
    rows = []
    for (told, reached), track in zip(parts, waters.sail(plans, APPROACH_S + TURNING_S), strict=True):
        run, before = track.since(APPROACH_S), float(track.until(APPROACH_S).u[-1])
        at = first_time(run.t, reached(run, before))
        way = None if at is None else float(np.linalg.norm(np.diff(run.until(at).p, axis=0), axis=1).sum())
        rows.append(Row(told, (before, at, way)))
    return Trial(key, title, f"After {APPROACH_S:g} s at full throttle.", STOP, tuple(rows))


# -- turns ------------------------------------------------------------------------------------------------------------------------------

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
    """Turn to starboard by rudder or yaw, at full throttle or in a glide; also at each (throttle, rudder angle in rad) of `more`."""
    title, helm = "Turning circle", waters.helm
    turns: list[tuple[str, Sticks, Sticks]] = []
    if helm.has("rudder"):
        angle = min(RUDDER, helm.rudder)
        for throttle, delta in dict.fromkeys([(1.0, angle), *more]) if helm.has("surge") else ():
            turns.append((turn_told(throttle, delta), Sticks(surge=throttle), Sticks(surge=throttle, rudder=delta)))
        if helm.glides:
            told = f"gliding down, rudder {degrees(angle)}"
            turns.append((told, GLIDE_DOWN, GLIDE_DOWN._replace(rudder=angle)))
    if helm.has("yaw"):
        if helm.has("surge"):
            turns.append((BY_THRUST, Sticks(surge=0.5), Sticks(surge=0.5, yaw=0.5)))
        turns.append((ON_THE_SPOT, Sticks(), Sticks(yaw=1.0)))
    if not turns:
        return Trial("turn", title, reason="it has neither rudder nor a pair of thrusters that turns it")
    tracks = waters.sail([then(before, APPROACH_S, after) for _, before, after in turns], APPROACH_S + TURNING_S)
    rows = tuple(Row(told, _circle(track)) for (told, _, _), track in zip(turns, tracks, strict=True))
    text = (
        f"After {APPROACH_S:g} s straight ahead, or gliding down, to starboard for {TURNING_S:g} s; advance at 90 degrees, tactical diameter at\n"
        "180 degrees."
    )
    return Trial("turn", title, text, CIRCLE, rows)


def _circle(track: Track) -> tuple[Value, ...]:
    turn, before = track.since(APPROACH_S), float(track.until(APPROACH_S).u[-1])
    turned, end = turn.heading - turn.heading[0], turn.steady
    rate, speed = mean(np.diff(end.heading)) / float(end.t[1]), mean(np.hypot(*level(end)))
    spot = abs(before) < 0.01
    quarter, half = (first_time(turn.t, np.abs(turned) >= angle) for angle in (0.5 * math.pi, math.pi))
    advance = None if quarter is None or spot else float(turn.until(quarter).p[-1, 0])
    tactical = None if half is None or spot else abs(float(turn.until(half).p[-1, 1]))
    diameter = None if spot or abs(rate) < 1e-4 else 2.0 * speed / abs(rate)
    return before, advance, tactical, diameter, rate, speed, mean(end.roll), mean(end.down)


class _ZigZag:
    """The plan of a zig-zag: rudder to one side until the heading has changed by an angle, then to the other side, and so on."""

    def __init__(self, one: Sticks, other: Sticks, angle: float) -> None:
        self._sticks, self._angle, self._side = (one, other), angle, 0
        self._start: float | None = None

    def __call__(self, _t: float, state: FloatArray) -> Sticks:
        heading = rpy_from_quat(state[Q : Q + 4].tolist())[2]
        if self._start is None:
            self._start = heading
        turned = math.remainder(heading - self._start, 2.0 * math.pi)
        if (turned if self._side == 0 else -turned) >= self._angle:
            self._side = 1 - self._side
        return self._sticks[self._side]


def zig_zag(waters: Waters) -> Trial:
    """Zig-zag with the same angle of rudder and heading. Vehicles that are steered by two thrusters use half of the yaw."""
    title, helm = "Zig-zag", waters.helm
    if not helm.has("surge"):
        return Trial("zigzag", title, reason="nothing pushes it ahead")
    if helm.has("rudder"):
        angle = min(ZIGZAG, helm.rudder)
        before, one, other = (Sticks(surge=1.0, rudder=side * angle) for side in (0.0, 1.0, -1.0))
        told = f"ahead 100 %, rudder and heading {degrees(angle)}"
    elif helm.has("yaw") and not helm.has("sway"):
        angle = ZIGZAG_BY_THRUST
        before, one, other = (Sticks(surge=0.5, yaw=0.5 * side) for side in (0.0, 1.0, -1.0))
        told = f"ahead 50 %, yaw 50 %, heading {degrees(angle)}"
    else:
        return Trial("zigzag", title, reason="it has no rudder: thrusters turn it on the spot and push it sideways")
    (track,) = waters.sail([then(before, APPROACH_S, _ZigZag(one, other, angle))], APPROACH_S + TURNING_S)
    text = f"After {APPROACH_S:g} s straight ahead, first to starboard. The overshoot is how far the heading goes beyond the angle of the order."
    return Trial("zigzag", title, text, ZIGZAGGED, (Row(told, _overshoots(track, angle)),))


def _overshoots(track: Track, angle: float) -> tuple[Value, ...]:
    run, before = track.since(APPROACH_S), float(track.until(APPROACH_S).speed[-1])
    turned = run.heading - run.heading[0]
    first = first_time(run.t, turned >= angle)
    second = None if first is None else first_time(run.t, (run.t > first) & (turned <= -angle))
    third = None if second is None else first_time(run.t, (run.t > second) & (turned >= angle))
    one = None if first is None or second is None else float(turned[run.t <= second].max()) - angle
    two = None if second is None or third is None else -float(turned[run.t <= third].min()) - angle
    period = None if first is None or third is None else third - first
    return before, first, one, two, period
