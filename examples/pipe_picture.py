"""Follow a pipe in the pictures of an imaging sonar: a threshold finds it, a line is fitted, and dead reckoning keeps it until the vehicle is there.

uwserver run examples/pipe_picture.toml --paused --record pipe.mcap
python examples/pipe_picture.py --out pipe.png
"""

from __future__ import annotations

import argparse
import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import uwclient
from bluerov2 import DT_S, TICKS, DeadReckoning, Pilot, until_heard, wrapped
from uwclient import attitude

PIPE = ((0.0, 0.0), (11.0, 0.0), (20.969386, 4.648801), (31.594570, 1.801791), (42.427455, 3.711921))
"""For the figures at the end only: the follower does not know it."""
SPEED_MPS, HEIGHT_M = 0.45, 2.2
"""Along the pipe, and above the bottom."""
TILT_RAD, AHEAD_M, BELOW_M = math.radians(25.0), 0.25, 0.1
"""Of the sonar on the vehicle: how far it looks down, and where it sits; the altimeter is as low."""
LOUDER, LEAST = 30.0, 60
"""What is a pipe: counts of 60 / 255 dB above the median of its row (7 dB), in so many pixels at least."""
FIELD_RAD = math.radians(45.0)
"""To either side; beyond, the beam meets the bottom much farther out."""
PIECE_M = 1.5
"""Length of the piece to which a line is fitted: the nearest that is seen, then one about the vehicle."""

Row = tuple[float, ...]
"""Time, true place (3), distance from the pipe's axis, how far along the pipe, height by the altimeter."""


class Line(NamedTuple):
    """A piece of a line in the plane: a point, and its course (rad)."""

    x: float
    y: float
    course: float


def pipe_in(image: np.ndarray, azimuth: np.ndarray, reach: float, height: float, tilt: float) -> np.ndarray:
    """(n, 2) places ahead and to starboard of the sonar, m, of the pixels that are a pipe on a level bottom.

    Args:
        image: (ranges, beams) counts, row 0 nearest.
        azimuth: (beams) of the columns, rad to starboard.
        reach: range at the end of the last row, m.
        height: of the sonar above the bottom, m.
        tilt: how far it looks down, rad.
    """
    # The mean of 5 x 3 neighbours takes most of the speckle away.
    rows, beams = image.shape
    total = np.zeros((rows + 1, beams + 1))
    total[1:, 1:] = image.cumsum(0, dtype=float).cumsum(1)
    smooth = (total[5:, 3:] - total[:-5, 3:] - total[5:, :-3] + total[:-5, :-3]) / 15.0
    middle = np.abs(azimuth[1:-1]) < FIELD_RAD
    smooth, azimuth = smooth[:, middle], azimuth[1:-1][middle]
    # Rows that the sonar's beam does not light from side to side are as dark as their darkest part: no measure for the others.
    usual = np.median(smooth, axis=1)
    lit = np.percentile(smooth, 5, axis=1) > usual.max() - LOUDER
    row, beam = np.nonzero((smooth > usual[:, None] + LOUDER) & lit[:, None])
    r, a = (row + 3.0) * (reach / rows), azimuth[beam]
    # In the column at azimuth a the bottom at range r lies in the direction whose part downwards is height / r.
    down, ahead = math.cos(tilt), math.sin(tilt) * np.cos(a)
    share = height / (r * np.hypot(down, ahead))
    seen = share < 1.0
    r, a, ahead = r[seen], a[seen], ahead[seen]
    elevation = np.arcsin(share[seen]) - np.arctan2(ahead, down)
    x = math.cos(tilt) * np.cos(elevation) * np.cos(a) - math.sin(tilt) * np.sin(elevation)
    return np.column_stack([r * x, r * np.cos(elevation) * np.sin(a)])


def fitted(points: np.ndarray, course: float) -> Line:
    """The line with the least sum of squared distances; of its two ways that which is nearer to `course`."""
    middle = points.mean(axis=0)
    (nn, ne), (_, ee) = np.cov((points - middle).T)
    angle = 0.5 * math.atan2(2.0 * ne, nn - ee)
    if abs(wrapped(angle - course)) > math.pi / 2:
        angle += math.pi
    return Line(*middle, wrapped(angle))


def nearest_piece(points: np.ndarray) -> Line | None:
    """Of the pipe ahead, in the frame of `points`; None where there is too little of one."""
    if len(points) < LEAST:
        return None
    # What is a tenth of the way into the pixels begins the pipe, whatever single ones lie before.
    near = points[points[:, 0] < np.quantile(points[:, 0], 0.1) + PIECE_M]
    for _ in range(3):  # what lies beside the line is something else
        line = fitted(near, 0.0)
        off = -(near[:, 0] - line.x) * math.sin(line.course) + (near[:, 1] - line.y) * math.cos(line.course)
        kept = near[np.abs(off) < 0.4]
        if len(kept) < LEAST:
            return None
        near = kept
    return fitted(near, 0.0)


class Map:
    """The pipe as far as it was seen, in the frame of dead reckoning."""

    def __init__(self, place: tuple[float, float], course: float) -> None:
        self.points = [place]
        self._course = course

    def see(self, line: Line, place: DeadReckoning) -> None:
        """Take in a piece that a picture shows."""
        s, c = math.sin(place.heading), math.cos(place.heading)
        ahead = line.x + AHEAD_M
        self.points.append((place.north + ahead * c - line.y * s, place.east + ahead * s + line.y * c))

    def line(self, place: DeadReckoning) -> Line:
        """Through what was seen about the vehicle and a little ahead; where that is little, on from the last piece."""
        known = np.array(self.points[1:] or self.points)
        here = (place.north + 0.4 * math.cos(self._course), place.east + 0.4 * math.sin(self._course))
        order = np.hypot(*(known - here).T).argsort()
        close = known[order[:12]]
        if len(close) >= 4 and np.hypot(*np.ptp(close, axis=0)) > 0.3:
            line = fitted(close, self._course)
            self._course = line.course
            return line
        return Line(*close[0], self._course)

    def left(self, place: DeadReckoning) -> float:
        """Way to the end of what was seen, m."""
        return math.dist(self.points[-1], (place.north, place.east))


def along_pipe(north: float, east: float) -> tuple[float, float]:
    """Distance from the axis of the pipe in the plane, and how far along the pipe that is."""
    best, before = (math.inf, 0.0), 0.0
    for (n0, e0), (n1, e1) in pairwise(PIPE):
        dn, de = n1 - n0, e1 - e0
        length = math.hypot(dn, de)
        s = max(0.0, min(1.0, ((north - n0) * dn + (east - e0) * de) / length**2))
        best = min(best, (math.hypot(north - n0 - s * dn, east - e0 - s * de), before + s * length))
        before += length
    return best


def drive(client: uwclient.Client) -> tuple[list[Row], list[tuple[float, float]]]:
    """Rows, and the places where the pipe was seen; the world must be paused."""
    heard = ("depth", "imu", "ahrs", "dvl", "altimeter", "truth/pose")
    for name in (*heard, "sonar"):
        client.subscribe(f"rov/{name}", delivery="latest")
    until_heard(client, [f"rov/{name}" for name in heard])
    start = client.latest("rov/truth/pose").vector("p_NB")  # where it was put into the water
    place, pilot = DeadReckoning(start[0], start[1]), Pilot(start[2], 0.0)
    pilot.depth.value = start[2]
    pipe, down, last, rows = Map((start[0] + 4.0, start[1]), 0.0), start[2], -1, list[Row]()
    for k in range(4000):
        client.step(TICKS)
        sample = {name: client.latest(f"rov/{name}") for name in heard}
        place.update(sample["dvl"], sample["ahrs"])
        depth, height = sample["depth"].number("depth"), sample["altimeter"].number("range")
        if sample["altimeter"].valid:
            down += 0.1 * (pilot.depth.value + height + BELOW_M - HEIGHT_M - down)
        picture = client.latest("rov/sonar")
        if picture is not None and picture.seq != last and sample["altimeter"].valid:
            last = picture.seq
            tilt = TILT_RAD - attitude.to_rpy(sample["ahrs"].vector("q_NS"))[1]
            points = pipe_in(picture.array("image"), picture.array("azimuth"), picture.number("range"), height, tilt)
            if (piece := nearest_piece(points)) is not None:
                pipe.see(piece, place)
        if pipe.left(place) < 0.4:
            return rows, pipe.points[1:]
        line = pipe.line(place)
        across = -(place.north - line.x) * math.sin(line.course) + (place.east - line.y) * math.cos(line.course)
        back = max(-0.2, min(0.2, -0.4 * across))
        ahead = SPEED_MPS * max(0.3, 1.0 - abs(across))
        off = wrapped(line.course - place.heading)
        goal = (ahead * math.cos(off) - back * math.sin(off), ahead * math.sin(off) + back * math.cos(off))
        turning = sample["imu"].vector("w_S")[2]
        client.send("rov/thrusters", u=pilot.command(place, depth, turning, goal, down, line.course))
        truth = sample["truth/pose"].vector("p_NB")
        rows.append((k * DT_S, *truth, *along_pipe(truth[0], truth[1]), height))
    raise SystemExit("the pipe has no end")


def picture(rows: list[Row], seen: list[tuple[float, float]], path: str) -> None:
    """Plan, and the height above the bottom."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.6), layout="constrained")
    plan, side = figure.subplots(2, 1, height_ratios=[2, 1])
    plan.plot(*zip(*PIPE, strict=True), color="0.75", lw=8, solid_capstyle="butt", label="pipe")
    plan.plot([r[1] for r in rows], [r[2] for r in rows], label="true track")
    plan.plot(*zip(*seen, strict=True), ".", ms=3, color="tab:red", label="seen in the sonar's pictures, as dead reckoning places it")  # fmt: skip
    plan.set(xlabel="north, m", ylabel="east, m", title="A pipe followed in the pictures of an imaging sonar")
    plan.set_aspect("equal")
    plan.invert_yaxis()
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    side.plot([r[0] for r in rows], [r[6] for r in rows])
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
    off = sorted(r[4] for r in rows if r[5] > 2.0)
    print(
        f"{rows[-1][0]:.0f} s, {rows[-1][5]:.1f} m of the pipe, off it at most {off[-1]:.2f} m, half of the time under {off[len(off) // 2]:.2f} m"
    )
    if options.out:
        picture(rows, seen, options.out)


if __name__ == "__main__":
    main()
