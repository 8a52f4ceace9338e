"""Follow a pipe: the sonar's head swings across the track and finds what stands out of the bottom, the altimeter holds the height above it.

uwserver run examples/pipe.toml --paused
python examples/pipe.py --out pipe.png
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from itertools import pairwise

import uwclient
from bluerov2 import DT_S, TICKS, DeadReckoning, Pilot, until_heard, wrapped

PIPE = ((0.0, 0.0), (10.0, 0.0), (19.396926, 3.420201), (29.245, 1.683719))
"""For the figures at the end only: the follower does not know it."""
SPEED_MPS, HEIGHT_M = 0.3, 1.5
"""Ahead, and above the pipe."""
STANDS_OUT_M, SWEEPS_LOST = 0.2, 4
"""What is a pipe, and after how many sweeps without one it has ended."""

Row = tuple[float, ...]
"""Time, true place (3), distance from the pipe's axis, height by the altimeter."""


class Sweeps:
    """From pings to the place of the pipe across the track, once a swing of the head."""

    def __init__(self) -> None:
        self._echoes: list[tuple[float, float]] = []
        self._angle, self._way = 0.0, 0.0

    def update(self, ping: uwclient.Sample) -> tuple[bool, float | None]:
        """Whether a swing has ended; how far to starboard the pipe lies, None where nothing stands out of the bottom."""
        angle, bins = ping.number("head_angle"), ping["bins"]
        way = angle - self._angle
        ended = way * self._way < 0.0
        found = self._pipe() if ended else None
        if ended:
            self._echoes.clear()
        self._angle, self._way = angle, way or self._way
        # The first bin that is nearly as loud as the loudest is the edge of what the beam meets.
        edge = next(k for k, level in enumerate(bins) if level >= max(bins) - 30)
        reach = (edge + 0.5) / len(bins) * ping.number("range")
        self._echoes.append((reach * math.sin(angle), reach * math.cos(angle)))
        return ended, found

    def _pipe(self) -> float | None:
        below = sorted(z for _, z in self._echoes)
        if len(below) < 10:
            return None
        top, bottom = below[1], below[int(0.7 * len(below))]
        if bottom - top < STANDS_OUT_M:
            return None
        high = [y for y, z in self._echoes if z < 0.5 * (top + bottom)]
        return sum(high) / len(high)


def fitted(points: deque[tuple[float, float]], course: float) -> float:
    """Course of the line through the points, of its two ways that which is nearer to `course`."""
    n, e = (sum(p[k] for p in points) / len(points) for k in (0, 1))
    nn, ee, ne = (sum((p[i] - m) * (p[j] - o) for p in points) for i, j, m, o in ((0, 0, n, n), (1, 1, e, e), (0, 1, n, e)))  # fmt: skip
    angle = 0.5 * math.atan2(2 * ne, nn - ee)
    return angle if abs(wrapped(angle - course)) < math.pi / 2 else angle + math.pi


def from_pipe(north: float, east: float) -> float:
    """Distance from the axis of the pipe, in the plane."""
    found = math.inf
    for (n0, e0), (n1, e1) in pairwise(PIPE):
        dn, de = n1 - n0, e1 - e0
        s = max(0.0, min(1.0, ((north - n0) * dn + (east - e0) * de) / (dn * dn + de * de)))
        found = min(found, math.hypot(north - n0 - s * dn, east - e0 - s * de))
    return found


def drive(client: uwclient.Client) -> tuple[list[Row], list[tuple[float, float]]]:
    """Rows, and the places where the pipe was seen; the world must be paused."""
    heard = ("depth", "imu", "ahrs", "dvl", "altimeter", "truth/pose")
    for name in heard:
        client.subscribe(f"rov/{name}", delivery="latest")
    client.subscribe("rov/sonar")
    until_heard(client, [f"rov/{name}" for name in heard])
    start = client.latest("rov/truth/pose").vector("p_NB")  # where it was put into the water
    place, pilot, sweeps = DeadReckoning(start[0], start[1]), Pilot(start[2], 0.0), Sweeps()
    pilot.depth.value = start[2]
    seen, recent, lost = list[tuple[float, float]](), deque[tuple[float, float]](maxlen=6), 0
    course, across, down, rows = 0.0, 0.0, start[2], list[Row]()
    for k in range(4000):
        client.step(TICKS)
        sample = {name: client.latest(f"rov/{name}") for name in heard}
        place.update(sample["dvl"], sample["ahrs"])
        s, c = math.sin(place.heading), math.cos(place.heading)
        while (ping := _next(client)) is not None:
            ended, side = sweeps.update(ping)
            lost += ended and side is None
            if side is not None:
                recent.append((place.north + 0.2 * c - side * s, place.east + 0.2 * s + side * c))
                seen.append(recent[-1])
                lost = 0
        if lost >= SWEEPS_LOST:
            return rows, seen
        if len(recent) >= 4 and math.dist(recent[0], recent[-1]) > 1.2:
            course = fitted(recent, course)
        if recent:  # how far to starboard of the line through the newest points the vehicle is
            n, e = (sum(p[i] for p in list(recent)[-3:]) / len(list(recent)[-3:]) for i in (0, 1))
            across = -(place.north - n) * math.sin(course) + (place.east - e) * math.cos(course)
        if sample["altimeter"].valid:
            height = sample["altimeter"].number("range")
            down += 0.1 * (pilot.depth.value + height - HEIGHT_M - down)
        back = max(-0.15, min(0.15, -0.35 * across))
        ahead = SPEED_MPS * max(0.2, 1.0 - abs(across))
        off = wrapped(course - place.heading)
        goal = (ahead * math.cos(off) - back * math.sin(off), ahead * math.sin(off) + back * math.cos(off))
        depth, turning = sample["depth"].number("depth"), sample["imu"].vector("w_S")[2]
        client.send("rov/thrusters", u=pilot.command(place, depth, turning, goal, down, course))
        truth = sample["truth/pose"].vector("p_NB")
        rows.append((k * DT_S, *truth, from_pipe(truth[0], truth[1]), height))
    raise SystemExit("the pipe has no end")


def _next(client: uwclient.Client) -> uwclient.Sample | None:
    """The next ping that has come, if any."""
    try:
        return client.read("rov/sonar", timeout=0.0)
    except uwclient.Timeout:
        return None


def picture(rows: list[Row], seen: list[tuple[float, float]], path: str) -> None:
    """Plan, and the height above the pipe."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6), layout="constrained")
    plan, side = figure.subplots(2, 1, height_ratios=[2, 1])
    plan.plot([p[0] for p in PIPE], [p[1] for p in PIPE], color="0.75", lw=10, solid_capstyle="butt", label="pipe")
    plan.plot([r[1] for r in rows], [r[2] for r in rows], label="true track")
    plan.plot(
        [p[0] for p in seen],
        [p[1] for p in seen],
        ".",
        color="tab:red",
        label="seen by the sonar, as dead reckoning places it",
    )
    plan.set(xlabel="north, m", ylabel="east, m", title="A pipe followed by altimeter and scanning sonar")
    plan.set_aspect("equal")
    plan.invert_yaxis()
    plan.legend()
    side.plot([r[0] for r in rows], [r[5] for r in rows])
    side.axhline(HEIGHT_M, color="0.6", ls="--")
    side.set(xlabel="time, s", ylabel="altimeter, m", ylim=(0, 3))
    for axis in (plan, side):
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Connect, follow, tell how well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=7600)
    parser.add_argument("--out", default="", help="picture to write")
    options = parser.parse_args()
    with uwclient.connect(port=options.port) as client:
        rows, seen = drive(client)
    off = sorted(r[4] for r in rows if r[0] > 10.0 and r[1] < 29.0)
    half = off[len(off) // 2]
    print(
        f"{rows[-1][0]:.0f} s, off the pipe at most {off[-1]:.2f} m, half of the time under {half:.2f} m, end at north {rows[-1][1]:.1f} m"
    )
    if options.out:
        picture(rows, seen, options.out)


if __name__ == "__main__":
    main()
