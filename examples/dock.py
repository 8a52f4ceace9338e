"""Dock by USBL: hear the beacon, go to a place in front of the dock, line up, and creep in.

uwserver run examples/dock.toml --paused
python examples/dock.py --out dock.png
"""

from __future__ import annotations

import argparse
import math

import uwclient
from bluerov2 import DT_S, TICKS, DeadReckoning, Pilot, body_axes, rotated, until_heard, wrapped

COURSE = 0.0
"""The dock opens to the south: one enters it northward. The chart says so, the beacon cannot."""
BEFORE_M, INSIDE_M = 3.0, 0.75
"""Of the beacon: where to line up, and where the vehicle's middle is when it has docked."""
BOW_M = (0.25, 0.0, -0.05)
"""The USBL on the vehicle."""

Row = tuple[float, ...]
"""Time, true place (3), the beacon as estimated (3)."""


class Beacon:
    """Where the beacon is, as dead reckoning counts: a mean in which near readings weigh more, as their error grows with the range."""

    def __init__(self) -> None:
        self.place = (0.0, 0.0, 0.0)
        self._weight = 0.0

    def update(self, heard: uwclient.Sample, at: DeadReckoning, depth: float, q: tuple[float, ...]) -> None:
        """One reading of the USBL."""
        x, y, z = heard.vector("p_beacon_S")
        way = rotated(q, [a + b for a, b in zip((z, y, -x), BOW_M, strict=True)])
        weight = 1.0 / max(heard.number("range"), 0.5) ** 2
        # The drift of dead reckoning makes old readings stale.
        self._weight = 0.95 * self._weight + weight
        share = weight / self._weight
        found = (at.north + way[0], at.east + way[1], depth + way[2])
        self.place = tuple(a + share * (b - a) for a, b in zip(self.place, found, strict=True))

    @property
    def is_known(self) -> bool:
        """Whether it was heard."""
        return self._weight > 0.0


def drive(client: uwclient.Client) -> tuple[list[Row], int]:
    """Rows, and how many samples of the bumper told a contact; the world must be paused."""
    heard = ("depth", "imu", "ahrs", "dvl", "truth/pose")
    for name in heard:
        client.subscribe(f"rov/{name}", delivery="latest")
    client.subscribe("rov/usbl", delivery="latest")
    client.subscribe("rov/bumper", delivery="latest")
    until_heard(client, [f"rov/{name}" for name in heard])
    # Nobody knows where the vehicle begins: north, east = 0, 0 is here. The beacon is found from here too.
    place, beacon, rows = DeadReckoning(), Beacon(), list[Row]()
    pilot = Pilot(client.latest("rov/depth").number("depth"), client.latest("rov/ahrs").number("heading"))
    ping, bumps, inside, calm = -1, 0, False, 0
    for k in range(4000):
        client.step(TICKS)
        sample = {name: client.latest(f"rov/{name}") for name in heard}
        place.update(sample["dvl"], sample["ahrs"])
        depth, turning = sample["depth"].number("depth"), sample["imu"].vector("w_S")[2]
        usbl, bumper = client.latest("rov/usbl"), client.latest("rov/bumper")
        if usbl is not None and usbl.seq != ping:
            ping = usbl.seq
            if usbl.valid:
                beacon.update(usbl, place, depth, sample["ahrs"].vector("q_NS"))
        bumps += bumper is not None and bumper.number("count") > 0
        if not beacon.is_known:
            u = pilot.command(place, depth, turning, (0.0, 0.0), depth, place.heading)
        else:
            n, e, down = beacon.place
            off = INSIDE_M if inside else BEFORE_M
            to_n, to_e = n - off * math.cos(COURSE) - place.north, e - off * math.sin(COURSE) - place.east
            way, is_level = math.hypot(to_n, to_e), abs(depth - down) < 0.1
            if not inside and way < 0.15 and is_level and abs(wrapped(COURSE - place.heading)) < math.radians(3):
                inside = True
            calm = calm + 1 if inside and way < 0.08 else 0
            if calm > 40:
                return rows, bumps
            speed = min(0.12 if inside else 0.5, 0.4 * way)
            goal = body_axes(speed * to_n / max(way, 1e-6), speed * to_e / max(way, 1e-6), place.heading)
            far = not inside and way > 2.0
            u = pilot.command(place, depth, turning, goal, down, math.atan2(to_e, to_n) if far else COURSE)
        client.send("rov/thrusters", u=u)
        rows.append((k * DT_S, *sample["truth/pose"].vector("p_NB"), *beacon.place))
    raise SystemExit("it did not dock")


def picture(rows: list[Row], path: str) -> None:
    """Plan, with the dock, and the depth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5), layout="constrained")
    plan, side = figure.subplots(1, 2, width_ratios=[3, 2])
    plan.plot([13.8, 15, 15, 13.8], [3.475, 3.475, 4.525, 4.525], color="0.4", lw=3, label="dock")
    plan.plot([r[1] for r in rows], [r[2] for r in rows], label="true track")
    plan.plot(15, 4, "r*", ms=12, label="beacon")
    plan.set(xlabel="north, m", ylabel="east, m", aspect="equal", title="Docking by USBL")
    plan.invert_yaxis()
    plan.legend()
    side.plot([r[0] for r in rows], [r[3] for r in rows], label="depth")
    side.plot([r[0] for r in rows if r[6]], [r[6] for r in rows if r[6]], lw=0.8, label="beacon's, as estimated")
    side.set(xlabel="time, s", ylabel="depth, m")
    side.invert_yaxis()
    side.legend()
    for axis in (plan, side):
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Connect, dock, tell how well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=7600)
    parser.add_argument("--out", default="", help="picture to write")
    options = parser.parse_args()
    with uwclient.connect(port=options.port) as client:
        rows, bumps = drive(client)
    off = math.dist(rows[-1][1:4], (15.0 - INSIDE_M, 4.0, 8.0))
    print(f"docked after {rows[-1][0]:.0f} s, {off:.2f} m from its place, {bumps} bumps")
    if options.out:
        picture(rows, options.out)


if __name__ == "__main__":
    main()
