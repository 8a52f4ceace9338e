"""Telemetry logs as a ground station writes them."""

import os
import struct

os.environ.setdefault("MAVLINK20", "1")
from pymavlink.dialects.v20 import ardupilotmega as m

START_US = 1_760_000_000_000_000


def telemetry(
    seconds: float = 10.0, rate: int = 10, system: int = 1, version1: bool = False
) -> list[tuple[int, bytes]]:
    """(stamp in us, frame) of a vehicle that dives in a circle."""
    mav = m.MAVLink(None, srcSystem=system, srcComponent=1)
    found = []

    def send(t_us, message):
        found.append((t_us, bytes(message.pack(mav, force_mavlink1=version1))))
        mav.seq = (mav.seq + 1) % 256

    for k in range(int(seconds * rate)):
        t_us = START_US + k * 1_000_000 // rate
        ms = k * 1000 // rate
        if k % rate == 0:
            send(t_us, m.MAVLink_heartbeat_message(12, 3, 81, 19, 4, 3))
            send(t_us, m.MAVLink_param_value_message(b"SURFACE_DEPTH", -10.0, 9, 900, k))
        send(t_us + 100, m.MAVLink_attitude_message(ms, 0.01 * k, -0.02, 0.03 * k, 0.1, 0.2, 0.3))
        send(t_us + 200, m.MAVLink_local_position_ned_message(ms, 0.1 * k, -0.05 * k, 2.0 + 0.01 * k, 1.0, -0.5, 0.1))
        if not version1:
            q = [1.0, 0.0, 0.0, 0.0]
            cov = [0.5 + j for j in range(21)]
            send(
                t_us + 300, m.MAVLink_odometry_message(ms * 1000, 1, 8, 1, 2, 3, q, 4, 5, 6, 7, 8, 9, cov, cov, 3, 2, 0)
            )
    return found


def tlog(frames: list[tuple[int, bytes]]) -> bytes:
    return b"".join(struct.pack(">Q", t_us) + frame for t_us, frame in sorted(frames, key=lambda f: f[0]))
