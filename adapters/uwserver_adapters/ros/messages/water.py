"""Water sensors: pressure or depth, conductivity and temperature, speed of sound."""

from __future__ import annotations

from collections.abc import Iterator

from uwserver.frames import IDENTITY
from uwserver.ports import Sample
from uwserver_adapters.ros.messages.motion import NOT_MEASURED, pose_stamped, scalar, temperature
from uwserver_adapters.ros.messages.ros_port import RosPort, SensorTopic, diagonal, number


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
