"""Hold depth and drive a square by feedback on the simulated sensors: depth, IMU and the pool's motion capture.

    uwserver run bluerov2_pool --paused        # one terminal
    python pool_square.py                      # another

The world is stepped by this program (12 ticks of 240 Hz between two commands), so the run is the same on every machine. Needs uwclient; the
picture needs matplotlib.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field

import uwclient
from uwclient import attitude

SIDE_M = 5.0
SPEED_MPS = 0.25
DEPTH_M = 1.5
TICKS = 12
DT_S = TICKS / 240.0
VEHICLE = "bluerov2"

# Wrench (surge, sway, heave, yaw) to the eight thrusters of a BlueROV2 Heavy, in ArduSub's motor order and directions.
ALLOCATION = (
    (-1, 1, 0, 1),
    (-1, -1, 0, -1),
    (1, 1, 0, -1),
    (1, -1, 0, 1),
    (0, 0, 1, 0),
    (0, 0, 1, 0),
    (0, 0, 1, 0),
    (0, 0, 1, 0),
)


@dataclass
class Log:
    """What the drive saw; one entry a control step, SI, N = NED."""

    t: list[float] = field(default_factory=list)
    north: list[float] = field(default_factory=list)
    east: list[float] = field(default_factory=list)
    depth: list[float] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)
    wanted: list[tuple[float, float]] = field(default_factory=list)
    u: list[tuple[float, ...]] = field(default_factory=list)

    def largest_track_error(self, after_s: float = 5.0) -> float:
        """Greatest distance from the moving reference once the start is over, m."""
        pairs = zip(self.t, self.north, self.east, self.wanted)
        return max(math.hypot(n - w[0], e - w[1]) for t, n, e, w in pairs if t > after_s)

    def largest_depth_error(self, after_s: float = 15.0) -> float:
        """Greatest depth error once the depth is reached, m."""
        return max(abs(d - DEPTH_M) for t, d in zip(self.t, self.depth) if t > after_s)


def reference(t: float) -> tuple[float, float]:
    """Where the vehicle should be: round the square at constant speed, north first; it stays at the end."""
    way = min(SPEED_MPS * t, 4 * SIDE_M)
    side, rest = divmod(way, SIDE_M)
    corners = ((0.0, 0.0), (SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0))
    if int(side) >= 4:
        return corners[4]
    (n0, e0), (n1, e1) = corners[int(side)], corners[int(side) + 1]
    s = rest / SIDE_M
    return n0 + s * (n1 - n0), e0 + s * (e1 - e0)


class Controller:
    """PD in position and heading, PID in depth; velocities from filtered differences of the position, yaw rate from the gyro."""

    def __init__(self) -> None:
        self._before: tuple[float, float, float] | None = None
        self._velocity = [0.0, 0.0, 0.0]
        self._depth_sum = 0.0

    def command(self, t: float, position: tuple[float, ...], depth: float, yaw: float, yaw_rate: float) -> list[float]:
        """Thruster commands u, eight of -1..1."""
        now = (position[0], position[1], depth)
        before = self._before or now
        self._before = now
        for k in range(3):
            self._velocity[k] += 0.3 * ((now[k] - before[k]) / DT_S - self._velocity[k])
        want, ahead = reference(t), reference(t + DT_S)
        feed = [(b - a) / DT_S for a, b in zip(want, ahead)]
        force_n = [90.0 * (want[k] - now[k]) + 60.0 * (feed[k] - self._velocity[k]) for k in range(2)]
        c, s = math.cos(yaw), math.sin(yaw)
        surge, sway = c * force_n[0] + s * force_n[1], -s * force_n[0] + c * force_n[1]
        error = DEPTH_M - depth
        self._depth_sum = max(-0.5, min(0.5, self._depth_sum + error * DT_S))
        heave = 90.0 * error + 40.0 * self._depth_sum - 70.0 * self._velocity[2]
        turn = -4.0 * yaw - 2.0 * yaw_rate
        wrench = (surge / 80.0, sway / 80.0, heave / 100.0, turn / 20.0)
        return [max(-1.0, min(1.0, _thrust_to_u(sum(a * w for a, w in zip(row, wrench))))) for row in ALLOCATION]


def _thrust_to_u(share: float) -> float:
    """Command that gives about this share of full thrust: beyond the dead band, thrust grows a little faster than linearly."""
    if abs(share) < 1e-3:
        return 0.0
    return math.copysign(0.08 + 0.92 * abs(share) ** 0.8, share)


def drive(client: uwclient.Client, seconds: float = 4 * SIDE_M / SPEED_MPS + 8.0) -> Log:
    """Drive the square; the world must be paused."""
    for component in ("mocap", "depth", "imu"):
        client.subscribe(f"{VEHICLE}/{component}", delivery="latest")
    log, controller = Log(), Controller()
    start = client.step(TICKS).t_ns
    while True:
        t = (client.step(TICKS).t_ns - start) * 1e-9
        if t >= seconds:
            return log
        mocap, depth, imu = (client.latest(f"{VEHICLE}/{name}") for name in ("mocap", "depth", "imu"))
        if mocap is None or depth is None or imu is None:
            continue
        position, yaw = mocap.vector("p_NS"), attitude.heading(mocap.vector("q_NS"))
        u = controller.command(t, position, depth.number("depth"), yaw, imu.vector("w_S")[2])
        client.send(f"{VEHICLE}/thrusters", u=u)
        log.t.append(t)
        log.north.append(position[0])
        log.east.append(position[1])
        log.depth.append(depth.number("depth"))
        log.heading.append(math.degrees(yaw))
        log.wanted.append(reference(t))
        log.u.append(tuple(u))


def picture(log: Log, path: str) -> None:
    """Track and time series as a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplot_mosaic(
        [["track", "depth"], ["track", "heading"], ["track", "u"]],
        figsize=(12, 7),
        layout="constrained",
        width_ratios=[1.1, 1],
    )
    track = axes["track"]
    track.plot(
        [w[1] for w in log.wanted],
        [w[0] for w in log.wanted],
        color="0.75",
        lw=6,
        solid_capstyle="round",
        label="wanted",
    )
    dots = track.scatter(log.east, log.north, c=log.t, s=6, cmap="viridis", label="motion capture", zorder=3)
    track.plot(log.east[0], log.north[0], "o", ms=10, mfc="none", mec="tab:red", mew=2, label="start")
    figure.colorbar(dots, ax=track, label="time / s", shrink=0.7)
    track.set(
        xlabel="east / m", ylabel="north / m", title=f"BlueROV2 Heavy: {SIDE_M:g} m square at {DEPTH_M:g} m depth"
    )
    track.set_aspect("equal")
    track.legend(loc="center")
    axes["depth"].plot(log.t, log.depth, lw=1, label="depth sensor")
    axes["depth"].axhline(DEPTH_M, color="0.6", ls="--", label="wanted")
    axes["depth"].invert_yaxis()
    axes["depth"].set(ylabel="depth / m")
    axes["depth"].legend()
    axes["heading"].plot(log.t, log.heading, lw=1, color="tab:green")
    axes["heading"].set(ylabel="heading / deg")
    for k in range(8):
        axes["u"].plot(log.t, [u[k] for u in log.u], lw=0.7, label=f"t{k + 1}")
    axes["u"].set(ylabel="command u", xlabel="time / s", ylim=(-1, 1))
    axes["u"].legend(ncols=8, fontsize="x-small", loc="lower center")
    for name in ("track", "depth", "heading", "u"):
        axes[name].grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Connect, drive, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=7600)
    parser.add_argument("--out", default="demo_square.png", help="picture to write; empty for none")
    options = parser.parse_args()
    with uwclient.connect(options.host, options.port, name="pool_square") as client:
        log = drive(client)
    print(
        f"track error at most {log.largest_track_error():.3f} m, depth error at most {log.largest_depth_error():.3f} m"
    )
    if options.out:
        picture(log, options.out)
        print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
