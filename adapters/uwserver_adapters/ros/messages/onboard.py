"""Sensors of the water (pressure, conductivity, speed of sound) and of the vehicle itself (optical range finders, contact, battery, leak, shaft
speeds, clock)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from uwserver.frames import IDENTITY
from uwserver.ports import Sample, Value
from uwserver_adapters.ros.messages.frames import flu
from uwserver_adapters.ros.messages.motion import NOT_MEASURED, pose_stamped, scalar, temperature
from uwserver_adapters.ros.messages.ros_port import Mount, RosPort, SensorTopic, diagonal, number, numbers

_NAN = math.nan


def pressure(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a FluidPressure; for a sensor that gives a depth instead, a pose in map for robot_localization, and the depth as a Float64.

    A sensor with a temperature has a Temperature besides.
    """
    if ros_port.has("depth"):
        yield from _depth(ros_port)
    else:
        yield _pressure(ros_port, "")
    if ros_port.has("temperature"):
        yield temperature(ros_port)


def _pressure(ros_port: RosPort, suffix: str) -> SensorTopic:
    return scalar(ros_port, suffix, "sensor_msgs/msg/FluidPressure", "pressure", "fluid_pressure")


def _float64(ros_port: RosPort, field: str) -> SensorTopic:
    """Return the topic ``/<field>`` with one field as a Float64."""

    def make(_: Sample, value: float) -> object:
        return ros_port.types.make("std_msgs/msg/Float64", data=value)

    return ros_port.sensor_topic(f"/{field}", "std_msgs/msg/Float64", ros_port.complete((field,), make))


def _depth(ros_port: RosPort) -> Iterator[SensorTopic]:
    (variance,) = ros_port.variances("depth", 1)
    spread = diagonal(NOT_MEASURED, NOT_MEASURED, variance, *(NOT_MEASURED,) * 3)

    def make(sample: Sample, depth: float) -> object:
        return pose_stamped(ros_port, sample, (0.0, 0.0, -depth), IDENTITY, spread)

    yield ros_port.sensor_topic("", "geometry_msgs/msg/PoseWithCovarianceStamped", ros_port.complete(("depth",), make))
    yield _float64(ros_port, "depth")


def ctd(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield our own Ctd, as there is no standard message, and temperature and pressure besides."""
    types, names = ros_port.types, ("conductivity", "temperature", "pressure", "salinity")

    def make(sample: Sample, *values: float | None) -> object:
        read = dict(zip(names, map(number, values), strict=True))
        return types.make("uwserver_msgs/msg/Ctd", header=ros_port.header(sample), **read)

    yield ros_port.sensor_topic("", "uwserver_msgs/msg/Ctd", ros_port.complete((), make, names))
    yield temperature(ros_port)
    yield _pressure(ros_port, "/pressure")


def sound_speed(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield the speed of sound with its time, and as a plain number."""

    def make(sample: Sample, speed: float) -> object:
        return ros_port.types.make("uwserver_msgs/msg/ScalarStamped", header=ros_port.header(sample), data=speed)

    yield ros_port.sensor_topic("", "uwserver_msgs/msg/ScalarStamped", ros_port.complete(("sound_speed",), make))
    yield _float64(ros_port, "sound_speed")


def range_array(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a LaserScan. Its angles grow counter-clockwise and ours clockwise, so the order is reversed. No return is +inf (REP-117)."""
    types, beams = ros_port.types, (ros_port.mount or Mount()).beams
    angles = [-math.atan2(beam.direction[1], beam.direction[0]) for beam in reversed(beams)]
    first, last = (angles[0], angles[-1]) if angles else (0.0, 0.0)
    step = (last - first) / (len(angles) - 1) if len(angles) > 1 else 0.0
    near, far = (beams[0].near, beams[0].far) if beams else (0.0, math.inf)

    def make(sample: Sample, ranges: tuple[float | None, ...] | None) -> object | None:
        if ranges is None:
            return None
        return types.make(
            "sensor_msgs/msg/LaserScan", header=ros_port.header(sample), angle_min=first, angle_max=last,
            angle_increment=step, scan_time=1.0 / ros_port.port.rate_hz if ros_port.port.rate_hz else 0.0, range_min=near,
            range_max=far, ranges=np.array([math.inf if part is None else part for part in reversed(ranges)], np.float32),
        )  # fmt: skip

    yield ros_port.sensor_topic("", "sensor_msgs/msg/LaserScan", ros_port.complete((), make, ("ranges",)))


def _flag(ros_port: RosPort, suffix: str, field: str, latched: bool) -> SensorTopic:
    """Return a topic with one field as a Bool."""

    def make(_: Sample, value: Value) -> object:
        return ros_port.types.make("std_msgs/msg/Bool", data=bool(value))

    return ros_port.sensor_topic(suffix, "std_msgs/msg/Bool", ros_port.complete((), make, (field,)), latched)


def contact(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield whether the hull touches something, and the mean contact force of the tick in base_link."""
    types, dt = ros_port.types, ros_port.facts.tick_s

    def wrench(sample: Sample, impulse: tuple[float, ...]) -> object | None:
        if not dt:
            return None
        force = types.vector(flu([part / dt for part in impulse]))
        # There is no moment: it would need the lever arm of each contact point.
        made = types.make("geometry_msgs/msg/Wrench", force=force)
        return types.make("geometry_msgs/msg/WrenchStamped", header=ros_port.header(sample, ros_port.base), wrench=made)

    yield _flag(ros_port, "/touching", "touching", latched=False)
    yield ros_port.sensor_topic("", "geometry_msgs/msg/WrenchStamped", ros_port.complete(("impulse_B",), wrench))


def battery(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a BatteryState; a current that is drawn is negative."""

    def make(sample: Sample, voltage: Value, current: Value, charge: Value) -> object:
        drawn = number(current)
        return ros_port.types.make(
            "sensor_msgs/msg/BatteryState", header=ros_port.header(sample), voltage=number(voltage), current=-drawn,
            temperature=_NAN, charge=_NAN, capacity=_NAN, design_capacity=_NAN, percentage=number(charge),
            power_supply_status=2 if drawn > 0 else 3, power_supply_technology=0, present=True,
        )  # fmt: skip

    yield ros_port.sensor_topic(
        "", "sensor_msgs/msg/BatteryState", ros_port.complete((), make, ("voltage", "current", "charge"))
    )


def leak(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield whether there is a leak, as a Bool."""
    yield _flag(ros_port, "", "leak", latched=True)


def rpm(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a JointState with velocities only, rad/s, under the names of the thrusters."""
    (field,) = (field for field in ros_port.port.fields if field.name == "speeds")
    # The names stand in the text of the field.
    _, _, order = field.doc.partition("order: ")
    names = [name.strip() for name in order.split(",")] if order else []
    names = names if len(names) == field.size else [f"{k}" for k in range(field.size)]

    def make(sample: Sample, speeds: Any) -> object | None:
        if speeds is None:
            return None
        told = numbers(speeds if isinstance(speeds, tuple) else (speeds,))
        return ros_port.types.make(
            "sensor_msgs/msg/JointState", header=ros_port.header(sample), name=names, velocity=told
        )

    yield ros_port.sensor_topic("", "sensor_msgs/msg/JointState", ros_port.complete((), make, ("speeds",)))


def clock(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a TimeReference: the device's time against simulation time."""
    types, path = ros_port.types, ros_port.port.path

    def make(sample: Sample, utc_ns: int) -> object:
        time = types.stamp(utc_ns)
        return types.make("sensor_msgs/msg/TimeReference", header=ros_port.header(sample), time_ref=time, source=path)

    yield ros_port.sensor_topic("", "sensor_msgs/msg/TimeReference", ros_port.complete(("utc_ns",), make))
