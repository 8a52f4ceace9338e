"""Follow a mission of MOOS-IvP from outside: when each waypoint is passed, and how far from its rows and its depth the vehicle truly was.

In examples/moos, each in a terminal of its own (where pAntler is not installed, start the two programs of its block with `survey.moos`):

    uwserver run server.toml
    pAntler survey.moos
    python track.py --out moos.png
    uPokeDB survey.moos DEPLOY=true MOOS_MANUAL_OVERRIDE=false
"""

from __future__ import annotations

import argparse
import math
import time

import uwclient

WAYPOINTS = ((0.0, 10.0), (0.0, 80.0), (-25.0, 80.0), (-25.0, 10.0))
"""North, east (m): y and x of `points` in survey.bhv."""
ROWS = ((0, 0.0), (2, -25.0))
"""The waypoint at which a row begins, and its north."""
CAPTURE_M, DEPTH_M, SETTLED_M = 10.5, 6.0, 35.0
"""Slip radius of survey.bhv and what a sample at 10 Hz may miss; depth of the survey; what it takes to come to the row after a turn."""
PATIENCE_S = 300.0

Row = tuple[float, float, float, float, int]
"""Time, true north, east, down, and how many waypoints were passed."""


def follow(client: uwclient.Client) -> list[Row]:
    """Rows until the last waypoint is passed."""
    client.subscribe("lauv/truth/pose", delivery="latest")
    rows, passed, end = list[Row](), 0, time.monotonic() + PATIENCE_S
    while passed < len(WAYPOINTS):
        if time.monotonic() > end:
            raise SystemExit(
                f"no waypoint {passed + 1} in {PATIENCE_S:g} s: do helm and autopilot run, is DEPLOY true?"
            )
        sample = client.read("lauv/truth/pose")
        north, east, down = sample.vector("p_NB")
        if math.dist((north, east), WAYPOINTS[passed]) < CAPTURE_M:
            passed += 1
            print(
                f"waypoint {passed} of {len(WAYPOINTS)} after {sample.t_ns / 1e9:.0f} s, {down:.1f} m deep", flush=True
            )
        rows.append((sample.t_ns / 1e9, north, east, down, passed))
    return rows


def errors(rows: list[Row]) -> tuple[float, float]:
    """Most distance from a row, and from the depth of the survey, on the rows' parts that the vehicle has had the length to come to."""
    across, above = 0.0, 0.0
    for first, row_north in ROWS:
        (_, start), (_, end) = WAYPOINTS[first : first + 2]
        for _, north, east, down, passed in rows:
            if passed == first + 1 and abs(east - start) > SETTLED_M and abs(east - end) > CAPTURE_M:
                across, above = max(across, abs(north - row_north)), max(above, abs(down - DEPTH_M))
    return across, above


def draw(rows: list[Row], path: str) -> None:
    """Track and depth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    plan, side = figure.subplots(2, 1, height_ratios=(2, 1))
    plan.plot([row[2] for row in rows], [row[1] for row in rows], label="truth")
    plan.plot([e for _, e in WAYPOINTS], [n for n, _ in WAYPOINTS], "ko:", mfc="none", label="waypoints of the helm")
    plan.set(
        xlabel="x of the mission (east), m", ylabel="y (north), m", aspect="equal", title="A survey flown by MOOS-IvP"
    )
    plan.legend(loc="center")
    side.plot([row[0] for row in rows], [row[3] for row in rows])
    side.axhline(DEPTH_M, color="k", ls=":")
    side.set(xlabel="time, s", ylabel="depth, m")
    side.invert_yaxis()
    for axis in (plan, side):
        axis.grid(visible=True, alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Connect, follow, tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=7600)
    parser.add_argument("--out", help="picture")
    options = parser.parse_args()
    with uwclient.connect(port=options.port) as client:
        rows = follow(client)
    across, above = errors(rows)
    if options.out:
        draw(rows, options.out)
    print(f"surveyed in {rows[-1][0]:.0f} s: at most {across:.2f} m beside a row, {above:.2f} m off the depth")


if __name__ == "__main__":
    main()
