"""The worlds of `uwserver bench swarm`, as ordinary scenario files."""

from __future__ import annotations

from typing import Literal

from uwserver.scenario.files.documents import shipped
from uwserver.scenario.world.tables import WorldTable

Kind = Literal["navigation", "simple", "inertial", "copied", "over a bottom", "bluerov2_qgc"]

RATE_HZ = 240
SPACING_M, START_M, BOTTOM_M = 10.0, 5.0, 20.0
"""Distance of two vehicles; depth at the start; depth of the flat bottom, which DVL and echosounder see."""
LEG_M, LEGS, SPEED_MPS = 3000.0, 12, 0.4
"""A mission takes a day of simulated time, which is a minute at 1500 times real time."""

_HEAD = """\
schema = 1
title = "swarm"
seed = 1

[server]
metrics = false

[world]
rate_hz = {rate}
origin_lat_deg = 63.4410
origin_lon_deg = 10.3950
"""

SERVED = """
[adapters.tcp]
kind = "sockets"
port = 0
"""
"""Further tables for a server."""

_BOTTOM = f"""
[seabed]
kind = "flat"
depth_m = {BOTTOM_M}
"""

_VEHICLE = """
[vehicles.{name}]
model = "bluerov2_heavy"
position_ned_m = [{north:.1f}, {east:.1f}, {depth:.1f}]
"""

_COPIED = """
[vehicles.{name}.sensors]
ahrs = {{ kind = "attitude", profile = "mems_ahrs", rate_hz = 60 }}
dvl = {{ kind = "dvl", profile = "a50", rate_hz = 8 }}
"""
_PARTS = {
    # Sensors of the vehicle in `bluerov2_qgc`. IMU, pressure and depth are in its vehicle file. With its own battery, which is empty within seconds
    # here, it would surface.
    "navigation": """
[vehicles.{name}.autopilot]

[vehicles.{name}.sensors]
ahrs = {{ kind = "attitude", profile = "mems_ahrs", rate_hz = 60 }}
dvl = {{ kind = "dvl", profile = "a50", rate_hz = 8, position_frd_m = [-0.1, 0.0, 0.1] }}
echosounder = {{ kind = "altimeter", profile = "ping1d", rate_hz = 10, position_frd_m = [0.2, 0.0, 0.1] }}
battery = {{ kind = "battery", profile = "lipo_4s_18ah", capacity_Ah = 1000.0, rate_hz = 2 }}
leak = {{ kind = "leak", rate_hz = 2 }}
""",
    "simple": """
[vehicles.{name}.override.sensors.pressure]
enabled = false
""",
    # The same vehicle twice: its DVL pings in open water, or at a bottom.
    "copied": _COPIED,
    "over a bottom": _COPIED,
    "inertial": """
[vehicles.{name}.sensors]
inertial = {{ kind = "imu", profile = "mems_imu", rate_hz = 120 }}
exact = {{ kind = "imu", rate_hz = 120 }}
noisy = {{ kind = "imu", rate_hz = 120, modifiers = {{ noise = {{ kind = "white_noise", field = "f_S", sigma = 0.1 }} }} }}
""",
}


def names(vehicles: int) -> list[str]:
    """Return the names of the vehicles of a swarm."""
    return [f"r{k:04d}" for k in range(vehicles)]


def scenario(kind: Kind, vehicles: int, one_core: bool = True) -> str:
    """Return the text of a scenario file with vehicles in rows of ten.

    Args:
        kind: "navigation": sensors and autopilot of `bluerov2_qgc`, over a bottom; in deep water "simple": IMU and depth, and "inertial": three
            further IMUs, with all errors, exact, and with white noise; what is "copied", there or "over a bottom"; or the shipped "bluerov2_qgc".
        vehicles: number of vehicles.
        one_core: whether the world steps in one thread; otherwise it chooses the number.
    """
    if kind == "bluerov2_qgc":
        copies = f"copies = {{ count = {vehicles}, columns = 10, spacing_m = [{SPACING_M}, {SPACING_M}] }}"
        text = shipped()[kind].read_text("utf-8").partition("[adapters.")[0]
        return text.replace("[vehicles.bluerov2]\n", f"[vehicles.bluerov2]\n{copies}\n")
    text = _HEAD.format(rate=RATE_HZ)
    if one_core and has_threads():
        text += "threads = 1\n"
    has_bottom = kind in ("navigation", "over a bottom")
    text += _BOTTOM if has_bottom else ""
    depth = START_M if has_bottom else 100.0
    for k, name in enumerate(names(vehicles)):
        north, east = place(k)
        text += _VEHICLE.format(name=name, north=north, east=east, depth=depth) + _PARTS[kind].format(name=name)
    return text


def place(k: int) -> tuple[float, float]:
    """Return north and east of the start of vehicle k, m. Missions lead away from all other vehicles."""
    return -SPACING_M * (k // 10), SPACING_M * (k % 10)


def mission(k: int) -> list[dict[str, object]]:
    """Return the items of the mission of vehicle k: to the north, with legs that go a little deeper and up again."""
    north, east = place(k)
    items: list[dict[str, object]] = [{"kind": "speed", "speed_mps": SPEED_MPS}]
    for leg in range(1, LEGS + 1):
        depth = START_M + 3.0 * (leg % 2)
        items.append({"kind": "waypoint", "position_ned_m": [north + LEG_M * leg, east, depth]})
    return items


def has_threads() -> bool:
    """Return whether this version can step a world in several threads."""
    return "threads" in WorldTable.__struct_fields__
