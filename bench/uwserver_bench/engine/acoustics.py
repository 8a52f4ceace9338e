"""Cost of sound in the water: of finding its paths, only the first arrival or all of them, and of modems, silent and with a packet.

Measured in processor time of the only thread. Each path is searched from scratch, as in each exchange of a USBL or LBL. A packet is measured
from its sending until the last modem has received it; the cost of a tick without modems is measured alternately, and subtracted.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from uwserver.environment.acoustics.boundaries import Boundaries
from uwserver.environment.acoustics.channel import Channel, channel_of, load_kernels
from uwserver.environment.column import ColumnConfig, ConstantColumn, ThermoclineColumn, WaterColumn
from uwserver.scenario.build.world import build
from uwserver.scenario.load.scenario import load
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import AcousticModemConfig
from uwserver.world.world import World
from uwserver_bench.report import Row

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
VEHICLES, SPACING_M, DEPTH_M = 20, 150.0, 20.0
IDLE_BAR_US, PACKET_BAR_US = 5.0, 1000.0
SECONDS_A_PACKET = 3
"""Time in which a packet has passed all modems."""


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


# -- modems -----------------------------------------------------------------------------------------------------------------------------


def bench_modems(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the part of the report on modems.

    Args:
        quick: two short repeats.
        say: gets a line of progress.
    """
    repeats, seconds, packets = (2, 1, 2) if quick else (7, 10, 20)
    without, silent = fleet(with_modems=False), fleet()
    idle, each = [], []
    for repeat in range(-1, repeats):  # the first one is a warm-up
        say(f"modems: repeat {max(repeat, 0) + 1} of {repeats}")
        for world in (without, silent):  # at the same place, because the cost of a tick depends on the motion
            world.call("world/reset")
        base, quiet = _tick_us(without, seconds), _tick_us(silent, seconds)
        spoken = _packet_us(silent, packets, quiet)
        if repeat >= 0:
            # Two measurements differ by more than this, so the difference may be negative.
            idle.append(max(0.0, quiet - base))
            each.append(max(0.0, spoken) / (VEHICLES - 1))
    return [
        Row("sensors", f"{VEHICLES} idle modems, a tick", "us", tuple(idle), at_most=IDLE_BAR_US),
        Row(
            "sensors", f"a packet, each of {VEHICLES - 1} modems that hear it", "us", tuple(each), at_most=PACKET_BAR_US
        ),
    ]


def fleet(with_modems: bool = True) -> World:
    """Return a world of vehicles in a row that have no other sensors."""
    off = {"sensors": {name: {"enabled": False} for name in ("imu", "pressure", "depth")}}
    vehicles = {}
    for k in range(VEHICLES):
        modem = AcousticModemConfig(rate_hz=1, address=k + 1, bits_per_s=1000.0, max_range_m=5000.0)
        vehicles[f"v{k}"] = VehicleEntry(
            model="bluerov2_heavy", position_ned_m=(k * SPACING_M, 0.0, DEPTH_M), override=off,
            sensors={"modem": modem} if with_modems else {},
        )  # fmt: skip
    world = build(load(Scenario(schema=1, vehicles=vehicles), adapters={}))
    world.subscribe(())
    return world


def _tick_us(world: World, seconds: int) -> float:
    """Return the time of a tick in which no modem sends, us."""
    ticks = round(seconds * world.rate_hz)
    start = time.thread_time_ns()
    for _ in range(ticks):
        world.advance()
    return (time.thread_time_ns() - start) * 1e-3 / ticks


def _packet_us(world: World, packets: int, quiet_us: float) -> float:
    """Return the time of a broadcast beyond that of ticks in which no modem sends, us."""
    ticks = round(SECONDS_A_PACKET * world.rate_hz)
    start = time.thread_time_ns()
    for k in range(packets):
        world.command(f"v{k % VEHICLES}/modem/send", data=bytes(32))
        for _ in range(ticks):
            world.advance()
    return (time.thread_time_ns() - start) * 1e-3 / packets - quiet_us * ticks
