"""Follow waypoints: along each leg, position by dead reckoning (DVL and AHRS), depth along the way.

uwserver run examples/waypoints.toml --paused
python examples/waypoints.py --out waypoints.png
"""

from __future__ import annotations

import argparse
import math

import uwclient
from bluerov2 import DT_S, TICKS, DeadReckoning, Pilot, body_axes, until_heard, wrapped

WAYPOINTS = ((0.0, 0.0, 2.0), (12.0, 0.0, 4.0), (12.0, 8.0, 6.0), (4.0, 12.0, 6.0), (0.0, 0.0, 3.0))
"""North, east, depth, m."""
SPEED_MPS, NEAR_M = 0.5, 0.3
"""Along a leg; what counts as reached."""

Row = tuple[float, ...]
"""Time, place by dead reckoning (3), true place (3), distance from the leg by truth."""


def from_leg(place: tuple[float, ...], a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float]:
    """Distance left along a leg, and to starboard of it."""
    course = math.atan2(b[1] - a[1], b[0] - a[0])
    along, across = body_axes(place[0] - a[0], place[1] - a[1], course)
    return math.dist(a[:2], b[:2]) - along, across


def drive(client: uwclient.Client) -> list[Row]:
    """Visit all waypoints; the world must be paused."""
    heard = ("depth", "imu", "ahrs", "dvl", "truth/pose")
    for name in heard:
        client.subscribe(f"rov/{name}", delivery="latest")
    until_heard(client, [f"rov/{name}" for name in heard])
    start = client.latest("rov/truth/pose").vector("p_NB")  # where it was put into the water
    place, pilot = DeadReckoning(start[0], start[1]), Pilot(start[2], client.latest("rov/ahrs").number("heading"))
    goal, rows = 1, list[Row]()
    for k in range(4000):
        client.step(TICKS)
        sample = {name: client.latest(f"rov/{name}") for name in heard}
        place.update(sample["dvl"], sample["ahrs"])
        a, b = WAYPOINTS[goal - 1], WAYPOINTS[goal]
        left, across = from_leg((place.north, place.east), a, b)
        if left < NEAR_M:
            if goal == len(WAYPOINTS) - 1:
                return rows
            goal += 1
            continue
        course = math.atan2(b[1] - a[1], b[0] - a[0])
        # Slowly towards a corner, and first turn, then go; what is off the leg is made good in some three seconds.
        speed = min(SPEED_MPS, 0.25 * left + 0.05) * max(0.0, math.cos(wrapped(course - place.heading))) ** 4
        back = max(-0.2, min(0.2, -0.3 * across))
        north = speed * math.cos(course) - back * math.sin(course)
        east = speed * math.sin(course) + back * math.cos(course)
        whole = math.dist(a[:2], b[:2])
        down = a[2] + (b[2] - a[2]) * min(1.0, max(0.0, (whole - left) / (0.8 * whole)))
        depth, turning = sample["depth"].number("depth"), sample["imu"].vector("w_S")[2]
        u = pilot.command(place, depth, turning, body_axes(north, east, place.heading), down, course)
        client.send("rov/thrusters", u=u)
        truth = sample["truth/pose"].vector("p_NB")
        rows.append((k * DT_S, place.north, place.east, pilot.depth.value, *truth, abs(from_leg(truth, a, b)[1])))
    raise SystemExit("the last waypoint was not reached")


def picture(rows: list[Row], path: str) -> None:
    """Plan and depth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5), layout="constrained")
    plan, side = figure.subplots(1, 2)
    plan.plot([w[1] for w in WAYPOINTS], [w[0] for w in WAYPOINTS], "o--", color="0.6", label="waypoints")
    plan.plot([r[5] for r in rows], [r[4] for r in rows], label="true track")
    plan.plot([r[2] for r in rows], [r[1] for r in rows], lw=0.8, label="dead reckoning")
    plan.set(xlabel="east, m", ylabel="north, m", aspect="equal", title="Waypoints by DVL and AHRS, in a current")
    side.plot([r[0] for r in rows], [r[6] for r in rows])
    side.set(xlabel="time, s", ylabel="depth, m")
    side.invert_yaxis()
    plan.legend()
    for axis in (plan, side):
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Connect, drive, tell how well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=7600)
    parser.add_argument("--out", default="", help="picture to write")
    options = parser.parse_args()
    with uwclient.connect(port=options.port) as client:
        rows = drive(client)
    off = sorted(row[-1] for row in rows)
    drift = math.dist(rows[-1][1:3], rows[-1][4:6])
    half = off[len(off) // 2]
    print(
        f"{rows[-1][0]:.0f} s, off the leg at most {off[-1]:.2f} m, half of the time under {half:.2f} m, drift {drift:.2f} m"
    )
    if options.out:
        picture(rows, options.out)


if __name__ == "__main__":
    main()
