"""Dock by AprilTags: look around for them, line up before the dock, drive in; back off where they are lost.

uwserver run examples/dock_tags.toml --paused --record dock.mcap
python examples/dock_tags.py --out dock.png

Needs `pip install uwserver[pictures,solid] pupil-apriltags`. The dock and its tags: tags.py.
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from typing import NamedTuple

import numpy as np
import uwclient
from bluerov2 import DT_S, TICKS, DeadReckoning, Pilot, body_axes, rotated, until_heard, wrapped
from tags import Finder, Lens, Seen
from uwclient import attitude

DOCK, COURSE = (6.0, 2.0, 8.0), math.radians(30.0)
"""For the figures at the end only: the vehicle does not know where the dock is."""
LENS = Lens(380.765, 380.765, 319.5, 239.5)
"""uwserver camera-info examples/dock_tags.toml rov/camera"""
EYE_M = (0.2, 0.0, -0.02)
"""The camera on the vehicle; it looks ahead."""
LAMPS = 0.5
GATE_M = 2.5
"""Where to line up: so far before the place in the dock."""
TURN_RADPS, LEG_M = math.radians(15.0), 2.0
"""Of the search: how fast it looks around, and from one place to the next on a square that grows."""
LOST_S, FORGOTTEN_S = 1.6, 8.0
"""Without tags for so long it leaves the dock; for so long, it searches anew."""


class Fix(NamedTuple):
    """Where the vehicle is in the dock's frame: m and rad."""

    x: float
    y: float
    z: float
    yaw: float


class Dock:
    """Where the dock is, as dead reckoning counts: a mean in which sharp readings weigh more, and old ones fade as dead reckoning drifts."""

    def __init__(self) -> None:
        self.place, self.course = np.zeros(3), 0.0
        self.unseen_s, self.readings = math.inf, 0
        self._weights = [0.0, 0.0]

    def update(self, seen: Seen, at: np.ndarray, q: tuple[float, ...]) -> None:
        """One picture, taken at a place of dead reckoning in an attitude."""
        right, down, ahead = seen.p_C
        place = at + rotated(q, [a + b for a, b in zip((ahead, right, down), EYE_M, strict=True)])
        north, east, _ = rotated(q, (seen.R_CD[2, 0], seen.R_CD[0, 0], seen.R_CD[1, 0]))
        if self.unseen_s > FORGOTTEN_S:
            self._weights, self.readings = [0.0, 0.0], 0
        # A picture is off by its corners, and by the attitude at the time: 1 cm and half a degree are the least.
        shares = []
        for k, sigma in enumerate((math.hypot(seen.sigma_p, 0.01), math.hypot(seen.sigma_course, 0.01))):
            weight = 1.0 / sigma**2
            self._weights[k] = 0.85 * self._weights[k] + weight
            shares.append(weight / self._weights[k])
        self.place = self.place + shares[0] * (place - self.place)
        self.course = wrapped(self.course + shares[1] * wrapped(math.atan2(east, north) - self.course))
        self.unseen_s, self.readings = 0.0, self.readings + 1

    @property
    def is_known(self) -> bool:
        """Whether it was seen often enough, and not too long ago."""
        return self.readings >= 3 and self.unseen_s < FORGOTTEN_S

    def fix(self, place: DeadReckoning, depth: float) -> Fix:
        """Of the vehicle."""
        n, e, d = np.array((place.north, place.east, depth)) - self.place
        x, y = body_axes(n, e, self.course)
        return Fix(x, y, d, wrapped(place.heading - self.course))


class Goal(NamedTuple):
    """What the pilot is to do: velocity over ground (north, east), depth, heading."""

    velocity: tuple[float, float]
    down: float
    heading: float


class Search:
    """Look around at a place; where nothing is seen, go on to the next corner of a square that grows."""

    def __init__(self, place: DeadReckoning, depth: float) -> None:
        self._hold, self._down = [place.north, place.east], depth
        self._heading, self._turned, self._leg = place.heading, 0.0, 0

    def goal(self, place: DeadReckoning) -> Goal:
        """One control step."""
        n, e = self._hold[0] - place.north, self._hold[1] - place.east
        way = math.hypot(n, e)
        speed = min(0.3, 0.4 * way) / max(way, 1e-6)
        if way > 0.5:
            # It turns where it is, then goes with the bow ahead: the camera looks where it goes.
            self._heading = math.atan2(e, n)
            speed *= max(0.0, math.cos(self._heading - place.heading))
        else:
            self._heading += TURN_RADPS * DT_S
            self._turned += TURN_RADPS * DT_S
        if self._turned > 2.0 * math.pi:
            self._hold[self._leg % 2] += LEG_M * (1 + self._leg // 2) * (-1) ** (self._leg // 2)
            self._leg, self._turned = self._leg + 1, 0.0
        return Goal((speed * n, speed * e), self._down, self._heading)


class Docking:
    """The stages: search, line up, enter, back off, docked. Who sees the tags is before the dock, and so is the gate: the way to it is free."""

    def __init__(self) -> None:
        self.stage, self.tries = "search", 0
        self._search: Search | None = None
        self._calm_s = 0.0

    def goal(self, dock: Dock, place: DeadReckoning, depth: float) -> Goal:
        """One control step."""
        fix = dock.fix(place, depth)
        self._change(dock, fix)
        if self.stage == "search":
            self._search = self._search or Search(place, depth)
            return self._search.goal(place)
        self._search = None
        down, heading = float(dock.place[2]), dock.course
        sideways = max(-0.1, min(0.1, -0.5 * fix.y))
        if self.stage == "line up":
            to_x, to_y = -GATE_M - fix.x, -fix.y
            way = math.hypot(to_x, to_y)
            speed = min(0.35, 0.4 * way) / max(way, 1e-6)
            along, sideways = speed * to_x, speed * to_y
            # The tags are kept in the middle of the picture; at the gate that is the course of the dock.
            heading = dock.course + math.atan2(-fix.y, 0.3 - fix.x)
        elif self.stage == "back off":
            along = -0.2
        else:
            # Slower the nearer it is, and the more it is beside the axis or turned from it.
            free = 1.0 - max(abs(fix.y) / 0.12, abs(fix.z) / 0.12, abs(fix.yaw) / math.radians(6.0))
            along = max(-0.05, min(0.15 * max(0.0, free), -0.4 * fix.x))
        c, s = math.cos(dock.course), math.sin(dock.course)
        return Goal((c * along - s * sideways, s * along + c * sideways), down, heading)

    def _change(self, dock: Dock, fix: Fix) -> None:
        """Go on to the next stage, or back."""
        off = max(abs(fix.y), abs(fix.z))
        if self.stage in ("search", "line up") and not dock.is_known:
            self._to("search")
        elif self.stage == "search":
            self._to("line up")
        elif self.stage == "line up":
            if self._is_calm(abs(fix.x + GATE_M) < 0.15 and off < 0.06 and abs(fix.yaw) < math.radians(3.0), 1.0):
                self.tries += 1
                self._to("enter")
        elif self.stage == "enter":
            if dock.unseen_s > LOST_S or off > 0.25:
                self._to("back off")
            elif self._is_calm(abs(fix.x) < 0.02 and off < 0.02 and abs(fix.yaw) < math.radians(1.5), 2.0):
                self._to("docked")
        elif self.stage == "back off" and fix.x < 0.15 - GATE_M:
            self._to("line up")

    def _to(self, stage: str) -> None:
        self.stage, self._calm_s = stage, 0.0

    def _is_calm(self, holds: bool, for_s: float) -> bool:
        """Whether something has held for so long."""
        self._calm_s = self._calm_s + DT_S if holds else 0.0
        return self._calm_s >= for_s


class Row(NamedTuple):
    """What is drawn of a control step."""

    time_s: float
    p_NB: tuple[float, ...]
    heading: float
    stage: str
    tags: int


class Dive(NamedTuple):
    """What came of it.

    Attributes:
        rows: of each control step.
        shots: the picture with which each stage began, and the tags in it.
        pictures, tries, bumps: how many were looked at, how often it drove in, and how many samples of the bumper told a contact.
    """

    rows: list[Row]
    shots: dict[str, tuple[np.ndarray, np.ndarray]]
    pictures: int
    tries: int
    bumps: int


def drive(client: uwclient.Client) -> Dive:
    """Dock; the world must be paused."""
    heard = ("depth", "imu", "ahrs", "dvl", "truth/pose")
    for name in (*heard, "camera", "bumper"):
        client.subscribe(f"rov/{name}", delivery="latest")
    client.send("rov/lights", levels=[LAMPS, LAMPS])
    until_heard(client, [f"rov/{name}" for name in heard])
    # Nobody knows where the vehicle begins: north, east = 0, 0 is here. The dock is found from here too.
    place, dock, docking, finder = DeadReckoning(), Dock(), Docking(), Finder(LENS)
    pilot = Pilot(client.latest("rov/depth").number("depth"), client.latest("rov/ahrs").number("heading"))
    been: deque[tuple[int, np.ndarray, tuple[float, ...]]] = deque(maxlen=20)
    rows, shots, last, pictures, bumps, tags = list[Row](), {}, -1, 0, 0, 0
    for k in range(6000):
        client.step(TICKS)
        sample = {name: client.latest(f"rov/{name}") for name in heard}
        place.update(sample["dvl"], sample["ahrs"])
        depth, q = sample["depth"].number("depth"), sample["ahrs"].vector("q_NS")
        been.append((sample["ahrs"].t_ns, np.array((place.north, place.east, depth)), q))
        bumper, picture = client.latest("rov/bumper"), client.latest("rov/camera")
        bumps += bumper is not None and bumper.number("count") > 0
        dock.unseen_s += DT_S
        if picture is not None and picture.seq != last:
            last, pictures, image = picture.seq, pictures + 1, picture.array("image")
            seen = finder.find(image)
            tags = len(seen.ids) if seen else 0
            if seen:
                # A picture comes a fifth of a second late: where the vehicle was then counts.
                _, at, then = min(been, key=lambda entry: abs(entry[0] - picture.t_ns))
                dock.update(seen, at, then)
                shots.setdefault(docking.stage, (image, seen.corners))
                shots["docked"] = (image, seen.corners)
        before, goal = docking.stage, docking.goal(dock, place, depth)
        if docking.stage != before:
            print(f"{k * DT_S:6.1f} s: {docking.stage}", flush=True)
        turning = sample["imu"].vector("w_S")[2]
        ahead = body_axes(*goal.velocity, place.heading)
        client.send("rov/thrusters", u=pilot.command(place, depth, turning, ahead, goal.down, goal.heading))
        truth = sample["truth/pose"]
        heading = attitude.heading(truth.vector("q_NB"))
        rows.append(Row(k * DT_S, truth.vector("p_NB"), heading, docking.stage, tags))
        if docking.stage == "docked":
            return Dive(rows, shots, pictures, docking.tries, bumps)
    raise SystemExit(f"it did not dock within {rows[-1].time_s:.0f} s")


def picture(dive: Dive, path: str) -> None:
    """Plan with the dock, and what the camera saw as stages began, with the tags that were found."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6.4), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=[1.25, 1])
    plan = figure.add_subplot(grid[:, 0])
    c, s = math.cos(COURSE), math.sin(COURSE)
    for line in (((-0.6, -1.05), (-0.6, -0.6)), ((-0.6, 1.05), (-0.6, 0.6)), ((-0.6, -0.55), (0.84, -0.55), (0.84, 0.55), (-0.6, 0.55))):  # fmt: skip
        n, e = zip(*[(DOCK[0] + c * x - s * y, DOCK[1] + s * x + c * y) for x, y in line], strict=True)
        plan.plot(e, n, color="0.4", lw=3)
    for stage, colour in (
        ("search", "tab:gray"),
        ("line up", "tab:blue"),
        ("enter", "tab:green"),
        ("back off", "tab:red"),
    ):
        part = [row.p_NB if row.stage == stage else (math.nan,) * 3 for row in dive.rows]
        if any(row.stage == stage for row in dive.rows):
            plan.plot([p[1] for p in part], [p[0] for p in part], color=colour, label=stage)
    for row in dive.rows[::40]:
        plan.arrow(
            row.p_NB[1],
            row.p_NB[0],
            0.25 * math.sin(row.heading),
            0.25 * math.cos(row.heading),
            color="0.2",
            width=0.01,
        )
    plan.set(xlabel="east, m", ylabel="north, m", title="True track, and where the bow points every 2 s")
    plan.set_aspect("equal", adjustable="datalim")
    plan.grid(alpha=0.3)
    plan.legend()
    titles = (("search", "first seen"), ("enter", "lined up"), ("docked", "docked"))
    for k, (stage, title) in enumerate(titles):
        axis = figure.add_subplot(grid[k, 1])
        axis.set_axis_off()
        axis.set_title(title, fontsize=9)
        if stage in dive.shots:
            image, corners = dive.shots[stage]
            axis.imshow(image)
            for square in corners:
                axis.plot(*np.vstack([square, square[:1]]).T, color="red", lw=1)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Connect, dock, tell how well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=7600)
    parser.add_argument("--out", default="", help="picture to write")
    options = parser.parse_args()
    with uwclient.connect(port=options.port) as client:
        dive = drive(client)
    end = dive.rows[-1]
    off, turned = math.dist(end.p_NB, DOCK), abs(math.degrees(wrapped(end.heading - COURSE)))
    print(
        f"docked after {end.time_s:.0f} s and {dive.pictures} pictures, at try {dive.tries}, {off:.3f} m and {turned:.1f} deg off, {dive.bumps} bumps"
    )
    if options.out:
        picture(dive, options.out)


if __name__ == "__main__":
    main()
