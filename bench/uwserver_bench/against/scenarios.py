"""Scenarios that every version can read: files of our own, with keys of the first releases only, so that both sides simulate the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uwserver_bench.engine.contact import seabed_mesh
from uwserver_bench.engine.sensors import DEPTH_M, SCENARIO

RATE_HZ = 240
SPACING_M = 5.0
_HEAD = f'schema = 1\ntitle = "bench"\nseed = 1\n\n[world]\nrate_hz = {RATE_HZ}\n'
_BOTTOM = '\n[seabed]\nkind = "flat"\ndepth_m = {depth:g}\nfriction = 0.4\n'
_VEHICLES = """
[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, {depth:g}]
copies = {{ count = {count}, columns = 10, spacing_m = [{spacing:g}, {spacing:g}] }}
"""
_BLIND = """
[vehicles.rov.override.sensors.imu]
enabled = false

[vehicles.rov.override.sensors.pressure]
enabled = false

[vehicles.rov.override.sensors.depth]
enabled = false
"""
_NAVIGATION = """
[vehicles.rov.autopilot]

[vehicles.rov.truth]
rate_hz = 20

[vehicles.rov.sensors.ahrs]
kind = "attitude"
profile = "mems_ahrs"
rate_hz = 60

[vehicles.rov.sensors.dvl]
kind = "dvl"
profile = "a50"
rate_hz = 8
position_frd_m = [-0.1, 0.0, 0.1]

[vehicles.rov.sensors.echosounder]
kind = "altimeter"
profile = "ping1d"
rate_hz = 10
position_frd_m = [0.2, 0.0, 0.1]

[vehicles.rov.sensors.battery]
kind = "battery"
profile = "lipo_4s_18ah"
rate_hz = 2

[vehicles.rov.sensors.leak]
kind = "leak"
rate_hz = 2
"""
_SMOOTH = """
[vehicles.rov.override.contact]
friction = 0.1
"""
_CRATE = """
[objects.crate_{k}]
kind = "box"
size_m = [0.5, 0.5, 0.5]
density_kgpm3 = 1040
position_ned_m = [0.8, {east:g}, 9.75]
friction = 0.4
"""
_SERVER = """
[server]
metrics = false

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, 10.0]

[vehicles.rov.autopilot]

[vehicles.rov.truth]
rate_hz = 240

[vehicles.rov.sensors.ahrs]
kind = "attitude"
rate_hz = 60

[adapters.tcp]
kind = "sockets"
port = 0
truth = true

[adapters.moos]
kind = "moosdb"
port = 0
truth = true

[adapters.moos.bridge]
publish = []

[adapters.moos.bridge.nav]
"""
_MAVLINK = """
[adapters.gcs]
kind = "mavlink"
links = ["udpin:127.0.0.1:0"]
origin_deg = [63.44, 10.39]
"""
_ZENOH = """
[adapters.zenoh]
kind = "zenoh"
scouting = false
encoding = "msgpack"
truth = true
listen = ["tcp/127.0.0.1:0"]
"""


def vehicles(count: int) -> list[str]:
    """Return the names of the vehicles."""
    return ["rov"] if count == 1 else [f"rov_{k}" for k in range(1, count + 1)]


def open_water(count: int) -> str:
    """Return vehicles with thrusters and without sensors, 100 m deep, without a bottom."""
    return _HEAD + _placed(count, 100.0) + _BLIND


def with_sensors(count: int) -> str:
    """Return vehicles with the sensors of their vehicle file, over a bottom."""
    return _HEAD + _BOTTOM.format(depth=60.0) + _placed(count, 30.0)


def navigation(count: int) -> str:
    """Return vehicles with navigation sensors and autopilots, as in bluerov2_qgc."""
    return _HEAD + _BOTTOM.format(depth=20.0) + _placed(count, 5.0) + _NAVIGATION


def contact(count: int) -> str:
    """Return vehicles on the bottom, each in front of a crate."""
    crates = "".join(_CRATE.format(k=k, east=SPACING_M * k) for k in range(count))
    return _HEAD + _BOTTOM.format(depth=10.0) + _placed(count, 9.84) + _BLIND + _SMOOTH + crates


def server(mavlink: bool, zenoh: bool) -> str:
    """Return one vehicle with truth at every tick, served by all adapters on free ports."""
    return _HEAD + _BOTTOM.format(depth=20.0) + _SERVER + (_MAVLINK if mavlink else "") + (_ZENOH if zenoh else "")


def write_survey(folder: Path) -> Path:
    """Write a scenario of a vehicle with sonar, DVL, altimeter, GPS and IMU above a seabed of 99 458 triangles. Returns its file."""
    depth = seabed_mesh().vertices[:, 2] + DEPTH_M
    size = round(len(depth) ** 0.5)
    np.save(folder / "seabed.npy", depth.reshape(size, size))
    file = folder / "survey.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    return file


def _placed(count: int, depth: float) -> str:
    text = _VEHICLES.format(depth=depth, count=count, spacing=SPACING_M)
    return text if count > 1 else "\n".join(line for line in text.splitlines() if "copies" not in line) + "\n"
