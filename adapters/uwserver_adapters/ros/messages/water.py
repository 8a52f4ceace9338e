"""Water sensors: pressure or depth, conductivity and temperature, speed of sound."""

from __future__ import annotations

from collections.abc import Iterator

from uwserver.frames import IDENTITY
from uwserver.ports import Sample
from uwserver_adapters.ros.messages.motion import NOT_MEASURED, pose_stamped, scalar, temperature
from uwserver_adapters.ros.messages.source import Outlet, Source, diagonal, number


def pressure(source: Source) -> Iterator[Outlet]:
    """Yield a FluidPressure; for a sensor that gives a depth instead, a pose in map for robot_localization, and the depth as a Float64.

    A sensor with a temperature has a Temperature besides.
    """
    if source.has("depth"):
        yield from _depth(source)
    else:
        yield _pressure(source, "")
    if source.has("temperature"):
        yield temperature(source)


def _pressure(source: Source, suffix: str) -> Outlet:
    return scalar(source, suffix, "sensor_msgs/msg/FluidPressure", "pressure", "fluid_pressure")


def _float64(source: Source, field: str) -> Outlet:
    """Return the topic ``/<field>`` with one field as a Float64."""

    def make(_: Sample, value: float) -> object:
        return source.types.make("std_msgs/msg/Float64", data=value)

    return source.outlet(f"/{field}", "std_msgs/msg/Float64", source.complete((field,), make))


def _depth(source: Source) -> Iterator[Outlet]:
    (variance,) = source.variances("depth", 1)
    spread = diagonal(NOT_MEASURED, NOT_MEASURED, variance, *(NOT_MEASURED,) * 3)

    def make(sample: Sample, depth: float) -> object:
        return pose_stamped(source, sample, (0.0, 0.0, -depth), IDENTITY, spread)

    yield source.outlet("", "geometry_msgs/msg/PoseWithCovarianceStamped", source.complete(("depth",), make))
    yield _float64(source, "depth")


def ctd(source: Source) -> Iterator[Outlet]:
    """Yield our own Ctd, as there is no standard message, and temperature and pressure besides."""
    types, names = source.types, ("conductivity", "temperature", "pressure", "salinity")

    def make(sample: Sample, *values: float | None) -> object:
        read = dict(zip(names, map(number, values), strict=True))
        return types.make("uwserver_msgs/msg/Ctd", header=source.header(sample), **read)

    yield source.outlet("", "uwserver_msgs/msg/Ctd", source.complete((), make, names))
    yield temperature(source)
    yield _pressure(source, "/pressure")


def sound_speed(source: Source) -> Iterator[Outlet]:
    """Yield the speed of sound with its time, and as a plain number."""

    def make(sample: Sample, speed: float) -> object:
        return source.types.make("uwserver_msgs/msg/ScalarStamped", header=source.header(sample), data=speed)

    yield source.outlet("", "uwserver_msgs/msg/ScalarStamped", source.complete(("sound_speed",), make))
    yield _float64(source, "sound_speed")
