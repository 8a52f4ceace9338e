"""Cost of readings: of single devices over a large seabed, of pictures, and of a free-running vehicle with all of them.

Measured in processor time of the only thread. On an idle machine this is wall time; on a shared one other processes only affect the caches. The
pictures are those of a camera in the scene of `survey`, a seabed of 99 458 triangles, with piles and a wall in front of the camera.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.frames import IDENTITY
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.sensors import (
    BathymetryConfig,
    MultibeamConfig,
    Pose,
    ProfilerConfig,
    Scope,
    SensorConfig,
    SideScanConfig,
)
from uwserver.sensors.job import PendingMeasurement
from uwserver.world.parts.profile import Profile
from uwserver.world.world import World
from uwserver_bench.engine.contact import seabed_mesh
from uwserver_bench.engine.physics import COMMAND_EVERY, RATE_HZ
from uwserver_bench.report import Row

REAL_TIME_BAR = 40.0
PICTURES_BAR = 50.0
PINGS: dict[str, tuple[str, float, SensorConfig, Pose]] = {
    "side scan": ("side-scan ping, 2 x 1000 bins over 50 m", 1.0, SideScanConfig(rate_hz=10), Pose()),
    "bathymetry": ("bathymetry ping, 256 beams over 140 degrees, 50 m", 3.0, BathymetryConfig(rate_hz=10), Pose()),
    "profile": ("profile ping, 81 rays, 20 m, straight down", 0.1, ProfilerConfig(rate_hz=10), Pose.from_degrees((0.0, -90.0, 0.0))),
}  # fmt: skip
"""For each name the row and its bar (ms), the sensor, and its mounting."""
DEVICES = {
    "sonar": ("Micron DST ping, 13 x 71 rays, 400 bins over 20 m", 700.0),
    "dvl": ("DVL1000 sample, bottom and water track", 50.0),
    "inertial": ("IMU sample, full error model", 10.0),
    "altimeter": ("Micron Echosounder ping, 61 rays", None),
    "depth": ("depth sample with four errors", None),
    "gps": ("GPS sample under water", None),
}
"""For each sensor in SCENARIO the row and its bar, us."""
KINDS = {
    "sonar": "scanning_sonar",
    "dvl": "dvl",
    "inertial": "imu",
    "altimeter": "altimeter",
    "depth": "pressure",
    "gps": "gps",
}
"""The names of their kinds in the profile of a world."""

SECOND = round(RATE_HZ)
"""A second, in ticks."""
DEPTH_M, ABOVE_M = 20.0, 5.0
"""Mean depth of the seabed, whose waves of 3 m are visible to the sonar; and altitude of the vehicle above this depth."""

SCENARIO = f"""\
schema = 1
title = "bench"
seed = 1

[world]
rate_hz = {RATE_HZ:g}
origin_lat_deg = 63.43
origin_lon_deg = 10.40

[seabed]
kind = "grid"
file = "seabed.npy"
spacing_m = [2.0, 2.0]

[vehicles.rov]
model = "bluerov2_heavy"
position_ned_m = [0.0, 0.0, {DEPTH_M - ABOVE_M}]

[vehicles.rov.override.sensors.imu]
enabled = false

[vehicles.rov.override.sensors.pressure]
enabled = false

[vehicles.rov.sensors.inertial]
kind = "imu"
profile = "mems_imu"
rate_hz = 120

[vehicles.rov.sensors.dvl]
kind = "dvl"
profile = "dvl1000"
rate_hz = 8
position_frd_m = [-0.1, 0.0, 0.2]

[vehicles.rov.sensors.gps]
kind = "gps"
profile = "m8_gps"
rate_hz = 5
position_frd_m = [0.0, 0.0, -0.2]

[vehicles.rov.sensors.altimeter]
kind = "altimeter"
profile = "micron_echosounder"
rate_hz = 10
position_frd_m = [0.1, 0.0, 0.2]

[vehicles.rov.sensors.sonar]
kind = "scanning_sonar"
profile = "micron_dst"
rate_hz = 20
range_m = 20.0
position_frd_m = [0.1, 0.0, -0.3]
"""
DAY_BAR_HZ, DEPTH_BAR_HZ = 10.0, 20.0
CASES: dict[str, tuple[str, float, float | None]] = {
    "camera 640 x 480, daylight": ("day", 0.0, DAY_BAR_HZ),
    "camera 640 x 480, two lamps with shadows": ("day", 1.0, None),
    "depth camera 640 x 480": ("depth", 0.0, DEPTH_BAR_HZ),
    "segmentation 640 x 480": ("ids", 0.0, None),
}
"""Sensor, level of the lamps, and least number of pictures per second."""


def bench_sensors(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on sensors.

    Args:
        quick: two short repeats.
        say: gets a line of progress.
    """
    try:
        world = survey()
    except ImportError as error:
        return [Row("sensors", "readings", "us", (), note=f'pip install "uwserver[solid]" ({error})')]
    repeats, budget_s = (2, 0.02) if quick else (7, 0.3)
    values: dict[str, list[float]] = {name: [] for name in (*DEVICES, "all", "pictures", *PINGS)}
    for repeat in range(-1, repeats):  # the first one is a warm-up
        say(f"sensors: repeat {max(repeat, 0) + 1} of {repeats}")
        world.call("world/reset")
        world.step(2)
        found = _readings_us(world, budget_s)
        found["all"] = _real_time_factor(world, budget_s)
        sonar = MultibeamConfig(rate_hz=10, range_m=25.0, gain_sigma_db=0.0)
        found["pictures"] = 1e3 / _ping_ms(world, sonar, Pose.from_degrees((0.0, -12.0, 0.0)), budget_s)
        for name, (_, _, config, mount) in PINGS.items():
            found[name] = _ping_ms(world, config, mount, budget_s)
        for name, value in found.items() if repeat >= 0 else ():
            values[name].append(value)
    rows = [Row("sensors", title, "us", tuple(values[name]), at_most=bar) for name, (title, bar) in DEVICES.items()]
    title = "BlueROV2 Heavy: imu 120, depth 48, dvl 8, gps 5, altimeter 10, sonar 20 Hz"
    rows.append(Row("sensors", title, "x realtime", tuple(values["all"]), REAL_TIME_BAR))
    title = "multibeam sonar, 256 beams x 512 ranges over 130 degrees"
    rows.append(Row("sensors", title, "pictures/s", tuple(values["pictures"]), PICTURES_BAR))
    return rows + [
        Row("sensors", title, "ms", tuple(values[name]), at_most=bar) for name, (title, bar, *_) in PINGS.items()
    ]


def survey(more: str = "") -> World:
    """Return a BlueROV2 Heavy with devices over a seabed of 99 458 triangles.

    Args:
        more: further tables of the scenario.

    Raises:
        ImportError: the engines for solid things are not installed.
    """
    with tempfile.TemporaryDirectory() as folder:
        depth = seabed_mesh().vertices[:, 2] + DEPTH_M
        size = round(len(depth) ** 0.5)
        np.save(Path(folder, "seabed.npy"), depth.reshape(size, size))
        file = Path(folder, "bench.toml")
        file.write_text(SCENARIO + more, encoding="utf-8")
        return build(load(file, adapters={}))


def _readings_us(world: World, budget_s: float) -> dict[str, float]:
    """Return the time of a reading of each device in the ticks of its world, us: of the measurement, and its part of the errors and delays, which are
    computed for all devices in one call."""
    profile = Profile(time.thread_time_ns)
    window = profile.open()
    world.watch(profile)
    try:
        ticks = 0
        start = time.thread_time_ns()
        while ticks == 0 or (time.thread_time_ns() - start) * 1e-9 < budget_s * len(DEVICES):
            world.step(SECOND)
            ticks += SECOND
    finally:
        world.watch(None)
    lines = profile.close(window).lines
    total = {line.what: line.mean_us * ticks for line in lines}
    counts = {line.what: line.readings for line in lines if line.readings}
    errors = total["errors, delays"] / sum(counts.values())
    return {name: total[KINDS[name]] / counts[KINDS[name]] + errors for name in DEVICES}


def _ping_ms(world: World, config: SensorConfig, mount: Pose, budget_s: float) -> float:
    """Return the processor time of a reading of a sonar over the middle of the seabed, with all computations in one thread, ms."""
    sonar = config.build(mount)
    sonar.load_kernels()
    place = (0.0, 0.0, DEPTH_M - ABOVE_M)
    still = (0.0, 0.0, 0.0)
    scope = Scope(0, place, IDENTITY, still, still, world.water, geometry=world.geometry, lambert=world.lambert)
    sonar.measure(scope)  # from now on its kernels are compiled
    count, start = 0, time.thread_time_ns()
    while count == 0 or (time.thread_time_ns() - start) * 1e-9 < budget_s:
        valid, _ = sonar.measure(replace(scope, t_ns=(count + 1) * 10**9))
        if not valid:
            raise RuntimeError(f"{type(sonar).__name__} heard nothing over the seabed")
        count += 1
    return (time.thread_time_ns() - start) * 1e-6 / count


def _real_time_factor(world: World, budget_s: float) -> float:
    """Return simulated over processor time from the start, with all devices, and thrusters commanded at 10 Hz."""
    world.call("world/reset")
    (size,) = world.ports["rov/thrusters"].fields[0].shape
    draws = np.random.Generator(np.random.PCG64(1)).uniform(-0.3, 0.3, (32, size))
    # Zero on average, so that the vehicle stays near.
    commands = np.concatenate([draws, -draws]).tolist()
    start = time.thread_time_ns()
    while (time.thread_time_ns() - start) * 1e-9 < 2.0 * budget_s:
        for u in commands:
            world.command("rov/thrusters", u=u)
            for _ in range(COMMAND_EVERY):
                world.advance()
    return world.t_ns / (time.thread_time_ns() - start)


# -- pictures ---------------------------------------------------------------------------------------------------------------------------

TABLES = """
[structures.pile]
kind = "cylinder"
radius_m = 0.4
length_m = 12.0
position_ned_m = [6.0, 2.0, 14.0]
attitude_rpy_deg = [0.0, 90.0, 0.0]

[structures.pipe]
kind = "cylinder"
radius_m = 0.3
length_m = 40.0
position_ned_m = [8.0, -3.0, 18.0]
attitude_rpy_deg = [0.0, 0.0, 25.0]

[structures.wall]
kind = "box"
size_m = [1.0, 12.0, 8.0]
position_ned_m = [14.0, 2.0, 16.0]
""" + "".join(
    f"""
[vehicles.rov.sensors.{name}]
kind = "camera"
mode = "{mode}"
rate_hz = 1
mount = "camera"
"""
    for name, mode in (("day", "rgb"), ("depth", "depth"), ("ids", "segmentation"))
)


def bench_cameras(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on cameras.

    Args:
        quick: two pictures of each case.
        say: gets a line of progress.
    """
    from uwserver_bench.engine.sensors import survey

    try:
        world = survey(TABLES)
    except ImportError as error:
        return [Row("sensors", "pictures", "1/s", (), note=f'pip install "uwserver[solid]" ({error})')]
    world.step(2)
    rows = []
    for title, (name, level, bar) in CASES.items():
        say(f"sensors: {title}")
        world.command("rov/lights", levels=(level, level))
        world.step()
        values = tuple(pictures_hz(world, name) for _ in range(3 if quick else 8))[1:]
        rows.append(Row("sensors", title, "1/s", values, bar))
    return rows


def pictures_hz(world: World, name: str) -> float:
    """Return the number of pictures per second of processor time, of the work in the tick and of the work in a worker thread."""
    sensor: Any = world.sensors[f"rov/{name}"].sensor
    scope = world.sensor_arrays.scopes(world.t_ns, False)(world.vehicles["rov"].row, None)
    start = time.thread_time_ns()
    begun = sensor.sense(scope)
    assert isinstance(begun, PendingMeasurement)
    begun.job.run()
    return 1e9 / (time.thread_time_ns() - start)
