"""What ROS has in degrees: positions of receivers, compass headings, and the headings that services take."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from uwserver.ports import Sample
from uwserver.units import deg
from uwserver_adapters.ros.messages.frames import attitude, enu
from uwserver_adapters.ros.messages.motion import NOT_MEASURED, twist_stamped
from uwserver_adapters.ros.messages.ros_port import RosPort, SensorTopic, diagonal, number, unknown


def attitude_sensor(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield an Imu that holds only an orientation, and the compass heading as mavros publishes it."""
    types, none, spread = ros_port.types, unknown(), diagonal(*ros_port.variances("q_NS"))

    def make(sample: Sample, q: Any) -> object:
        return types.make(
            "sensor_msgs/msg/Imu", header=ros_port.header(sample), orientation=types.quaternion(attitude(q)),
            orientation_covariance=spread, angular_velocity_covariance=none, linear_acceleration_covariance=none,
        )  # fmt: skip

    def compass(_: Sample, heading: float) -> object:
        return types.make("std_msgs/msg/Float64", data=deg(heading))

    yield ros_port.sensor_topic("", "sensor_msgs/msg/Imu", ros_port.complete(("q_NS",), make))
    yield ros_port.sensor_topic("/compass_hdg", "std_msgs/msg/Float64", ros_port.complete(("heading",), compass))


def gps(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a NavSatFix, also while there is no fix, and the velocity in ENU axes."""
    types, geoid = ros_port.types, ros_port.facts.geoid_m
    get = ros_port.bind("latitude", "longitude", "height", "horizontal_accuracy", "vertical_accuracy", "fix")

    def make(sample: Sample) -> object:
        latitude, longitude, height, horizontal, vertical, fix = get(sample.value)
        has_fix = sample.valid and bool(fix) and None not in (latitude, longitude, height)
        status = types.make("sensor_msgs/msg/NavSatStatus", status=0 if has_fix else -1, service=1)
        header = ros_port.header(sample)
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

    def velocity(sample: Sample, v: Any, accuracy: float | None) -> object:
        variance = number(accuracy) ** 2
        # A receiver does not measure rates of turn.
        spread = diagonal(variance, variance, variance, *(NOT_MEASURED,) * 3)
        return twist_stamped(ros_port, sample, enu(v), spread, "map")

    yield ros_port.sensor_topic("", "sensor_msgs/msg/NavSatFix", make)
    vel = ros_port.complete(("v_NS",), velocity, ("velocity_accuracy",))
    yield ros_port.sensor_topic("/vel", "geometry_msgs/msg/TwistWithCovarianceStamped", vel)


def heading_deg(heading: float) -> float:
    """Return a heading, given in rad, in degrees as services of the autopilot take it."""
    return deg(heading)
