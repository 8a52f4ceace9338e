"""A swarm in a wedge, over zenoh: the first leads, each other one holds its place beside the neighbour that it hears.

    uwserver run examples/swarm.toml --paused
    python examples/swarm.py --out swarm.png

Each robot publishes its position on swarm/<name>/position and hears that of its neighbour there, as it would from another computer.
"""

from __future__ import annotations

import argparse
import json
import math
import time

import uwclient
import zenoh
from bluerov2 import DT_S, HEAVE, SURGE, SWAY, TICKS, YAW, Axis, Ramp, Tracker, body_axes, thrusters, wrapped

WEDGE = {2: (1, (-1.5, -1.5)), 3: (1, (-1.5, 1.5)), 4: (2, (-1.5, -1.5)), 5: (3, (-1.5, 1.5))}
"""Of each follower: its neighbour, and where to be from there (north, east, m)."""
SECONDS, SPEED_MPS, DEPTH_M = 70.0, 0.25, 3.0


class Robot:
    """One of them: position and depth control, and what it says and hears."""

    def __init__(self, number: int, session: zenoh.Session) -> None:
        self.name, self.number = f"rov_{number}", number
        self.tracked = [Tracker(), Tracker(), Tracker()]
        self._axes = (Axis(SURGE, 1.0, 60.0), Axis(SWAY, 1.0, 60.0), Axis(HEAVE, 1.2, 80.0))
        self._yaw = Axis(YAW, 3.0, 12.0)
        self._ramps: list[Ramp] = []
        self._say = session.declare_publisher(f"swarm/{self.name}/position")
        self.heard: dict[str, list[float]] = {}
        if number in WEDGE:
            neighbour = f"swarm/rov_{WEDGE[number][0]}/position"
            self._ear = session.declare_subscriber(neighbour, lambda said: self.heard.update(json.loads(said.payload.to_string())))  # fmt: skip

    def sense(self, mocap: uwclient.Sample) -> None:
        """Take in the newest position, and tell it."""
        for tracked, value in zip(self.tracked, mocap.vector("p_NS"), strict=True):
            tracked.update(value)
        self.q = mocap.vector("q_NS")
        place = [t.value for t in self.tracked]
        self._ramps = self._ramps or [Ramp(value, 0.4, 0.15) for value in place]
        self._say.put(json.dumps({"place": place, "rate": [t.rate for t in self.tracked]}))

    def goal(self, t: float) -> tuple[float, float]:
        """Where to be now, north and east: the leader on its course, a follower by its neighbour."""
        if self.number in WEDGE:
            place, rate = self.heard.get("place"), self.heard.get("rate")
            if place is None or rate is None:
                return self.tracked[0].value, self.tracked[1].value
            # Half a second ahead of what was heard: the neighbour goes on meanwhile.
            offset = WEDGE[self.number][1]
            return place[0] + offset[0] + 0.5 * rate[0], place[1] + offset[1] + 0.5 * rate[1]
        way = SPEED_MPS * t
        return way, 4.0 + 1.5 * math.sin(0.3 * way)

    def command(self, t: float, yaw_rate: float) -> list[float]:
        """Thrusters' u."""
        forces = []
        for k, goal in enumerate((*self.goal(t), DEPTH_M)):
            self._ramps[k].update(goal)
            ramp, found = self._ramps[k], self.tracked[k]
            forces.append(self._axes[k].update(ramp.value - found.value, found.rate, ramp.rate))
        w, x, y, z = self.q
        heading = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        turn = self._yaw.update(wrapped(-heading), yaw_rate)
        return thrusters(*body_axes(forces[0], forces[1], heading), forces[2], turn)


def drive(client: uwclient.Client, session: zenoh.Session) -> list[list[tuple[float, float]]]:
    """Tracks of all robots, a place a control step; the world must be paused."""
    robots = [Robot(number, session) for number in range(1, 6)]
    for kind in ("mocap", "imu"):
        client.subscribe(f"*/{kind}", delivery="latest")
    tracks: list[list[tuple[float, float]]] = [[] for _ in robots]
    for k in range(int(SECONDS / DT_S)):
        client.step(TICKS)
        for robot, track in zip(robots, tracks, strict=True):
            mocap, imu = client.latest(f"{robot.name}/mocap"), client.latest(f"{robot.name}/imu")
            if mocap is None or imu is None:
                continue
            robot.sense(mocap)
            client.send_nowait(f"{robot.name}/thrusters", u=robot.command(k * DT_S, imu.vector("w_S")[2]))
            track.append((robot.tracked[0].value, robot.tracked[1].value))
        time.sleep(0.002)  # what was said has to be heard, as on any network
    return tracks


def picture(tracks: list[list[tuple[float, float]]], path: str) -> None:
    """Tracks, and the wedge at the end."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5), layout="constrained")
    axis = figure.subplots()
    for number, track in enumerate(tracks, 1):
        (line,) = axis.plot([p[0] for p in track], [p[1] for p in track], label=f"rov_{number}")
        axis.plot(*track[-1], "o", color=line.get_color())
    axis.set(xlabel="north, m", ylabel="east, m", aspect="equal", title="Five robots form a wedge over zenoh")
    axis.invert_yaxis()
    axis.legend()
    axis.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Connect, fly the formation, tell how well it is held at the end."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="endpoint of the server's zenoh adapter")
    parser.add_argument("--out", default="", help="picture to write")
    options = parser.parse_args()
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([options.connect]))
    with zenoh.open(config) as session, uwclient.connect_zenoh("uwserver", [options.connect]) as client:
        tracks = drive(client, session)
    worst = 0.0
    for number, (neighbour, offset) in WEDGE.items():
        here, there = tracks[number - 1][-1], tracks[neighbour - 1][-1]
        worst = max(worst, math.hypot(here[0] - there[0] - offset[0], here[1] - there[1] - offset[1]))
    print(f"formation: nobody is more than {worst:.2f} m from its place")
    if options.out:
        picture(tracks, options.out)


if __name__ == "__main__":
    main()
