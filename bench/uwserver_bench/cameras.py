"""Cost of pictures in processor time of one core: a camera in a harbour by daylight, with its lamps, as depth picture and as picture of ids.

The scene is that of `sensors.survey`, a seabed of 99 458 triangles, with piles and a wall in front of the camera.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from uwserver.sensors.job import PendingMeasurement
from uwserver.world import World
from uwserver_bench.rows import Row

DAY_BAR_HZ, DEPTH_BAR_HZ = 10.0, 20.0
CASES: dict[str, tuple[str, float, float | None]] = {
    "camera 640 x 480, daylight": ("day", 0.0, DAY_BAR_HZ),
    "camera 640 x 480, two lamps with shadows": ("day", 1.0, None),
    "depth camera 640 x 480": ("depth", 0.0, DEPTH_BAR_HZ),
    "segmentation 640 x 480": ("ids", 0.0, None),
}
"""Sensor, level of the lamps, and least number of pictures per second."""
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
    from uwserver_bench.sensors import survey

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
