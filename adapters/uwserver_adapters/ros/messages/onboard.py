"""What a vehicle knows of itself: rays of light, contact, battery, leak, shafts, clock."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from uwserver.ports import Sample
from uwserver_adapters.ros.messages.frames import flu
from uwserver_adapters.ros.messages.source import Outlet, Source, is_whole, number, numbers


def range_array(source: Source) -> Iterator[Outlet]:
    """LaserScan: angles grow counter-clockwise, ours clockwise, so the order is reversed. No return is +inf (REP-117)."""
    types, get = source.types, source.bind("ranges")
    beams = source.mount.beams if source.mount is not None else ()
    angles = [-math.atan2(beam.direction[1], beam.direction[0]) for beam in reversed(beams)]
    first, last = (angles[0], angles[-1]) if angles else (0.0, 0.0)
    step = (last - first) / (len(angles) - 1) if len(angles) > 1 else 0.0
    near, far = (beams[0].near, beams[0].far) if beams else (0.0, math.inf)

    def make(sample: Sample) -> object | None:
        ranges = get(sample.value)
        if not sample.valid or ranges is None:
            return None
        told = np.array([math.inf if part is None else part for part in reversed(ranges)], np.float32)
        return types.make(
            "sensor_msgs/msg/LaserScan", header=source.header(sample), angle_min=first, angle_max=last,
            angle_increment=step, scan_time=1.0 / source.port.rate_hz if source.port.rate_hz else 0.0, range_min=near,
            range_max=far, ranges=told,
        )  # fmt: skip

    yield source.outlet("", "sensor_msgs/msg/LaserScan", make)


def contact(source: Source) -> Iterator[Outlet]:
    """Whether the hull is touched, and the mean force of the tick about the body origin."""
    types, get = source.types, source.bind("touching", "impulse_B")
    dt = source.facts.tick_s

    def touching(sample: Sample) -> object | None:
        value = get(sample.value)[0]
        return types.make("std_msgs/msg/Bool", data=bool(value)) if sample.valid else None

    def wrench(sample: Sample) -> object | None:
        impulse = get(sample.value)[1]
        if not (sample.valid and is_whole(impulse)) or not dt:
            return None
        force = types.vector(flu([part / dt for part in impulse]))
        # The moment is not told: which would need the arm of each point.
        made = types.make("geometry_msgs/msg/Wrench", force=force)
        return types.make("geometry_msgs/msg/WrenchStamped", header=source.header(sample, source.base), wrench=made)

    yield source.outlet("/touching", "std_msgs/msg/Bool", touching)
    yield source.outlet("", "geometry_msgs/msg/WrenchStamped", wrench)


_NAN = math.nan


def battery(source: Source) -> Iterator[Outlet]:
    """BatteryState; what is drawn is a negative current."""
    types, get = source.types, source.bind("voltage", "current", "charge")

    def make(sample: Sample) -> object | None:
        voltage, current, charge = get(sample.value)
        if not sample.valid:
            return None
        drawn = number(current)
        return types.make(
            "sensor_msgs/msg/BatteryState", header=source.header(sample), voltage=number(voltage), current=-drawn,
            temperature=_NAN, charge=_NAN, capacity=_NAN, design_capacity=_NAN, percentage=number(charge),
            power_supply_status=2 if drawn > 0 else 3, power_supply_technology=0, present=True,
        )  # fmt: skip

    yield source.outlet("", "sensor_msgs/msg/BatteryState", make)


def leak(source: Source) -> Iterator[Outlet]:
    """Bool."""
    types, get = source.types, source.bind("leak")

    def make(sample: Sample) -> object | None:
        return types.make("std_msgs/msg/Bool", data=bool(get(sample.value))) if sample.valid else None

    yield source.outlet("", "std_msgs/msg/Bool", make, latched=True)


def rpm(source: Source) -> Iterator[Outlet]:
    """JointState with velocities alone, under the names of the thrusters."""
    types, get = source.types, source.bind("speeds")
    (field,) = (field for field in source.port.fields if field.name == "speeds")
    _, _, order = field.doc.partition("order: ")
    names = [name.strip() for name in order.split(",")] if order else []
    names = names if len(names) == field.size else [f"{k}" for k in range(field.size)]

    def make(sample: Sample) -> object | None:
        speeds = get(sample.value)
        if not sample.valid or speeds is None:
            return None
        told = numbers(speeds if isinstance(speeds, tuple) else (speeds,))
        return types.make("sensor_msgs/msg/JointState", header=source.header(sample), name=names, velocity=told)

    yield source.outlet("", "sensor_msgs/msg/JointState", make)


def clock(source: Source) -> Iterator[Outlet]:
    """TimeReference: the device's time against the simulation's."""
    types, get = source.types, source.bind("utc_ns")

    def make(sample: Sample) -> object | None:
        utc_ns = get(sample.value)
        if not sample.valid or utc_ns is None:
            return None
        return types.make(
            "sensor_msgs/msg/TimeReference", header=source.header(sample), time_ref=types.stamp(utc_ns),
            source=source.port.path,
        )  # fmt: skip

    yield source.outlet("", "sensor_msgs/msg/TimeReference", make)
