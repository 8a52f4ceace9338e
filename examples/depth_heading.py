"""Hold depth and heading, and go to others smoothly: PID on a ramped set point.

uwserver run examples/depth_heading.toml --paused
python examples/depth_heading.py --out depth_heading.png
"""

from __future__ import annotations

import argparse
import math

import uwclient
from bluerov2 import DT_S, HEAVE, TICKS, YAW, Axis, Ramp, Tracker, thrusters, until_heard, wrapped

ORDERS = ((0.0, 3.0, 0.0), (12.0, 3.0, 90.0), (24.0, 1.5, 90.0), (36.0, 4.0, -60.0))
"""From when (s), depth (m), heading (deg)."""
SECONDS = 60.0

Row = tuple[float, float, float, float, float, float]
"""Time, depth wanted and found, heading wanted and found (deg), greatest command."""


def drive(client: uwclient.Client) -> list[Row]:
    """Carry out the orders; the world must be paused."""
    for name in ("depth", "imu", "ahrs"):
        client.subscribe(f"rov/{name}", delivery="latest")
    until_heard(client, ["rov/depth", "rov/imu", "rov/ahrs"])
    depth = Tracker()
    heave, yaw = Axis(HEAVE, 1.5, 80.0), Axis(YAW, 3.0, 12.0)
    to_depth = Ramp(client.latest("rov/depth").number("depth"), 0.3, 0.15)
    to_heading = Ramp(client.latest("rov/ahrs").number("heading"), math.radians(30), math.radians(20), wrapped)
    rows: list[Row] = []
    for k in range(int(SECONDS / DT_S)):
        client.step(TICKS)
        t = k * DT_S
        depth.update(client.latest("rov/depth").number("depth"))
        heading, rate = client.latest("rov/ahrs").number("heading"), client.latest("rov/imu").vector("w_S")[2]
        _, want_depth, want_heading = max(order for order in ORDERS if order[0] <= t)
        to_depth.update(want_depth)
        to_heading.update(math.radians(want_heading))
        down = heave.update(to_depth.value - depth.value, depth.rate, to_depth.rate)
        turn = yaw.update(wrapped(to_heading.value - heading), rate, to_heading.rate)
        u = thrusters(0.0, 0.0, down, turn)
        client.send("rov/thrusters", u=u)
        found, wanted = math.degrees(wrapped(heading)), math.degrees(wrapped(to_heading.value))
        rows.append((t, to_depth.value, depth.value, wanted, found, max(map(abs, u))))
    return rows


def picture(rows: list[Row], path: str) -> None:
    """Both set points and what was found."""
    from matplotlib.figure import Figure

    t, want_depth, depth, want_heading, heading, u = zip(*rows, strict=True)
    figure = Figure(figsize=(10, 6), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=[2, 2, 1])
    for axis, wanted, found, label in ((top, want_depth, depth, "depth, m"), (middle, want_heading, heading, "heading, deg")):  # fmt: skip
        axis.plot(t, wanted, "0.6", ls="--", label="set point")
        axis.plot(t, found, label="found")
        axis.set_ylabel(label)
        axis.legend()
        axis.grid(alpha=0.3)
    top.invert_yaxis()
    top.set_title("BlueROV2 Heavy: depth and heading by PID, in a current")
    bottom.plot(t, u, "tab:red", lw=0.8)
    bottom.set(xlabel="time, s", ylabel="greatest |u|", ylim=(0, 1))
    bottom.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Connect, drive, tell how well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=7600)
    parser.add_argument("--out", default="", help="picture to write")
    options = parser.parse_args()
    with uwclient.connect(port=options.port) as client:
        rows = drive(client)
    late = [row for row in rows if row[0] > 3.0]
    depth, heading = max(abs(r[1] - r[2]) for r in late), max(abs((r[3] - r[4] + 180) % 360 - 180) for r in late)
    print(f"largest error {depth:.3f} m, {heading:.2f} deg")
    if options.out:
        picture(rows, options.out)


if __name__ == "__main__":
    main()
