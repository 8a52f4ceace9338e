"""Two vehicles survey their halves of a bay, and tell each other by acoustic modem what they have found: each ends with the map of both.

uwserver run examples/share_survey.toml --paused
python examples/share_survey.py --out share_survey.png

A sounding is packed into six bytes; ten make a message of 60. The modem answers for what came, so what got lost is sent again.
"""

from __future__ import annotations

import argparse
import math
import struct
from collections.abc import Iterator
from contextlib import suppress

import uwclient

ADDRESS = {"west": 1, "east": 2}
TICKS, RATE_HZ, SECONDS = 48, 240, 75
SPEED_MPS, LENGTH_M, DEPTH_M = 0.4, 20.0, 10.0
CELL_M = 1.0
SLOT_S = 3.0
"""The vehicles take turns: who sends is deaf, so two that speak at once hear nothing."""
AT_ONCE = 10
"""Soundings of a message."""
SOUNDING = struct.Struct("<hhH")
"""North and east of the cell (m), depth of the bottom (cm)."""
Cell = tuple[int, int]


class Surveyor:
    """One vehicle: its own soundings, those it was told, and what the other has not confirmed yet."""

    def __init__(self, name: str, other: str) -> None:
        self.name, self.other = name, other
        self.own: dict[Cell, float] = {}
        self.told: dict[Cell, float] = {}
        self.due: list[Cell] = []
        self.under_way: list[Cell] = []
        self.ranges: list[float] = []
        self.lost = 0

    def sound(self, north: float, east: float, bottom: float) -> None:
        """Keep the shallowest of what was measured in a cell; told once it is left."""
        cell = (round(north / CELL_M), round(east / CELL_M))
        if cell not in self.own:
            self.due.append(cell)
        self.own[cell] = min(bottom, self.own.get(cell, math.inf))

    def send(self, client: uwclient.Client, at_least: int) -> None:
        """One message at a time: the next when the last was answered, or was not."""
        ready = self.due[:-1] if at_least > 1 else self.due  # the last cell may still change
        if self.under_way or len(ready) < at_least:
            return
        self.under_way, self.due = ready[:AT_ONCE], [*ready[AT_ONCE:], *self.due[len(ready) :]]
        data = b"".join(SOUNDING.pack(*cell, round(100 * self.own[cell])) for cell in self.under_way)
        client.send(f"{self.name}/modem/send", destination=ADDRESS[self.other], data=data, acknowledge=1)

    def hear(self, sample: uwclient.Sample) -> None:
        """News of the other's soundings, or of a message of one's own."""
        if sample["event"] == "data":
            for north, east, depth in SOUNDING.iter_unpack(sample["data"]):
                self.told[north, east] = depth / 100
        elif sample["event"] == "delivered":
            self.ranges.append(sample.number("range"))
            self.under_way = []
        else:  # nobody answered
            self.lost += 1
            self.due, self.under_way = [*self.under_way, *self.due], []


def unread(client: uwclient.Client, port: str) -> Iterator[uwclient.Sample]:
    """What has come and was not looked at."""
    with suppress(uwclient.Timeout):
        while True:
            yield client.read(port, timeout=0.0)


def survey(client: uwclient.Client) -> tuple[Surveyor, Surveyor]:
    """Both drive their line to the north; the world must be paused."""
    west, east = Surveyor("west", "east"), Surveyor("east", "west")
    for boat in (west, east):
        for port in ("mocap", "altimeter"):
            client.subscribe(f"{boat.name}/{port}", delivery="latest")
        client.subscribe(f"{boat.name}/modem/received", delivery="reliable")
    client.step(RATE_HZ)
    for boat in (west, east):
        start = client.latest(f"{boat.name}/mocap").vector("p_NS")
        items = [
            {"kind": "speed", "speed_mps": SPEED_MPS},
            {"kind": "waypoint", "position_ned_m": [LENGTH_M, round(start[1]), DEPTH_M]},
        ]
        client.call(f"{boat.name}/autopilot/set_mission", items=items)
        client.call(f"{boat.name}/autopilot/arm")
        client.call(f"{boat.name}/autopilot/start_mission")
    for k in range(SECONDS * RATE_HZ // TICKS):
        client.step(TICKS)
        for boat in (west, east):
            for sample in unread(client, f"{boat.name}/modem/received"):
                boat.hear(sample)
            place, echo = client.latest(f"{boat.name}/mocap"), client.latest(f"{boat.name}/altimeter")
            if echo is not None and echo.valid:
                north, along, down = place.vector("p_NS")
                boat.sound(north, along, down + 0.2 + echo.number("range"))
            if int(k * TICKS / RATE_HZ / SLOT_S) % 2 == ADDRESS[boat.name] - 1:
                boat.send(client, AT_ONCE if k * TICKS / RATE_HZ < SECONDS - 15 else 1)
    return west, east


def picture(boats: tuple[Surveyor, Surveyor], path: str) -> None:
    """What one found beside what the other was told of it."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    for axis, boat, other in zip(figure.subplots(1, 2, sharey=True), boats, boats[::-1], strict=True):
        for cells, style, label in (
            (boat.own, "k-", f"found by {boat.name}"),
            (other.told, "C1o", f"known to {other.name}"),
        ):
            line = sorted((north, depth) for (north, _), depth in cells.items())
            axis.plot([n for n, _ in line], [d for _, d in line], style, ms=4, label=label)
        axis.set(xlabel="north, m", ylabel="depth of the bottom, m", title=f"line of {boat.name}")
        axis.legend()
        axis.grid(alpha=0.3)
    figure.axes[0].invert_yaxis()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Connect, survey, tell how well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=7600)
    parser.add_argument("--out", default="", help="picture to write")
    options = parser.parse_args()
    with uwclient.connect(port=options.port) as client:
        west, east = boats = survey(client)
    shared = sum(len(boat.told) for boat in boats)
    every = sum(len(boat.own) for boat in boats)
    off = max(
        abs(depth - other.own[cell])
        for boat, other in ((west, east), (east, west))
        for cell, depth in boat.told.items()
    )
    ranges = west.ranges + east.ranges
    print(
        f"messages {len(ranges)} delivered, {west.lost + east.lost} lost; mean range {sum(ranges) / len(ranges):.1f} m"
    )
    print(f"cells {every}, known to the other {shared}, largest difference {off:.2f} m")
    if options.out:
        picture(boats, options.out)


if __name__ == "__main__":
    main()
