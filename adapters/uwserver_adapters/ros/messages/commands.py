"""Commands from ROS to actuators and the autopilot: the standard message of each, and its conversion to our command."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from uwserver.frames import Quat, Vec3, rpy_from_quat
from uwserver.ports import Port
from uwserver_adapters.ros.messages.frames import attitude, enu, flu
from uwserver_adapters.ros.messages.generated import definition, field_name, generated_type
from uwserver_adapters.ros.messages.ros_port import ros_name
from uwserver_adapters.ros.messages.types import BadMessage, Types

Value = Mapping[str, object]
"""Field -> value of a command. `AdapterContext.command` checks it."""


class Held:
    """The last command to all thrusters of a vehicle.

    A command always holds the whole vector. One for a single thruster therefore repeats the values of the others from here.

    Args:
        size: number of thrusters.
    """

    def __init__(self, size: int) -> None:
        self._neutral = [0.0] * size
        self._accepted = self._neutral
        self._asked: deque[list[float]] = deque(maxlen=64)

    @property
    def newest(self) -> list[float]:
        """The newest command that the world has accepted, or has not answered yet."""
        return self._asked[-1] if self._asked else self._accepted

    def ask(self, told: list[float]) -> None:
        """Note a command that is sent to the world."""
        self._asked.append(told)

    def judge(self, told: list[float], is_accepted: bool) -> None:
        """Note the world's answer to a command.

        The world answers in the order of commands: nothing more comes for earlier ones.
        """
        if any(one is told for one in self._asked):
            while self._asked.popleft() is not told:
                pass
        if is_accepted:
            self._accepted = told

    def forget(self) -> None:
        """Note that the actuator went to neutral."""
        self._accepted = self._neutral
        self._asked.clear()


@dataclass(frozen=True)
class CommandTopic:
    """A topic that commands an actuator.

    Attributes:
        name: name of the topic.
        type: ``package/msg/Name``.
        port: path of the actuator.
        value: turns a message into a command; raises `BadMessage`.
        held: for thrusters, their last command.
        field: the field of the command that `held` keeps.
    """

    name: str
    type: str
    port: str
    value: Callable[[Any], Value]
    held: Held | None = None
    field: str = ""


def command_topics(types: Types, port: Port) -> Iterator[CommandTopic]:
    """Yield all topics that command one actuator."""
    name, vehicle = "/" + ros_name(port.path), "/" + ros_name(port.path).split("/")[0]
    last = port.path.rsplit("/", 1)[-1]
    table, key = (_AUTOPILOT, last) if port.kind == "autopilot" else (_MESSAGES, port.message or "")
    required, topics = table.get(key, ((), ()))
    if topics and {field.name for field in port.fields}.issuperset(required):
        for topic, type_name, value in topics:
            where = topic.format(name=name, vehicle=vehicle)
            yield CommandTopic(where, type_name, port.path, _of_vehicle(value, vehicle.strip("/")))
    elif len(port.fields) == 1 and port.fields[0].type == "float":
        yield from _numbers(port, name)
    else:
        yield _generated(types, port, name)


def _of_vehicle(value: Callable[[Any, str], Value], vehicle: str) -> Callable[[Any], Value]:
    return lambda message: value(message, vehicle)


def _numbers(port: Port, name: str) -> Iterator[CommandTopic]:
    """Yield the topics of an actuator with one field: a number, or a list in the order of the port's description; and one for each thruster."""
    field = port.fields[0].name
    if not port.fields[0].shape:
        yield CommandTopic(name + "/cmd", "std_msgs/msg/Float64", port.path, lambda message: {field: message.data})
        return
    held = Held(port.fields[0].size)

    yield CommandTopic(
        name + "/cmd", "std_msgs/msg/Float64MultiArray", port.path, lambda message: {field: message.data.tolist()}, held, field
    )  # fmt: skip
    for k, thruster in enumerate(port.propulsors or ()):

        def one_of(message: Any, k: int = k) -> Value:
            others = held.newest
            return {field: [*others[:k], message.data, *others[k + 1 :]]}

        yield CommandTopic(
            f"{name}/{ros_name(thruster.name)}/cmd", "std_msgs/msg/Float64", port.path, one_of, held, field
        )


def _generated(types: Types, port: Port, name: str) -> CommandTopic:
    """Return a topic with a generated type. A NaN, an empty list and an empty text are left out of the command."""
    type_name = generated_type(types, port, definition(port, is_command=True), "Command")
    names = [(field, field_name(field)) for field in port.fields]

    def value(message: Any) -> Value:
        told: dict[str, object] = {}
        for field, key in names:
            part = getattr(message, key)
            if hasattr(part, "tolist"):
                part = part.tobytes() if field.is_packed else part.tolist()
            if (part != part) if isinstance(part, float) else (part in ([], "", b"")):
                continue
            told[field.name] = part
        return told

    return CommandTopic(name + "/cmd", type_name, port.path, value)


# -- standard messages ----------------------------------------------------------------------------------------------------------------------


def check_frame(message: Any, *allowed: str) -> None:
    """Check that a message is given in one of these frames, or names no frame.

    Raises:
        BadMessage: it names another frame.
    """
    frame = message.header.frame_id.strip("/")
    if frame and frame not in allowed:
        raise BadMessage(f'header.frame_id is "{frame[:60]}": give it in {allowed[0]}, or leave it empty')


def parts(vector: Any) -> Vec3:
    """Return x, y and z of a message."""
    return (vector.x, vector.y, vector.z)


def _wrench(message: Any, vehicle: str) -> Value:
    return {"force_B": list(flu(parts(message.force))), "torque_B": list(flu(parts(message.torque)))}


def _wrench_stamped(message: Any, vehicle: str) -> Value:
    check_frame(message, f"{vehicle}/base_link", "base_link")
    return _wrench(message.wrench, vehicle)


def _twist(message: Any, vehicle: str) -> Value:
    if message.angular.x or message.angular.y:
        raise BadMessage("angular.x and angular.y must be 0: the autopilot keeps roll and pitch itself")
    return {"v_B": list(flu(parts(message.linear))), "yaw_rate": -message.angular.z}


def _twist_stamped(message: Any, vehicle: str) -> Value:
    check_frame(message, f"{vehicle}/base_link", "base_link")
    return _twist(message.twist, vehicle)


def q_NB_of(orientation: Any) -> Quat | None:
    """Return q_NB from an orientation of ROS; None where it is all zero, which is how clients leave it out.

    Raises:
        BadMessage: it is no unit quaternion.
    """
    q = (orientation.w, orientation.x, orientation.y, orientation.z)
    size = sum(part * part for part in q)
    if size == 0.0:
        return None
    if not 0.99 < size < 1.01:
        raise BadMessage(f"the orientation is no unit quaternion: its length is {size**0.5:g}")
    return attitude(q)


def pose_in_map(message: Any) -> tuple[Vec3, float | None]:
    """Return position (p_N, m) and heading (rad) of a PoseStamped in map; the heading is None where the orientation is all zero.

    Raises:
        BadMessage: it is given in another frame, or its orientation is no unit quaternion.
    """
    check_frame(message, "map")
    q = q_NB_of(message.pose.orientation)
    return enu(parts(message.pose.position)), None if q is None else rpy_from_quat(q)[2]


def _pose(message: Any, vehicle: str) -> Value:
    place, heading = pose_in_map(message)
    return {"p_N": list(place)} if heading is None else {"p_N": list(place), "heading": heading}


def placed(message: Any, pose: Any, *frames: str) -> dict[str, object]:
    """Return p_NB, and q_NB where it is given, of a pose in a message with a header.

    Raises:
        BadMessage: the header names none of these frames, or the orientation is no unit quaternion.
    """
    check_frame(message, *frames)
    q = q_NB_of(pose.orientation)
    p_NB: dict[str, object] = {"p_NB": list(enu(parts(pose.position)))}
    return p_NB if q is None else {**p_NB, "q_NB": list(q)}


def _teleport(message: Any, vehicle: str) -> Value:
    return placed(message, message.pose, "map")


def _seen_at(message: Any) -> dict[str, object]:
    """Return the time by the sender's clock, s, where the message has one."""
    stamp = message.header.stamp
    return {"stamp": stamp.sec + stamp.nanosec * 1e-9} if stamp.sec or stamp.nanosec else {}


def _followed(message: Any, vehicle: str) -> Value:
    """Return the pose of a vehicle that is simulated elsewhere."""
    return {**placed(message, message.pose, "map", "world"), **_seen_at(message)}


def _odometry(message: Any, vehicle: str) -> Value:
    """Return pose and velocity of a vehicle that is simulated elsewhere.

    The twist is in the axes of the body. A covariance that begins with -1 says that the twist is unknown.
    """
    child = message.child_frame_id.strip("/")
    if child not in ("", "base_link", f"{vehicle}/base_link"):
        raise BadMessage(f'child_frame_id is "{child[:60]}": tell the twist in {vehicle}/base_link')
    told = {**placed(message, message.pose.pose, "map", "world"), **_seen_at(message)}
    if message.twist.covariance[0] != -1.0:
        twist = message.twist.twist
        told |= {"v_NB_B": list(flu(parts(twist.linear))), "w_NB_B": list(flu(parts(twist.angular)))}
    return told


def _joy(message: Any, vehicle: str) -> Value:
    axes = message.axes.tolist()
    if len(axes) != 6:
        raise BadMessage(f"axes must have 6 items (surge, sway, heave, roll, pitch, yaw), not {len(axes)}")
    return {"u": [*flu(axes[:3]), *flu(axes[3:])]}


_Topics = tuple[tuple[str, str, Callable[[Any, str], Value]], ...]
"""Name, type, and conversion to a command, of each topic of an actuator."""
_MESSAGES: dict[str, tuple[tuple[str, ...], _Topics]] = {
    "Wrench": (
        ("force_B", "torque_B"),
        (
            ("{name}/cmd", "geometry_msgs/msg/Wrench", _wrench),
            ("{name}/cmd_stamped", "geometry_msgs/msg/WrenchStamped", _wrench_stamped),
        ),
    ),
    "FollowedPose": (
        ("p_NB", "q_NB", "v_NB_B", "w_NB_B", "stamp"),
        (
            ("{name}/cmd", "geometry_msgs/msg/PoseStamped", _followed),
            ("{name}/odometry", "nav_msgs/msg/Odometry", _odometry),
        ),
    ),
    "Teleport": (("p_NB", "q_NB"), (("{name}/cmd", "geometry_msgs/msg/PoseStamped", _teleport),)),
}
"""Standard message of an actuator -> the fields that its port must have, and its topics."""
_AUTOPILOT: dict[str, tuple[tuple[str, ...], _Topics]] = {
    "velocity": (
        ("v_B", "yaw_rate"),
        (
            ("{vehicle}/cmd_vel", "geometry_msgs/msg/Twist", _twist),
            ("{vehicle}/cmd_vel_stamped", "geometry_msgs/msg/TwistStamped", _twist_stamped),
        ),
    ),
    "position": (("p_N", "heading"), (("{vehicle}/cmd_pose", "geometry_msgs/msg/PoseStamped", _pose),)),
    "depth": (("depth",), (("{vehicle}/cmd_depth", "std_msgs/msg/Float64", lambda m, _: {"depth": m.data}),)),
    "altitude": (
        ("altitude",),
        (("{vehicle}/cmd_altitude", "std_msgs/msg/Float64", lambda m, _: {"altitude": m.data}),),
    ),
    "heading": (("heading",), (("{vehicle}/cmd_heading", "std_msgs/msg/Float64", lambda m, _: {"heading": m.data}),)),
    "pilot": (("u",), (("{vehicle}/joy", "sensor_msgs/msg/Joy", _joy),)),
}
