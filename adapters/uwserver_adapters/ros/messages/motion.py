"""Motion sensors: IMU, magnetometer, motion capture, the autopilot's estimate, and ground truth of a body."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from uwserver.frames import IDENTITY, rotate
from uwserver.ports import Sample
from uwserver_adapters.ros.messages.frames import attitude, enu, flu
from uwserver_adapters.ros.messages.source import Outlet, Source, diagonal, is_whole, unknown
from uwserver_adapters.ros.messages.types import LAST_NS

_NAN3 = (float("nan"),) * 3
_EXACT = np.zeros(36)
NOT_MEASURED = 1e6
"""Variance of a quantity that a sensor does not measure: so large that no filter takes the value for knowledge."""


def imu(source: Source) -> Iterator[Outlet]:
    """Yield an Imu without an orientation, and a Temperature where the port has one."""
    types = source.types
    none, level = unknown(), types.quaternion(IDENTITY)
    acceleration, rate = (diagonal(*source.variances(name)) for name in ("f_S", "w_S"))

    def make(sample: Sample, force: Any, turn: Any) -> object:
        return types.make(
            "sensor_msgs/msg/Imu", header=source.header(sample), orientation=level, orientation_covariance=none,
            angular_velocity=types.vector(flu(turn)), angular_velocity_covariance=rate,
            linear_acceleration=types.vector(flu(force)), linear_acceleration_covariance=acceleration,
        )  # fmt: skip

    cdr = None if types.is_ros1 else imu_cdr(source, tuple(rate), tuple(acceleration))
    yield source.outlet("", "sensor_msgs/msg/Imu", source.complete(("f_S", "w_S"), make), cdr=cdr)
    if source.has("temperature"):
        yield temperature(source)


def imu_cdr(
    source: Source, rate: tuple[float, ...], acceleration: tuple[float, ...]
) -> Callable[[Sample], bytes | None]:
    """Return a maker of an Imu's CDR bytes that skips the message: same bytes, a quarter of the time.

    The layout of an Imu is fixed once the name of its frame is known.
    """
    get, epoch_ns = source.bind("f_S", "w_S"), source.facts.epoch_ns
    frame = source.frame.encode() + b"\0"
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


def scalar(source: Source, suffix: str, type_name: str, field: str, key: str) -> Outlet:
    """Return a topic of one field with a header and a variance, such as Temperature.

    Args:
        source: the port.
        suffix: appended to the name of the port.
        type_name: of the message.
        field: of the port.
        key: the field of the message that holds the value.
    """
    types = source.types
    (variance,) = source.variances(field, 1)

    def make(sample: Sample, value: Any) -> object:
        return types.make(type_name, header=source.header(sample), variance=variance, **{key: value})

    return source.outlet(suffix, type_name, source.complete((field,), make))


def temperature(source: Source) -> Outlet:
    """Return the topic of the water temperature at a sensor."""
    return scalar(source, "/temperature", "sensor_msgs/msg/Temperature", "temperature", "temperature")


def magnetometer(source: Source) -> Iterator[Outlet]:
    """Yield a MagneticField."""
    types, spread = source.types, diagonal(*source.variances("field_S"))

    def make(sample: Sample, field: Any) -> object:
        return types.make(
            "sensor_msgs/msg/MagneticField", header=source.header(sample), magnetic_field=types.vector(flu(field)),
            magnetic_field_covariance=spread,
        )  # fmt: skip

    yield source.outlet("", "sensor_msgs/msg/MagneticField", source.complete(("field_S",), make))


def twist_stamped(source: Source, sample: Sample, linear: object, spread: object, frame: str | None = None) -> object:
    """Return a TwistWithCovarianceStamped without a rotation, in ROS axes; its frame is that of the sensor by default."""
    types = source.types
    twist = types.make("geometry_msgs/msg/Twist", linear=types.vector(linear))
    both = types.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=spread)
    return types.make("geometry_msgs/msg/TwistWithCovarianceStamped", header=source.header(sample, frame), twist=both)


def pose_stamped(source: Source, sample: Sample, p: object, q: object, spread: object) -> object:
    """Return a PoseWithCovarianceStamped in map, in ROS axes; `q` is w x y z."""
    types = source.types
    pose = types.make("geometry_msgs/msg/Pose", position=types.point(p), orientation=types.quaternion(q))
    both = types.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=spread)
    return types.make("geometry_msgs/msg/PoseWithCovarianceStamped", header=source.header(sample, "map"), pose=both)


def motion_capture(source: Source) -> Iterator[Outlet]:
    """Yield the pose of the marker frame in map."""
    north, east, down = source.variances("p_NS")
    spread = diagonal(east, north, down, *source.variances("q_NS"))

    def make(sample: Sample, p: Any, q: Any) -> object:
        return pose_stamped(source, sample, enu(p), attitude(q), spread)

    make_whole = source.complete(("p_NS", "q_NS"), make)
    yield source.outlet("", "geometry_msgs/msg/PoseWithCovarianceStamped", make_whole)


# -- truth --------------------------------------------------------------------------------------------------------------------------------


def odometry(
    source: Source, sample: Sample, frame: str, p: object, q: object, v: object, w: object,
    spreads: tuple[object, object] = (_EXACT, _EXACT),
) -> object:  # fmt: skip
    """Return an Odometry of the vehicle in ROS axes, with the twist in those of base_link.

    Args:
        source, sample: where it comes from.
        frame: frame of the pose.
        p, q: pose; `q` is w x y z.
        v, w: linear and angular velocity, m/s and rad/s.
        spreads: covariances of pose and twist.
    """
    types = source.types
    pose = types.make("geometry_msgs/msg/Pose", position=types.point(p), orientation=types.quaternion(q))
    twist = types.make("geometry_msgs/msg/Twist", linear=types.vector(v), angular=types.vector(w))
    return types.make(
        "nav_msgs/msg/Odometry", header=source.header(sample, frame), child_frame_id=source.base,
        pose=types.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=spreads[0]),
        twist=types.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=spreads[1]),
    )  # fmt: skip


def transform(source: Source, sample: Sample, parent: str, p: object, q: object) -> object:
    """Return a TFMessage with the transform from `parent` to base_link, in ROS axes."""
    types = source.types
    moved = types.make("geometry_msgs/msg/Transform", translation=types.vector(p), rotation=types.quaternion(q))
    stamped = types.make(
        "geometry_msgs/msg/TransformStamped", header=source.header(sample, parent), child_frame_id=source.base,
        transform=moved,
    )  # fmt: skip
    return types.make("tf2_msgs/msg/TFMessage", transforms=[stamped])


def truth_pose(source: Source) -> Iterator[Outlet]:
    """Yield an Odometry of pose and velocity, and the transform where ``/tf`` is to hold the truth.

    Pose and velocity are two ports with the same times: the message is made when both samples of a time are here.
    """
    get = source.bind("p_NB", "q_NB")
    beside = source.port.path.rsplit("/", 1)[0] + "/velocity"
    held: dict[str, Sample] = {}

    def make(sample: Sample) -> object | None:
        held[sample.port] = sample
        pose, velocity = held.get(source.port.path), held.get(beside)
        if pose is None or velocity is None or pose.t_ns != velocity.t_ns or not (pose.valid and velocity.valid):
            return None
        (p, q), (v, w) = get(pose.value), velocity.value
        if not all(map(is_whole, (p, q, v, w))):
            return None
        return odometry(source, pose, "map", enu(p), attitude(q), flu(v), flu(w))  # type: ignore[arg-type]

    def tf(sample: Sample, p: Any, q: Any) -> object:
        return transform(source, sample, "map", enu(p), attitude(q))

    topic = source.name.rsplit("/", 1)[0] + "/odom"
    yield Outlet(topic, "nav_msgs/msg/Odometry", (source.port.path, beside), make)
    if source.facts.tf == "truth":
        yield Outlet("/tf", "tf2_msgs/msg/TFMessage", (source.port.path,), source.complete(("p_NB", "q_NB"), tf))


def truth_velocity(source: Source) -> Iterator[Outlet]:
    """Yield a TwistStamped in base_link; the Odometry has the velocity too."""
    yield _stamped_pair(source, ("v_NB_B", "w_NB_B"), "Twist", ("linear", "angular"))


def truth_acceleration(source: Source) -> Iterator[Outlet]:
    """Yield an AccelStamped in base_link."""
    yield _stamped_pair(source, ("v_dot_B", "w_dot_B"), "Accel", ("linear", "angular"))


def truth_wrench(source: Source) -> Iterator[Outlet]:
    """Yield a WrenchStamped in base_link."""
    yield _stamped_pair(source, ("force_B", "torque_B"), "Wrench", ("force", "torque"))


def _stamped_pair(source: Source, fields: tuple[str, str], kind: str, names: tuple[str, str]) -> Outlet:
    """Return a topic of two vectors of the body: the stamped form of a message of geometry_msgs, in base_link."""
    types = source.types
    inner, outer = f"geometry_msgs/msg/{kind}", f"geometry_msgs/msg/{kind}Stamped"

    def make(sample: Sample, a: Any, b: Any) -> object:
        pair = types.make(inner, **{names[0]: types.vector(flu(a)), names[1]: types.vector(flu(b))})
        return types.make(outer, header=source.header(sample, source.base), **{kind.lower(): pair})

    return source.outlet("", outer, source.complete(fields, make))


def estimate(source: Source) -> Iterator[Outlet]:
    """Yield the autopilot's state: Odometry in odom, its transform, its mode, and its diagnostics."""
    types = source.types
    status = source.bind("mode", "armed", "failsafe")
    vehicle, odom = "/" + source.vehicle, f"{source.vehicle}/odom"

    def make(sample: Sample, p: Any, q: Any, v: Any, w: Any, position: Any, velocity: Any) -> object:
        back = (q[0], -q[1], -q[2], -q[3])
        v_B = rotate(back, v) if is_whole(v) else _NAN3
        w_B = w if is_whole(w) else _NAN3
        spreads = (
            diagonal(*(0.0 if position else NOT_MEASURED,) * 2, 0.0, 0.0, 0.0, 0.0),
            diagonal(*(0.0 if velocity else NOT_MEASURED,) * 3, 0.0, 0.0, 0.0),
        )
        return odometry(source, sample, odom, enu(p), attitude(q), flu(v_B), flu(w_B), spreads)

    def tf(sample: Sample, p: Any, q: Any) -> object:
        return transform(source, sample, odom, enu(p), attitude(q))

    def mode(sample: Sample) -> object:
        return types.make("std_msgs/msg/String", data=str(status(sample.value)[0] or ""))

    def diagnostics(sample: Sample) -> object:
        name, armed, failsafe = status(sample.value)
        told = {"mode": name or "", "armed": str(bool(armed)).lower(), "failsafe": failsafe or ""}
        values = [types.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in told.items()]
        one = types.make(
            "diagnostic_msgs/msg/DiagnosticStatus", level=1 if failsafe else 0, name=f"{source.vehicle}: autopilot",
            message=failsafe or name or "", hardware_id=source.vehicle, values=values,
        )  # fmt: skip
        return types.make("diagnostic_msgs/msg/DiagnosticArray", header=source.header(sample, ""), status=[one])

    path, where = (source.port.path,), ("p_N", "q_NB")
    state = source.complete(where, make, ("v_N", "w_B", "position_valid", "velocity_valid"))
    yield Outlet(vehicle + "/odometry", "nav_msgs/msg/Odometry", path, state)
    yield Outlet(vehicle + "/mode", "std_msgs/msg/String", path, mode, latched=True)
    yield Outlet("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", path, diagnostics)
    if source.facts.tf == "estimate":
        yield Outlet("/tf", "tf2_msgs/msg/TFMessage", path, source.complete(where, tf))
