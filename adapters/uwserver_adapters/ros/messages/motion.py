"""Sensors of motion: imu, magnetometer, motion capture, the autopilot's estimate, and the truth about a body."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

import numpy as np

from uwserver.frames import IDENTITY, rotate
from uwserver.ports import Sample
from uwserver_adapters.ros.messages.frames import attitude, enu, flu
from uwserver_adapters.ros.messages.source import Outlet, Source, diagonal, is_whole, unknown
from uwserver_adapters.ros.messages.types import LAST_NS


def imu(source: Source) -> Iterator[Outlet]:
    """Imu without an orientation; Temperature beside it where the port has one."""
    types, get = source.types, source.bind("f_S", "w_S")
    none, level = unknown(), types.quaternion(IDENTITY)
    acceleration, rate = (diagonal(*source.variances(name)) for name in ("f_S", "w_S"))

    def make(sample: Sample) -> object | None:
        force, turn = get(sample.value)
        if not (sample.valid and is_whole(force) and is_whole(turn)):
            return None
        return types.make(
            "sensor_msgs/msg/Imu", header=source.header(sample), orientation=level, orientation_covariance=none,
            angular_velocity=types.vector(flu(turn)), angular_velocity_covariance=rate,
            linear_acceleration=types.vector(flu(force)), linear_acceleration_covariance=acceleration,
        )  # fmt: skip

    cdr = None if types.is_ros1 else imu_cdr(source, tuple(rate), tuple(acceleration))
    yield source.outlet("", "sensor_msgs/msg/Imu", make, cdr=cdr)
    if source.has("temperature"):
        yield temperature(source)


def imu_cdr(
    source: Source, rate: tuple[float, ...], acceleration: tuple[float, ...]
) -> Callable[[Sample], bytes | None]:
    """The same bytes as by way of a message, in a quarter of the time: the layout of Imu is fixed once the name of its frame is."""
    get, epoch_ns = source.bind("f_S", "w_S"), source.facts.epoch_ns
    frame = source.frame.encode() + b"\0"
    begin = 12 + len(frame)  # of the body: stamp, length of the text, text
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
        made[1] = 1
        return bytes(made)

    return cdr


def temperature(source: Source) -> Outlet:
    """Temperature of the water at a sensor."""
    types, get = source.types, source.bind("temperature")
    (variance,) = source.variances("temperature", 1)

    def make(sample: Sample) -> object | None:
        value = get(sample.value)
        if not sample.valid or value is None:
            return None
        return types.make(
            "sensor_msgs/msg/Temperature", header=source.header(sample), temperature=value, variance=variance
        )

    return source.outlet("/temperature", "sensor_msgs/msg/Temperature", make)


def magnetometer(source: Source) -> Iterator[Outlet]:
    """MagneticField."""
    types, get = source.types, source.bind("field_S")
    spread = diagonal(*source.variances("field_S"))

    def make(sample: Sample) -> object | None:
        field = get(sample.value)
        if not (sample.valid and is_whole(field)):
            return None
        return types.make(
            "sensor_msgs/msg/MagneticField", header=source.header(sample), magnetic_field=types.vector(flu(field)),
            magnetic_field_covariance=spread,
        )  # fmt: skip

    yield source.outlet("", "sensor_msgs/msg/MagneticField", make)


NOT_MEASURED = 1e6
"""Variance of what is no business of a sensor: no filter takes it for knowledge."""


def twist_stamped(
    source: Source, sample: Sample, frame: str, linear: object, angular: object, spread: object
) -> object:
    """A TwistWithCovarianceStamped; everything in ROS axes."""
    types = source.types
    twist = types.make("geometry_msgs/msg/Twist", linear=types.vector(linear), angular=types.vector(angular))
    both = types.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=spread)
    return types.make("geometry_msgs/msg/TwistWithCovarianceStamped", header=source.header(sample, frame), twist=both)


def motion_capture(source: Source) -> Iterator[Outlet]:
    """Pose of the marker frame in map."""
    types, get = source.types, source.bind("p_NS", "q_NS")
    north, east, down = source.variances("p_NS")
    spread = diagonal(east, north, down, *source.variances("q_NS"))

    def make(sample: Sample) -> object | None:
        p, q = get(sample.value)
        if not (sample.valid and is_whole(p) and is_whole(q)):
            return None
        pose = types.make(
            "geometry_msgs/msg/Pose", position=types.point(enu(p)), orientation=types.quaternion(attitude(q))
        )
        both = types.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=spread)
        return types.make("geometry_msgs/msg/PoseWithCovarianceStamped", header=source.header(sample, "map"), pose=both)

    yield source.outlet("", "geometry_msgs/msg/PoseWithCovarianceStamped", make)


# -- truth --------------------------------------------------------------------------------------------------------------------------------


def odometry(
    source: Source, sample: Sample, frame: str, p: object, q: object, v: object, w: object,
    spreads: tuple[object, object] | None = None,
) -> object:  # fmt: skip
    """An Odometry of the vehicle; everything in ROS axes, the twist in those of base_link."""
    types = source.types
    pose = types.make("geometry_msgs/msg/Pose", position=types.point(p), orientation=types.quaternion(q))
    twist = types.make("geometry_msgs/msg/Twist", linear=types.vector(v), angular=types.vector(w))
    of_pose, of_twist = spreads or (_EXACT, _EXACT)
    return types.make(
        "nav_msgs/msg/Odometry", header=source.header(sample, frame), child_frame_id=source.base,
        pose=types.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=of_pose),
        twist=types.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=of_twist),
    )  # fmt: skip


_EXACT = np.zeros(36)


def transform(source: Source, sample: Sample, parent: str, p: object, q: object) -> object:
    """A TFMessage with the one transform from `parent` to base_link."""
    types = source.types
    moved = types.make("geometry_msgs/msg/Transform", translation=types.vector(p), rotation=types.quaternion(q))
    stamped = types.make(
        "geometry_msgs/msg/TransformStamped", header=source.header(sample, parent), child_frame_id=source.base,
        transform=moved,
    )  # fmt: skip
    return types.make("tf2_msgs/msg/TFMessage", transforms=[stamped])


def truth_pose(source: Source) -> Iterator[Outlet]:
    """Odometry of pose and velocity, which are two ports with the same times; the transform where the truth is asked for."""
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

    def tf(sample: Sample) -> object | None:
        p, q = get(sample.value)
        whole = sample.valid and is_whole(p) and is_whole(q)
        return transform(source, sample, "map", enu(p), attitude(q)) if whole else None

    topic = source.name.rsplit("/", 1)[0] + "/odom"
    yield Outlet(topic, "nav_msgs/msg/Odometry", (source.port.path, beside), make)
    if source.facts.tf == "truth":
        yield Outlet("/tf", "tf2_msgs/msg/TFMessage", (source.port.path,), tf)


def truth_velocity(source: Source) -> Iterator[Outlet]:
    """TwistStamped in base_link; Odometry has it too."""
    yield _stamped_pair(source, ("v_NB_B", "w_NB_B"), "Twist", ("linear", "angular"))


def truth_acceleration(source: Source) -> Iterator[Outlet]:
    """AccelStamped in base_link."""
    yield _stamped_pair(source, ("v_dot_B", "w_dot_B"), "Accel", ("linear", "angular"))


def truth_wrench(source: Source) -> Iterator[Outlet]:
    """WrenchStamped in base_link."""
    yield _stamped_pair(source, ("force_B", "torque_B"), "Wrench", ("force", "torque"))


def _stamped_pair(source: Source, fields: tuple[str, str], kind: str, names: tuple[str, str]) -> Outlet:
    """Two vectors of the body as the stamped form of a message of geometry_msgs, in base_link."""
    types, get = source.types, source.bind(*fields)
    inner, outer = f"geometry_msgs/msg/{kind}", f"geometry_msgs/msg/{kind}Stamped"

    def make(sample: Sample) -> object | None:
        a, b = get(sample.value)
        if not (sample.valid and is_whole(a) and is_whole(b)):
            return None
        pair = types.make(inner, **{names[0]: types.vector(flu(a)), names[1]: types.vector(flu(b))})
        return types.make(outer, header=source.header(sample, source.base), **{kind.lower(): pair})

    return source.outlet("", outer, make)


def estimate(source: Source) -> Iterator[Outlet]:
    """The autopilot's state: Odometry in odom, its transform, its mode, and what it has to say."""
    types = source.types
    get = source.bind("p_N", "q_NB", "v_N", "w_B", "position_valid", "velocity_valid")
    status = source.bind("mode", "armed", "failsafe")
    vehicle, odom = "/" + source.vehicle, f"{source.vehicle}/odom"

    def state(sample: Sample) -> tuple[object, ...] | None:
        p, q, v, w, *_ = get(sample.value)
        if not (sample.valid and is_whole(p) and is_whole(q)):
            return None
        turned = (q[0], -q[1], -q[2], -q[3])
        v_B = rotate(turned, v) if is_whole(v) else (float("nan"),) * 3
        return enu(p), attitude(q), flu(v_B), flu(w) if is_whole(w) else (float("nan"),) * 3

    def make(sample: Sample) -> object | None:
        known = state(sample)
        if known is None:
            return None
        *_, position, velocity = get(sample.value)
        spreads = (
            diagonal(*(0.0 if position else NOT_MEASURED,) * 2, 0.0, 0.0, 0.0, 0.0),
            diagonal(*(0.0 if velocity else NOT_MEASURED,) * 3, 0.0, 0.0, 0.0),
        )
        p, q, v, w = known
        return odometry(source, sample, odom, p, q, v, w, spreads)

    def tf(sample: Sample) -> object | None:
        known = state(sample)
        return None if known is None else transform(source, sample, odom, known[0], known[1])

    def mode(sample: Sample) -> object | None:
        return types.make("std_msgs/msg/String", data=str(status(sample.value)[0] or ""))

    def diagnostics(sample: Sample) -> object | None:
        name, armed, failsafe = status(sample.value)
        told = {"mode": name or "", "armed": str(bool(armed)).lower(), "failsafe": failsafe or ""}
        values = [types.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in told.items()]
        one = types.make(
            "diagnostic_msgs/msg/DiagnosticStatus", level=1 if failsafe else 0, name=f"{source.vehicle}: autopilot",
            message=failsafe or name or "", hardware_id=source.vehicle, values=values,
        )  # fmt: skip
        return types.make("diagnostic_msgs/msg/DiagnosticArray", header=source.header(sample, ""), status=[one])

    path = (source.port.path,)
    yield Outlet(vehicle + "/odometry", "nav_msgs/msg/Odometry", path, make)
    yield Outlet(vehicle + "/mode", "std_msgs/msg/String", path, mode, latched=True)
    yield Outlet("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", path, diagnostics)
    if source.facts.tf == "estimate":
        yield Outlet("/tf", "tf2_msgs/msg/TFMessage", path, tf)
