"""Sensors of the water: pressure or depth, conductivity and temperature, speed of sound."""

from __future__ import annotations

from collections.abc import Iterator

from uwserver.frames import IDENTITY
from uwserver.ports import Sample
from uwserver_adapters.ros.messages.motion import temperature
from uwserver_adapters.ros.messages.source import Outlet, Source, diagonal, is_whole, number

_UNKNOWN_PLACE = 1e6
"""Variance of what a depth does not tell, m2 and rad2."""


def pressure(source: Source) -> Iterator[Outlet]:
    """FluidPressure; of a sensor that tells a depth its pose in map, for robot_localization, and the number alone."""
    if source.has("depth"):
        yield from _depth(source)
    else:
        yield _pressure(source, "")
    if source.has("temperature"):
        yield temperature(source)


def _pressure(source: Source, suffix: str) -> Outlet:
    types, get = source.types, source.bind("pressure")
    (variance,) = source.variances("pressure", 1)

    def make(sample: Sample) -> object | None:
        value = get(sample.value)
        if not sample.valid or value is None:
            return None
        return types.make(
            "sensor_msgs/msg/FluidPressure", header=source.header(sample), fluid_pressure=value, variance=variance
        )

    return source.outlet(suffix, "sensor_msgs/msg/FluidPressure", make)


def _depth(source: Source) -> Iterator[Outlet]:
    types, get = source.types, source.bind("depth")
    level = types.quaternion(IDENTITY)
    (variance,) = source.variances("depth", 1)
    spread = diagonal(_UNKNOWN_PLACE, _UNKNOWN_PLACE, variance, *(_UNKNOWN_PLACE,) * 3)

    def make(sample: Sample) -> object | None:
        depth = get(sample.value)
        if not sample.valid or depth is None:
            return None
        pose = types.make("geometry_msgs/msg/Pose", position=types.point((0.0, 0.0, -depth)), orientation=level)
        both = types.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=spread)
        return types.make("geometry_msgs/msg/PoseWithCovarianceStamped", header=source.header(sample, "map"), pose=both)

    def plain(sample: Sample) -> object | None:
        depth = get(sample.value)
        return types.make("std_msgs/msg/Float64", data=depth) if sample.valid and depth is not None else None

    yield source.outlet("", "geometry_msgs/msg/PoseWithCovarianceStamped", make)
    yield source.outlet("/depth", "std_msgs/msg/Float64", plain)


def ctd(source: Source) -> Iterator[Outlet]:
    """Our own Ctd, as no standard has one; temperature and pressure besides."""
    types, names = source.types, ("conductivity", "temperature", "pressure", "salinity")
    get = source.bind(*names)

    def make(sample: Sample) -> object | None:
        if not sample.valid:
            return None
        read = dict(zip(names, map(number, get(sample.value)), strict=True))
        return types.make("uwserver_msgs/msg/Ctd", header=source.header(sample), **read)

    yield source.outlet("", "uwserver_msgs/msg/Ctd", make)
    yield temperature(source)
    yield _pressure(source, "/pressure")


def sound_speed(source: Source) -> Iterator[Outlet]:
    """The number with its time, and alone."""
    types, get = source.types, source.bind("sound_speed")

    def make(sample: Sample) -> object | None:
        speed = get(sample.value)
        if not (sample.valid and is_whole(speed)):
            return None
        return types.make("uwserver_msgs/msg/ScalarStamped", header=source.header(sample), data=speed)

    def plain(sample: Sample) -> object | None:
        speed = get(sample.value)
        return types.make("std_msgs/msg/Float64", data=speed) if sample.valid and speed is not None else None

    yield source.outlet("", "uwserver_msgs/msg/ScalarStamped", make)
    yield source.outlet("/sound_speed", "std_msgs/msg/Float64", plain)
