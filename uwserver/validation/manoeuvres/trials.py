"""All manoeuvres but the turns: which sticks are moved, and which figures are read from the track, in SI units and radians."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray
from uwserver.units import rad
from uwserver.validation.manoeuvres.figures import (
    APPROACH_S,
    TURNING_S,
    Column,
    Row,
    Trial,
    Value,
    ahead,
    degrees,
    first_time,
    level,
    mean,
    steady_mean,
)
from uwserver.validation.manoeuvres.helm import GLIDE_DOWN, Sticks
from uwserver.validation.manoeuvres.runs import Plan, Track, Waters, hold, still, then

THROTTLES = (0.3, 0.6, 1.0)
SHORT_S, LONG_S = 20.0, 600.0
"""Times after which the figures of straight runs and dives, and those of ballast, which is slow, are read."""
PLANES, HEEL = rad(5.0), rad(10.0)


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
