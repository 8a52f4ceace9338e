"""What is said in degrees: where a receiver is, a compass heading, and the headings that services take."""

from __future__ import annotations

from collections.abc import Iterator

from uwserver.ports import Sample
from uwserver.units import deg
from uwserver_adapters.ros.messages.frames import attitude, enu
from uwserver_adapters.ros.messages.motion import NOT_MEASURED, twist_stamped
from uwserver_adapters.ros.messages.source import Outlet, Source, diagonal, is_whole, number, unknown


def attitude_sensor(source: Source) -> Iterator[Outlet]:
    """Imu with nothing but an orientation; the compass heading as mavros tells it."""
    types, get, heading = source.types, source.bind("q_NS"), source.bind("heading")
    none, spread = unknown(), diagonal(*source.variances("q_NS"))

    def make(sample: Sample) -> object | None:
        q = get(sample.value)
        if not (sample.valid and is_whole(q)):
            return None
        return types.make(
            "sensor_msgs/msg/Imu", header=source.header(sample), orientation=types.quaternion(attitude(q)),
            orientation_covariance=spread, angular_velocity_covariance=none, linear_acceleration_covariance=none,
        )  # fmt: skip

    def compass(sample: Sample) -> object | None:
        angle = heading(sample.value)
        if not sample.valid or angle is None:
            return None
        return types.make("std_msgs/msg/Float64", data=deg(angle))

    yield source.outlet("", "sensor_msgs/msg/Imu", make)
    yield source.outlet("/compass_hdg", "std_msgs/msg/Float64", compass)


def gps(source: Source) -> Iterator[Outlet]:
    """NavSatFix, also without a fix; the velocity beside it in ENU axes."""
    types, geoid = source.types, source.facts.geoid_m
    get = source.bind("latitude", "longitude", "height", "horizontal_accuracy", "vertical_accuracy", "fix")
    speed = source.bind("v_NS", "velocity_accuracy")

    def make(sample: Sample) -> object | None:
        latitude, longitude, height, horizontal, vertical, fix = get(sample.value)
        has_fix = sample.valid and bool(fix) and None not in (latitude, longitude, height)
        status = types.make("sensor_msgs/msg/NavSatStatus", status=0 if has_fix else -1, service=1)
        header = source.header(sample)
        if not has_fix:
            nan = float("nan")
            return types.make(
                "sensor_msgs/msg/NavSatFix", header=header, status=status, latitude=nan, longitude=nan, altitude=nan
            )
        h, v = number(horizontal) ** 2, number(vertical) ** 2
        return types.make(
            "sensor_msgs/msg/NavSatFix", header=header, status=status, latitude=deg(latitude), longitude=deg(longitude),
            altitude=height + geoid, position_covariance=diagonal(h, h, v), position_covariance_type=2,
        )  # fmt: skip

    def velocity(sample: Sample) -> object | None:
        v, accuracy = speed(sample.value)
        if not (sample.valid and is_whole(v)):
            return None
        variance = number(accuracy) ** 2
        # Rates of turn are no business of a receiver: a variance that no filter takes for knowledge.
        spread = diagonal(variance, variance, variance, *(NOT_MEASURED,) * 3)
        return twist_stamped(source, sample, "map", enu(v), (0.0, 0.0, 0.0), spread)

    yield source.outlet("", "sensor_msgs/msg/NavSatFix", make)
    yield source.outlet("/vel", "geometry_msgs/msg/TwistWithCovarianceStamped", velocity)


def heading_deg(heading: float) -> float:
    """A heading (rad) as services of the autopilot take it."""
    return deg(heading)
