"""Hold the depth and drive a square by feedback from the simulated sensors: depth, IMU and the pool's motion capture.

    uwserver run bluerov2_pool --paused        # one terminal
    python pool_square.py                      # another

This program steps the world (12 ticks of 240 Hz between two commands), so the run is the same on every machine. It needs uwclient, and
matplotlib for the picture.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field

import uwclient
from uwclient import attitude

SIDE_M = 5.0
SPEED_MPS = 0.25
RAMP_S = 2.0
SIDE_S = SIDE_M / SPEED_MPS + RAMP_S
DIVE_MPS = 0.15
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


GAINS = ((40.0, 45.0, 60.0, 10.0), (80.0, 45.0, 60.0, 10.0), (92.0, 60.0, 80.0, 15.0))
"""For north, east and depth: quadratic drag (N s2/m2), and the proportional, derivative and integral gains (N over m, m/s, m s)."""


@dataclass
class Log:
    """What was measured and commanded: an entry for each control step, in SI units and N = NED."""

    t: list[float] = field(default_factory=list)
    north: list[float] = field(default_factory=list)
    east: list[float] = field(default_factory=list)
    depth: list[float] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)
    wanted: list[tuple[float, float]] = field(default_factory=list)
    u: list[tuple[float, ...]] = field(default_factory=list)

    def largest_track_error(self, after_s: float = 5.0) -> float:
        """Return the largest distance from the moving reference after the start, m."""
        pairs = zip(self.t, self.north, self.east, self.wanted)
        return max(math.hypot(n - w[0], e - w[1]) for t, n, e, w in pairs if t > after_s)

    def largest_depth_error(self, after_s: float = 15.0) -> float:
        """Return the largest error of the depth after it is reached, m."""
        return max(abs(d - DEPTH_M) for t, d in zip(self.t, self.depth) if t > after_s)


def reference(t: float) -> tuple[float, float]:
    """Return where the vehicle should be. It goes round the square, north first, slowly into and out of each corner, and stays at the end."""
    side, rest = divmod(max(t, 0.0), SIDE_S)
    corners = ((0.0, 0.0), (SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0))
    if int(side) >= 4:
        return corners[4]
    # The speed grows and falls linearly over RAMP_S, and is constant in between.
    begun, left = min(rest, RAMP_S), min(SIDE_S - rest, RAMP_S)
    way = SPEED_MPS * (begun**2 / (2 * RAMP_S) + max(0.0, min(rest, SIDE_S - RAMP_S) - RAMP_S))
    way += SPEED_MPS * (RAMP_S**2 - left**2) / (2 * RAMP_S)
    (n0, e0), (n1, e1) = corners[int(side)], corners[int(side) + 1]
    s = way / SIDE_M
    return n0 + s * (n1 - n0), e0 + s * (e1 - e0)


class Tracker:
    """Estimates value and rate of a noisy signal: a critically damped alpha-beta filter."""

    def __init__(self, first: float, bandwidth: float = 9.0) -> None:
        fade = math.exp(-bandwidth * DT_S)
        self._alpha, self._beta = 1 - fade * fade, (1 - fade) ** 2
        self.value, self.rate = first, 0.0

    def update(self, measured: float) -> None:
        """Take in a value, once in each control step."""
        self.value += self.rate * DT_S
        miss = measured - self.value
        self.value += self._alpha * miss
        self.rate += self._beta / DT_S * miss


class Controller:
    """Controls position and depth (PID) and heading (PD) along references that a vehicle with mass can follow.

    Rates come from filters, the yaw rate from the gyro.
    """

    def __init__(self) -> None:
        self._tracked: list[Tracker] = []
        self._depth = DEPTH_M
        self._sum = [0.0, 0.0, 0.0]

    def command(self, t: float, position: tuple[float, ...], depth: float, yaw: float, yaw_rate: float) -> list[float]:
        """Return the thruster commands u, eight numbers from -1 to 1."""
        now = (position[0], position[1], depth)
        if not self._tracked:
            self._tracked = [Tracker(value) for value in now]
            self._depth = depth
        for tracked, value in zip(self._tracked, now):
            tracked.update(value)
        before, self._depth = self._depth, self._depth + _within(DEPTH_M - self._depth, DIVE_MPS * DT_S)
        want, ahead = (*reference(t), self._depth), (*reference(t + DT_S), 2 * self._depth - before)
        force = [self._force(k, want[k], (ahead[k] - want[k]) / DT_S) for k in range(3)]
        c, s = math.cos(yaw), math.sin(yaw)
        surge, sway = c * force[0] + s * force[1], -s * force[0] + c * force[1]
        turn = -5.3 * yaw - 3.5 * yaw_rate
        wrench = (surge / 86.0, sway / 86.0, force[2] / 122.0, turn / 23.0)
        return [_within(_thrust_to_u(sum(a * w for a, w in zip(row, wrench))), 1.0) for row in ALLOCATION]

    def _force(self, axis: int, want: float, want_rate: float) -> float:
        """Return the force on an axis, N: the drag at the wanted rate, and PID on the error."""
        drag, p, d, i = GAINS[axis]
        error = want - self._tracked[axis].value
        self._sum[axis] = _within(self._sum[axis] + i * error * DT_S, 20.0)
        feed = drag * abs(want_rate) * want_rate
        return feed + p * error + d * (want_rate - self._tracked[axis].rate) + self._sum[axis]


def _within(x: float, limit: float) -> float:
    return max(-limit, min(limit, x))


def _thrust_to_u(share: float) -> float:
    """Return the command for about this share of full thrust. Beyond the dead band, thrust grows a little faster than linearly.

    The dead band is passed smoothly, because a step would shake the thruster where the sign changes with the noise of the sensors.
    """
    return 0.075 * math.tanh(share / 0.01) + math.copysign(0.92 * abs(share) ** 0.8, share)


def drive(client: uwclient.Client, seconds: float = 4 * SIDE_S + 8.0) -> Log:
    """Drive the square. The world must be paused."""
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
    """Draw track and time series into a picture file."""
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
