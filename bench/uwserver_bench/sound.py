"""Cost of finding sound paths through layered water: only the first arrival, or all arrivals; across a thermocline, along one, and in uniform water.

Measured in processor time with compiled kernels. Each path is searched from scratch, as in each exchange of a USBL or LBL.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from uwserver.environment.acoustics.boundaries import Boundaries
from uwserver.environment.acoustics.channel import Channel, channel_of, load_kernels
from uwserver.environment.column import ColumnConfig, ConstantColumn, ThermoclineColumn, WaterColumn
from uwserver_bench.rows import Row

FIRST_BAR_US, ALL_BAR_US = 60.0, 1000.0
FREQUENCY_HZ, BOTTOM_M = 26e3, 200.0
THERMOCLINE = ThermoclineColumn(
    surface_temperature_degc=18.0, deep_temperature_degc=6.0, depth_m=40.0, thickness_m=20.0
)
CASES: dict[str, tuple[ColumnConfig, float, float, float]] = {
    "500 m across a thermocline": (THERMOCLINE, 500.0, 5.0, 150.0),
    "2.5 km along a thermocline": (THERMOCLINE, 2500.0, 80.0, 85.0),
    "1 km in water of one temperature": (ConstantColumn(), 1000.0, 20.0, 60.0),
}
"""For each case the water, the distance, and both depths, m."""


def bench_sound(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on sound.

    Args:
        quick: two short repeats.
        say: gets a line of progress.
    """
    load_kernels()
    repeats, budget_s = (2, 0.01) if quick else (7, 0.2)
    rows = []
    for name, (water, x, a, b) in CASES.items():
        say(f"sound: {name}")
        channel = channel_of(WaterColumn(water, 9.81, 1025.0), FREQUENCY_HZ)
        for what, bar in (("first", FIRST_BAR_US), ("all", ALL_BAR_US)):
            values = tuple(_path_us(channel, what == "first", x, a, b, budget_s) for _ in range(repeats))
            title = "first" if what == "first" else "all to second order"
            rows.append(Row("sensors", f"acoustic path, {title}, {name}", "us", values, at_most=bar))
    return rows


def _path_us(channel: Channel, first: bool, x: float, a: float, b: float, budget_s: float) -> float:
    boundaries = Boundaries(BOTTOM_M)

    def seconds(times: int) -> float:
        start = time.thread_time_ns()
        for _ in range(times):
            if first:
                channel.earliest(x, a, b, boundaries)
            else:
                channel.paths(x, a, b, boundaries)
        return (time.thread_time_ns() - start) * 1e-9

    times = max(10, round(budget_s * 10 / max(seconds(10), 1e-6)))
    return 1e6 * seconds(times) / times
