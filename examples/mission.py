"""What a ground station does: upload a mission by MAVLink, arm, fly it, watch it. pymavlink stands for QGroundControl.

    uwserver run bluerov2_qgc
    python examples/mission.py

QGroundControl itself connects to the same scenario, and shows the mission on its map: docs/how-to/mavlink.md.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from typing import Any

from pymavlink import mavutil

MISSION = ((0.0, 0.0, 5.0), (6.0, 0.0, 6.0), (6.0, 6.0, 8.0), (0.0, 0.0, 5.0))
"""North, east (m from the start), depth (m)."""
GUIDED, AUTO, DISARM = 4, 3, 0.0
PATIENCE_S = 240.0


class Station:
    """One vehicle, over one link."""

    def __init__(self, link: str) -> None:
        self.link = mavutil.mavlink_connection(link, dialect="ardupilotmega", source_system=255, source_component=190)
        self._beat = 0.0
        self.until("HEARTBEAT")

    def until(self, kind: str, fits: Callable[[Any], bool] = lambda _: True) -> Any:
        """The next message of a kind that fits; a heartbeat goes out once a second meanwhile."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            if time.monotonic() > self._beat + 1.0:
                self._beat = time.monotonic()
                self.link.mav.heartbeat_send(6, 8, 0, 0, 4)
            message = self.link.recv_match(type=kind, blocking=True, timeout=0.2)
            if message is not None and fits(message):
                return message
        raise SystemExit(f"no {kind} that fits within {PATIENCE_S:g} s")

    def command(self, number: int, *parameters: float) -> int:
        """Result of a command; 0 is accepted."""
        self.link.mav.command_long_send(1, 1, number, 0, *(*parameters, *(0.0,) * 7)[:7])
        return int(self.until("COMMAND_ACK", lambda m: m.command == number).result)

    def insist(self, number: int, *parameters: float) -> None:
        """Until it is accepted: for a second or two the AHRS settles, and the vehicle refuses."""
        while self.command(number, *parameters) != 0:
            time.sleep(0.2)

    def upload(self, items: list[tuple[float, float, float]]) -> None:
        """Latitude, longitude (deg), altitude over the surface (m); item 0 is the place of the start."""
        self.link.mav.mission_count_send(1, 1, len(items), 0)
        for seq, (latitude, longitude, altitude) in enumerate(items):
            self.until("MISSION_REQUEST_INT", lambda m, seq=seq: m.seq == seq)
            place = (round(latitude * 1e7), round(longitude * 1e7), altitude)
            self.link.mav.mission_item_int_send(1, 1, seq, 6, 16, 0, 1, 0, 0.5, 0, math.nan, *place, 0)
        assert self.until("MISSION_ACK").type == 0, "the mission is refused"


def fly(station: Station) -> list[float]:
    """Distance from each waypoint when the vehicle says that it has reached it."""
    # MAV_CMD_REQUEST_MESSAGE and its kin tell more; the stream of positions is on anyway.
    home = station.until("GLOBAL_POSITION_INT", lambda m: m.lat != 0)
    metre = 1.0 / 111_320.0
    across = metre / math.cos(math.radians(home.lat * 1e-7))
    items = [(home.lat * 1e-7 + n * metre, home.lon * 1e-7 + e * across, -d) for n, e, d in MISSION]
    station.upload(items)
    station.insist(176, 1.0, GUIDED)  # MAV_CMD_DO_SET_MODE
    station.insist(400, 1.0)  # MAV_CMD_COMPONENT_ARM_DISARM
    station.insist(176, 1.0, AUTO)
    off = []
    for seq in range(1, len(items)):
        station.until("MISSION_ITEM_REACHED", lambda m, seq=seq: m.seq == seq)
        now = station.until("GLOBAL_POSITION_INT")
        north, east = (now.lat - home.lat) * 1e-7 / metre, (now.lon - home.lon) * 1e-7 / across
        off.append(math.dist((north, east, -now.relative_alt * 1e-3), MISSION[seq]))
        print(f"waypoint {seq} at {north:.1f} m north, {east:.1f} m east, {-now.relative_alt * 1e-3:.1f} m deep")
    station.command(400, DISARM, 21196.0)
    return off


def main() -> None:
    """Connect, fly, tell how near it came."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--link", default="udpin:127.0.0.1:14550", help="as pymavlink writes it")
    options = parser.parse_args()
    off = fly(Station(options.link))
    print(f"mission done, at most {max(off):.2f} m off")


if __name__ == "__main__":
    main()
