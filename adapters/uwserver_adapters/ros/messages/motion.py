"""Motion sensors: IMU, magnetometer, motion capture, the autopilot's estimate, and ground truth of a body. Mounts as transforms."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from uwserver.frames import IDENTITY, Quat, rotate
from uwserver.ports import Sample
from uwserver_adapters.ros.messages.frames import BEAM, SONAR, attitude, enu, flu, mounted, mounted_unflipped
from uwserver_adapters.ros.messages.ros_port import Facts, RosPort, SensorTopic, diagonal, is_whole, ros_name, unknown
from uwserver_adapters.ros.messages.types import LAST_NS, Types

_NAN3 = (float("nan"),) * 3
_EXACT = np.zeros(36)
NOT_MEASURED = 1e6
"""Variance of a quantity that a sensor does not measure: so large that no filter takes the value for knowledge."""
_FSD: tuple[tuple[str, Quat], ...] = (("_fsd", (1.0, 0.0, 0.0, 0.0)),)


def imu(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield an Imu without an orientation, and a Temperature where the port has one."""
    types = ros_port.types
    none, level = unknown(), types.quaternion(IDENTITY)
    acceleration, rate = (diagonal(*ros_port.variances(name)) for name in ("f_S", "w_S"))

    def make(sample: Sample, force: Any, turn: Any) -> object:
        return types.make(
            "sensor_msgs/msg/Imu", header=ros_port.header(sample), orientation=level, orientation_covariance=none,
            angular_velocity=types.vector(flu(turn)), angular_velocity_covariance=rate,
            linear_acceleration=types.vector(flu(force)), linear_acceleration_covariance=acceleration,
        )  # fmt: skip

    cdr = None if types.is_ros1 else imu_cdr(ros_port, tuple(rate), tuple(acceleration))
    yield ros_port.sensor_topic("", "sensor_msgs/msg/Imu", ros_port.complete(("f_S", "w_S"), make), cdr=cdr)
    if ros_port.has("temperature"):
        yield temperature(ros_port)


def imu_cdr(
    ros_port: RosPort, rate: tuple[float, ...], acceleration: tuple[float, ...]
) -> Callable[[Sample], bytes | None]:
    """Return a maker of an Imu's CDR bytes that skips the message: same bytes, a quarter of the time.

    The layout of an Imu is fixed once the name of its frame is known.
    """
    get, epoch_ns = ros_port.bind("f_S", "w_S"), ros_port.facts.epoch_ns
    frame = ros_port.frame.encode() + b"\0"
    begin = 12 + len(frame)  # of the body: stamp, length of the text, text
    # 4 bytes of encapsulation, the header, padding to a multiple of 8, then 37 numbers.
    packer = struct.Struct(f"<4xiiI{len(frame)}s{-begin % 8}x37d")
    none = (0.0, 0.0, 0.0, 1.0, -1.0, *(0.0,) * 8)

    def cdr(sample: Sample) -> bytes | None:
        force, turn = get(sample.value)
        if not sample.valid or None in force or None in turn:
            return None
        sec, nanosec = divmod(min(max(epoch_ns + sample.t_ns, 0), LAST_NS), 1_000_000_000)
        made = bytearray(packer.pack(
            sec, nanosec, len(frame), frame, *none, turn[0], -turn[1], -turn[2], *rate, force[0], -force[1], -force[2],
            *acceleration,
        ))  # fmt: skip
        made[1] = 1  # encapsulation: little endian
        return bytes(made)

    return cdr


def scalar(ros_port: RosPort, suffix: str, type_name: str, field: str, key: str) -> SensorTopic:
    """Return a topic of one field with a header and a variance, such as Temperature.

    Args:
        ros_port: the port.
        suffix: appended to the name of the port.
        type_name: type name of the message.
        field: field of the port.
        key: the field of the message that holds the value.
    """
    types = ros_port.types
    (variance,) = ros_port.variances(field, 1)

    def make(sample: Sample, value: Any) -> object:
        return types.make(type_name, header=ros_port.header(sample), variance=variance, **{key: value})

    return ros_port.sensor_topic(suffix, type_name, ros_port.complete((field,), make))


def temperature(ros_port: RosPort) -> SensorTopic:
    """Return the topic of the water temperature at a sensor."""
    return scalar(ros_port, "/temperature", "sensor_msgs/msg/Temperature", "temperature", "temperature")


def magnetometer(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a MagneticField."""
    types, spread = ros_port.types, diagonal(*ros_port.variances("field_S"))

    def make(sample: Sample, field: Any) -> object:
        return types.make(
            "sensor_msgs/msg/MagneticField", header=ros_port.header(sample), magnetic_field=types.vector(flu(field)),
            magnetic_field_covariance=spread,
        )  # fmt: skip

    yield ros_port.sensor_topic("", "sensor_msgs/msg/MagneticField", ros_port.complete(("field_S",), make))


def twist_stamped(
    ros_port: RosPort, sample: Sample, linear: object, spread: object, frame: str | None = None
) -> object:
    """Return a TwistWithCovarianceStamped without a rotation, in ROS axes; its frame is that of the sensor by default."""
    types = ros_port.types
    twist = types.make("geometry_msgs/msg/Twist", linear=types.vector(linear))
    both = types.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=spread)
    return types.make("geometry_msgs/msg/TwistWithCovarianceStamped", header=ros_port.header(sample, frame), twist=both)


def pose_stamped(ros_port: RosPort, sample: Sample, p: object, q: object, spread: object) -> object:
    """Return a PoseWithCovarianceStamped in map, in ROS axes; `q` is w x y z."""
    types = ros_port.types
    pose = types.make("geometry_msgs/msg/Pose", position=types.point(p), orientation=types.quaternion(q))
    both = types.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=spread)
    return types.make("geometry_msgs/msg/PoseWithCovarianceStamped", header=ros_port.header(sample, "map"), pose=both)


def motion_capture(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield the pose of the marker frame in map."""
    north, east, down = ros_port.variances("p_NS")
    spread = diagonal(east, north, down, *ros_port.variances("q_NS"))

    def make(sample: Sample, p: Any, q: Any) -> object:
        return pose_stamped(ros_port, sample, enu(p), attitude(q), spread)

    make_whole = ros_port.complete(("p_NS", "q_NS"), make)
    yield ros_port.sensor_topic("", "geometry_msgs/msg/PoseWithCovarianceStamped", make_whole)


# -- truth --------------------------------------------------------------------------------------------------------------------------------


def odometry(
    ros_port: RosPort, sample: Sample, frame: str, p: object, q: object, v: object, w: object,
    spreads: tuple[object, object] = (_EXACT, _EXACT),
) -> object:  # fmt: skip
    """Return an Odometry of the vehicle in ROS axes, with the twist in those of base_link.

    Args:
        ros_port, sample: where it comes from.
        frame: frame of the pose.
        p, q: pose; `q` is w x y z.
        v, w: linear and angular velocity, m/s and rad/s.
        spreads: covariances of pose and twist.
    """
    types = ros_port.types
    pose = types.make("geometry_msgs/msg/Pose", position=types.point(p), orientation=types.quaternion(q))
    twist = types.make("geometry_msgs/msg/Twist", linear=types.vector(v), angular=types.vector(w))
    return types.make(
        "nav_msgs/msg/Odometry", header=ros_port.header(sample, frame), child_frame_id=ros_port.base,
        pose=types.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=spreads[0]),
        twist=types.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=spreads[1]),
    )  # fmt: skip


def transform(ros_port: RosPort, sample: Sample, parent: str, p: object, q: object) -> object:
    """Return a TFMessage with the transform from `parent` to base_link, in ROS axes."""
    types = ros_port.types
    moved = types.make("geometry_msgs/msg/Transform", translation=types.vector(p), rotation=types.quaternion(q))
    stamped = types.make(
        "geometry_msgs/msg/TransformStamped", header=ros_port.header(sample, parent), child_frame_id=ros_port.base,
        transform=moved,
    )  # fmt: skip
    return types.make("tf2_msgs/msg/TFMessage", transforms=[stamped])


def truth_pose(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield an Odometry of pose and velocity, and the transform where ``/tf`` is to hold the truth.

    Pose and velocity are two ports with the same times: the message is made when both samples of a time are here.
    """
    get = ros_port.bind("p_NB", "q_NB")
    beside = ros_port.port.path.rsplit("/", 1)[0] + "/velocity"
    held: dict[str, Sample] = {}

    def make(sample: Sample) -> object | None:
        held[sample.port] = sample
        pose, velocity = held.get(ros_port.port.path), held.get(beside)
        if pose is None or velocity is None or pose.t_ns != velocity.t_ns or not (pose.valid and velocity.valid):
            return None
        (p, q), (v, w) = get(pose.value), velocity.value
        if not all(map(is_whole, (p, q, v, w))):
            return None
        return odometry(ros_port, pose, "map", enu(p), attitude(q), flu(v), flu(w))  # type: ignore[arg-type]

    def tf(sample: Sample, p: Any, q: Any) -> object:
        return transform(ros_port, sample, "map", enu(p), attitude(q))

    topic = ros_port.name.rsplit("/", 1)[0] + "/odom"
    yield SensorTopic(topic, "nav_msgs/msg/Odometry", (ros_port.port.path, beside), make)
    if ros_port.facts.tf == "truth":
        yield SensorTopic(
            "/tf", "tf2_msgs/msg/TFMessage", (ros_port.port.path,), ros_port.complete(("p_NB", "q_NB"), tf)
        )


def truth_velocity(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a TwistStamped in base_link; the Odometry has the velocity too."""
    yield _stamped_pair(ros_port, ("v_NB_B", "w_NB_B"), "Twist", ("linear", "angular"))


def truth_acceleration(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield an AccelStamped in base_link."""
    yield _stamped_pair(ros_port, ("v_dot_B", "w_dot_B"), "Accel", ("linear", "angular"))


def truth_wrench(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield a WrenchStamped in base_link."""
    yield _stamped_pair(ros_port, ("force_B", "torque_B"), "Wrench", ("force", "torque"))


def _stamped_pair(ros_port: RosPort, fields: tuple[str, str], kind: str, names: tuple[str, str]) -> SensorTopic:
    """Return a topic of two vectors of the body: the stamped form of a message of geometry_msgs, in base_link."""
    types = ros_port.types
    inner, outer = f"geometry_msgs/msg/{kind}", f"geometry_msgs/msg/{kind}Stamped"

    def make(sample: Sample, a: Any, b: Any) -> object:
        pair = types.make(inner, **{names[0]: types.vector(flu(a)), names[1]: types.vector(flu(b))})
        return types.make(outer, header=ros_port.header(sample, ros_port.base), **{kind.lower(): pair})

    return ros_port.sensor_topic("", outer, ros_port.complete(fields, make))


def estimate(ros_port: RosPort) -> Iterator[SensorTopic]:
    """Yield the autopilot's state: Odometry in odom, its transform, its mode, and its diagnostics."""
    types = ros_port.types
    status = ros_port.bind("mode", "armed", "failsafe")
    vehicle, odom = "/" + ros_port.vehicle, f"{ros_port.vehicle}/odom"

    def make(sample: Sample, p: Any, q: Any, v: Any, w: Any, position: Any, velocity: Any) -> object:
        back = (q[0], -q[1], -q[2], -q[3])
        v_B = rotate(back, v) if is_whole(v) else _NAN3
        w_B = w if is_whole(w) else _NAN3
        spreads = (
            diagonal(*(0.0 if position else NOT_MEASURED,) * 2, 0.0, 0.0, 0.0, 0.0),
            diagonal(*(0.0 if velocity else NOT_MEASURED,) * 3, 0.0, 0.0, 0.0),
        )
        return odometry(ros_port, sample, odom, enu(p), attitude(q), flu(v_B), flu(w_B), spreads)

    def tf(sample: Sample, p: Any, q: Any) -> object:
        return transform(ros_port, sample, odom, enu(p), attitude(q))

    def mode(sample: Sample) -> object:
        return types.make("std_msgs/msg/String", data=str(status(sample.value)[0] or ""))

    def diagnostics(sample: Sample) -> object:
        name, armed, failsafe = status(sample.value)
        told = {"mode": name or "", "armed": str(bool(armed)).lower(), "failsafe": failsafe or ""}
        values = [types.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in told.items()]
        one = types.make(
            "diagnostic_msgs/msg/DiagnosticStatus", level=1 if failsafe else 0, name=f"{ros_port.vehicle}: autopilot",
            message=failsafe or name or "", hardware_id=ros_port.vehicle, values=values,
        )  # fmt: skip
        return types.make("diagnostic_msgs/msg/DiagnosticArray", header=ros_port.header(sample, ""), status=[one])

    path, where = (ros_port.port.path,), ("p_N", "q_NB")
    state = ros_port.complete(where, make, ("v_N", "w_B", "position_valid", "velocity_valid"))
    yield SensorTopic(vehicle + "/odometry", "nav_msgs/msg/Odometry", path, state)
    yield SensorTopic(vehicle + "/mode", "std_msgs/msg/String", path, mode, latched=True)
    yield SensorTopic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", path, diagnostics)
    if ros_port.facts.tf == "estimate":
        yield SensorTopic("/tf", "tf2_msgs/msg/TFMessage", path, ros_port.complete(where, tf))


_FRAMES: dict[str, tuple[tuple[str, Quat], ...]] = {
    "Dvl": (*_FSD, ("_beam", BEAM)),
    "Range": (("_beam", BEAM),),
    "SonarPing": (("_sonar", SONAR),),
    "SonarImage": (("_sonar", SONAR),),
    "SideScan": _FSD,
    "Bathymetry": _FSD,
    "SonarProfile": _FSD,
}
"""Standard message of a sensor -> further frames that its messages name: suffix, and attitude in S."""


def static_transforms(
    types: Types, facts: Facts, sensors: Iterable[tuple[str, str]], vehicles: Iterable[str]
) -> object:
    """Return a TFMessage with the frames of all sensors whose mount is known.

    Args:
        types: message types of the distribution.
        facts: what is the same for all topics, with the mounts.
        sensors: path of each sensor, and the standard message that its fields fit.
        vehicles: names of the vehicles that have an autopilot: their frame odom equals map, as their estimate starts there.
    """
    made = []
    for path, message in sensors:
        mount = facts.mounts.get(path)
        if mount is not None:
            frame = ros_name(path)
            base, place = f"{frame.split('/')[0]}/base_link", flu(mount.p)
            made.append(_transform(types, facts, base, frame, place, mounted(mount.q)))
            for suffix, q in _FRAMES.get(message, ()):
                made.append(_transform(types, facts, base, frame + suffix, place, mounted_unflipped(mount.q, q)))
    for vehicle in vehicles:
        made.append(_transform(types, facts, "map", f"{ros_name(vehicle)}/odom", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    return types.make("tf2_msgs/msg/TFMessage", transforms=made)


def _transform(types: Types, facts: Facts, parent: str, child: str, p: object, q: object) -> object:
    return types.make(
        "geometry_msgs/msg/TransformStamped", header=types.header(facts.epoch_ns, parent), child_frame_id=child,
        transform=types.make("geometry_msgs/msg/Transform", translation=types.vector(p), rotation=types.quaternion(q)),
    )  # fmt: skip
