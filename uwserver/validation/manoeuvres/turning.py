"""The manoeuvres turning circle and zig-zag."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uwserver.frames import rpy_from_quat
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.kernel.layout import Q
from uwserver.units import rad
from uwserver.validation.manoeuvres.figures import (
    APPROACH_S,
    BY_THRUST,
    ON_THE_SPOT,
    TURNING_S,
    Column,
    Row,
    Trial,
    Value,
    degrees,
    first_time,
    level,
    mean,
    turn_told,
)
from uwserver.validation.manoeuvres.helm import GLIDE_DOWN, Sticks
from uwserver.validation.manoeuvres.runs import Track, Waters, then

RUDDER, ZIGZAG, ZIGZAG_BY_THRUST = rad(15.0), rad(10.0), rad(20.0)
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


ZIGZAGGED = (
    Column("approach", "speed before", "m/s"),
    Column("execute", "heading reached after", "s"),
    Column("first", "first overshoot", "rad"),
    Column("second", "second overshoot", "rad"),
    Column("period", "period", "s"),
)


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
