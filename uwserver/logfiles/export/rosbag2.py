"""Writes a log as a ROS 2 bag (MCAP) of standard messages in ENU and FLU: tracks as Odometry, sensors as sensor_msgs."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.frames import attitude_enu_flu, conjugate, frd_from_flu, ned_from_enu, rotate
from uwserver.logfiles.export.left_out import left_out, sample_kind
from uwserver.logfiles.log import Log
from uwserver.logfiles.mapping import Mapping as LogMapping
from uwserver.logfiles.poses import FoundTrack
from uwserver.logfiles.samples import port_samples
from uwserver.logfiles.si import scale_of
from uwserver.units import NANOSECONDS

_Entry = tuple[int, str, str, Any]
"""Time (ns), topic, type, message."""
_UNKNOWN = np.array([-1.0, *[0.0] * 8])
"""The covariance that marks a quantity as not measured in sensor_msgs/Imu."""
_DEGREE = scale_of("deg").factor


def write_rosbag2(log: Log, mapping: LogMapping, tracks: dict[str, FoundTrack], folder: Path) -> list[str]:
    """Write the bag. Stamps are UTC; if the log does not contain it, they count from the start of the log.

    Returns:
        Remarks about ports that gave no message.

    Raises:
        LogError: the log is damaged.
        OSError: the folder exists already, or cannot be written.
        ImportError: rosbags is not installed.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if folder.exists():
        raise FileExistsError(f"{folder} exists already")
    store: Any = get_typestore(Stores.ROS2_HUMBLE)
    made = _MessageFactory(store, log.epoch_ns or 0)
    written: set[str] = set()
    poses = [made.track(name, found) for name, found in tracks.items()]
    connections: dict[tuple[str, str], Any] = {}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for t_ns, topic, type_, message in heapq.merge(*poses, made.ports(log, mapping, written), key=lambda e: e[0]):
            if (topic, type_) not in connections:
                connections[topic, type_] = writer.add_connection(topic, type_, typestore=store)
            writer.write(connections[topic, type_], made.epoch_ns + t_ns, store.serialize_cdr(message, type_))
    return left_out(mapping, written)


class _MessageFactory:
    """Makes messages of the types in a type store."""

    def __init__(self, store: Any, epoch_ns: int) -> None:
        self._types, self.epoch_ns = store.types, epoch_ns

    def track(self, name: str, found: FoundTrack) -> Iterator[_Entry]:
        """Yield Odometry in the frames ``odom`` (ENU) and ``<name>/base_link`` (FLU)."""
        track, kind = found.track, "nav_msgs/msg/Odometry"
        topic, body = f"/{_word(name)}/odometry", f"{_word(name)}/base_link"
        zeros = np.zeros(36)
        for k, t_ns in enumerate(track.t_ns.tolist()):
            q_NB = track.q_NB[k].tolist()
            x, y, z = ned_from_enu(track.p_NB[k].tolist())
            w, *v = attitude_enu_flu(q_NB)
            pose = self._new(
                "Pose",
                position=self._new("Point", x=x, y=y, z=z),
                orientation=self._new("Quaternion", x=v[0], y=v[1], z=v[2], w=w),
            )
            linear = (
                (0.0, 0.0, 0.0) if track.v_N is None else frd_from_flu(rotate(conjugate(q_NB), track.v_N[k].tolist()))
            )
            twist = self._new("Twist", linear=self._vector(linear), angular=self._vector((0.0, 0.0, 0.0)))
            yield t_ns, topic, kind, self._types[kind](
                header=self._header(t_ns, "odom"), child_frame_id=body,
                pose=self._new("PoseWithCovariance", pose=pose, covariance=zeros),
                twist=self._new("TwistWithCovariance", twist=twist, covariance=zeros),
            )  # fmt: skip

    def ports(self, log: Log, mapping: LogMapping, written: set[str]) -> Iterator[_Entry]:
        """Yield Imu, FluidPressure, NavSatFix and Range; add the ports that gave a message to `written`."""
        for t_ns, port, value in port_samples(log, mapping):
            topic = "/" + "/".join(_word(part) for part in port.split("/"))
            made = self._sample(self._header(t_ns, topic[1:]), value)
            if made is not None:
                written.add(port)
                yield t_ns, topic, made.__msgtype__, made

    def _sample(self, header: Any, value: Mapping[str, Any]) -> Any:
        """Return the message for a sample; None when there is none."""
        match sample_kind(value):
            case "imu":
                level = self._new("Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
                return self._types["sensor_msgs/msg/Imu"](
                    header=header, orientation=level, orientation_covariance=_UNKNOWN,
                    angular_velocity=self._vector(frd_from_flu(value["w_S"])), angular_velocity_covariance=np.zeros(9),
                    linear_acceleration=self._vector(frd_from_flu(value["f_S"])), linear_acceleration_covariance=np.zeros(9),
                )  # fmt: skip
            case "pressure":
                return self._types["sensor_msgs/msg/FluidPressure"](
                    header=header, fluid_pressure=value["pressure"], variance=0.0
                )
            case "fix":
                status = self._types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
                height = value.get("height")
                return self._types["sensor_msgs/msg/NavSatFix"](
                    header=header, status=status, latitude=value["latitude"] / _DEGREE, longitude=value["longitude"] / _DEGREE,
                    altitude=height if isinstance(height, float) else float("nan"),
                    position_covariance=np.zeros(9), position_covariance_type=0,
                )  # fmt: skip
            case "range":
                return self._types["sensor_msgs/msg/Range"](
                    header=header, radiation_type=0, field_of_view=0.0, min_range=0.0, max_range=float("inf"), range=value["range"],
                )  # fmt: skip
        return None

    def _new(self, name: str, **values: Any) -> Any:
        return self._types[f"geometry_msgs/msg/{name}"](**values)

    def _vector(self, v: tuple[float, float, float]) -> Any:
        return self._new("Vector3", x=v[0], y=v[1], z=v[2])

    def _header(self, t_ns: int, frame: str) -> Any:
        seconds, rest = divmod(self.epoch_ns + t_ns, NANOSECONDS)
        stamp = self._types["builtin_interfaces/msg/Time"](sec=min(seconds, (1 << 31) - 1), nanosec=rest)
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def _word(name: str) -> str:
    """Return a name with the characters that ROS allows."""
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "x"
    return plain if plain[0].isalpha() else f"x{plain}"
