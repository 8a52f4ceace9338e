"""Writes the tracks and sensors of a log for other middleware: as a MOOS log, as MAVLink telemetry, and as a ROS 2 bag."""

from __future__ import annotations

import heapq
import importlib
import math
import re
import struct
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from uwserver.frames import attitude_enu_flu, conjugate, frd_from_flu, ned_from_enu, rotate, rpy_from_quat
from uwserver.logfiles.log import Log
from uwserver.logfiles.mapping import Mapping as LogMapping
from uwserver.logfiles.ports import port_samples
from uwserver.logfiles.poses import FoundTrack
from uwserver.logfiles.si import scale_of
from uwserver.units import NANOSECONDS

MessageKind = Literal["imu", "pressure", "fix", "range"]
_FIELDS: Mapping[MessageKind, frozenset[str]] = {
    "imu": frozenset({"f_S", "w_S"}),
    "pressure": frozenset({"pressure"}),
    "fix": frozenset({"latitude", "longitude"}),
    "range": frozenset({"range"}),
}
_SCANNING = "head_angle"
"""The range of a scanning head is not that of a distance sensor."""
_MOST_SYSTEMS = 254
_G = scale_of("mG").factor
_E7 = scale_of("degE7").factor
_UNKNOWN = np.array([-1.0, *[0.0] * 8])
"""The covariance that marks a quantity as not measured in sensor_msgs/Imu."""
_DEGREE = scale_of("deg").factor


def message_kind(fields: Collection[str]) -> MessageKind | None:
    """Return the kind of message for a port with these fields; None when there is none."""
    for kind, wanted in _FIELDS.items():
        if wanted <= set(fields) and not (kind == "range" and _SCANNING in fields):
            return kind
    return None


def sample_kind(value: Mapping[str, Any]) -> MessageKind | None:
    """Return the kind of message for a sample; None when there is none, or the sample has not all its numbers."""
    return message_kind([name for name, part in value.items() if name == _SCANNING or _is_complete(name, part)])


def _is_complete(name: str, value: object) -> bool:
    """Return whether a field has its finite numbers: three for a vector of an inertial unit, one for any other field."""
    is_vector = name in _FIELDS["imu"]
    numbers = value if isinstance(value, tuple) else (value,)
    is_numeric = all(isinstance(number, int | float) and math.isfinite(number) for number in numbers)
    return is_numeric and isinstance(value, tuple) == is_vector and len(numbers) == (3 if is_vector else 1)


def left_out(mapping: LogMapping, written: Collection[str]) -> list[str]:
    """Return remarks about the ports of a mapping that gave no message.

    Args:
        mapping: the mapping of the log.
        written: the ports that gave at least one message.
    """
    absent = {name: message_kind(source.fields) for name, source in mapping.ports.items() if name not in written}
    without_message = [name for name, kind in absent.items() if kind is None]
    without_sample = [name for name, kind in absent.items() if kind is not None]
    remarks = [f"left out, because no message fits: {', '.join(without_message)}"] if without_message else []
    if without_sample:
        remarks.append(f"left out, because no sample was valid: {', '.join(without_sample)}")
    return remarks


# -- MOOS -------------------------------------------------------------------------------------------------------------------------------

_Line = tuple[int, str, str]
"""Time (ns), variable, value."""


def write_alog(log: Log, mapping: LogMapping, tracks: dict[str, FoundTrack], file: Path) -> None:
    """Write the file. The first track has the prefix NAV, the others have their names; headings are in degrees, as usual in MOOS.

    Raises:
        LogError: the log is damaged.
        OSError: the file exists already, or cannot be written.
    """
    poses = [
        _moos_track("NAV" if k == 0 else _moos_name(name), found) for k, (name, found) in enumerate(tracks.items())
    ]
    began = (log.epoch_ns or 0) / NANOSECONDS
    with file.open("x", encoding="utf-8", newline="\n") as out:
        out.write(
            f"%% LOG FILE:       {file.name}\n%% FILE OPENED ON  {log.path.name}\n%% LOGSTART           {began:.6f}\n"
        )
        for t_ns, name, text in heapq.merge(*poses, _moos_ports(log, mapping), key=lambda line: line[0]):
            out.write(f"{t_ns / NANOSECONDS:<16.6f}{name:<24} uwserver  {text}\n")


def _moos_track(prefix: str, found: FoundTrack) -> Iterator[_Line]:
    degree = scale_of("deg").factor
    track = found.track
    for t_ns, p, q in zip(track.t_ns.tolist(), track.p_NB.tolist(), track.q_NB.tolist(), strict=True):
        roll, pitch, yaw = rpy_from_quat(q)
        whole = (
            ("X", p[1]),
            ("Y", p[0]),
            ("DEPTH", p[2]),
            ("HEADING", yaw % math.tau / degree),
            ("PITCH", pitch),
            ("ROLL", roll),
        )
        for name, value in whole:
            yield t_ns, f"{prefix}_{name}", f"{value:.9g}"


def _moos_ports(log: Log, mapping: LogMapping) -> Iterator[_Line]:
    for datum in port_samples(log, mapping):
        for field, value in datum.value.items():
            for suffix, number in _moos_values(value):
                yield datum.t_ns, _moos_name(f"{datum.topic}_{field}{suffix}"), number


def _moos_values(value: object) -> Iterator[tuple[str, str]]:
    if isinstance(value, tuple):
        for k, part in enumerate(value):
            if part is not None:
                yield f"_{k}", str(part)
    elif isinstance(value, str):
        yield "", " ".join(value.split())
    elif value is not None:
        yield "", str(value).lower() if isinstance(value, bool) else repr(value)


def _moos_name(name: str) -> str:
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").upper() or "TRACK"


# -- MAVLink ----------------------------------------------------------------------------------------------------------------------------

_Frame = tuple[int, int, Any]
"""Time (ns), system number, message."""


def write_tlog(log: Log, mapping: LogMapping, tracks: dict[str, FoundTrack], file: Path) -> list[str]:
    """Write the file: ATTITUDE_QUATERNION and LOCAL_POSITION_NED for tracks; SCALED_PRESSURE2, SCALED_IMU2, GPS_RAW_INT, DISTANCE_SENSOR for ports.

    Stamps are UTC; if the log does not contain it, they count from the start of the log.

    Returns:
        Remarks about ports that gave no message.

    Raises:
        LogError: the log is damaged.
        OSError: the file exists already, or cannot be written.
    """
    dialect: Any = importlib.import_module("pymavlink.dialects.v20.ardupilotmega")
    systems = {name: 1 + k % _MOST_SYSTEMS for k, name in enumerate(tracks)}
    links = {system: dialect.MAVLink(None, srcSystem=system, srcComponent=1) for system in {1, *systems.values()}}
    written: set[str] = set()
    poses = [_mavlink_track(dialect, systems[name], found) for name, found in tracks.items()]
    ports = _mavlink_ports(dialect, log, mapping, systems, written)
    heartbeats = _heartbeats(dialect, log, sorted(links))
    epoch = log.epoch_ns or 0
    with file.open("xb") as out:
        for t_ns, system, message in heapq.merge(heartbeats, *poses, ports, key=lambda frame: frame[0]):
            link = links[system]
            out.write(struct.pack(">Q", (epoch + t_ns) // 1000) + message.pack(link))
            link.seq = (link.seq + 1) % 256
    return left_out(mapping, written)


def _heartbeats(dialect: Any, log: Log, systems: list[int]) -> Iterator[_Frame]:
    """Yield a heartbeat of each system every second; a ground station ignores a system without heartbeats."""
    for t_ns in range(log.start_ns, log.end_ns + 1, NANOSECONDS):
        for system in systems:
            yield t_ns, system, dialect.MAVLink_heartbeat_message(12, 0, 0, 0, 4, 3)  # submarine, generic, active


def _mavlink_track(dialect: Any, system: int, found: FoundTrack) -> Iterator[_Frame]:
    track = found.track
    for k, t_ns in enumerate(track.t_ns.tolist()):
        ms = t_ns // 1_000_000 & 0xFFFFFFFF
        v = [0.0, 0.0, 0.0] if track.v_N is None else track.v_N[k].tolist()
        yield t_ns, system, dialect.MAVLink_attitude_quaternion_message(ms, *track.q_NB[k].tolist(), 0.0, 0.0, 0.0)
        yield t_ns, system, dialect.MAVLink_local_position_ned_message(ms, *track.p_NB[k].tolist(), *v)


def _mavlink_ports(
    dialect: Any, log: Log, mapping: LogMapping, systems: Mapping[str, int], written: set[str]
) -> Iterator[_Frame]:
    for t_ns, port, value in port_samples(log, mapping):
        message = _mavlink_message(dialect, t_ns, value)
        if message is not None:
            written.add(port)
            yield t_ns, systems.get(port.partition("/")[0], 1), message


def _mavlink_message(dialect: Any, t_ns: int, value: Mapping[str, Any]) -> Any:
    """Return the message for a sample; None when there is none."""
    ms = t_ns // 1_000_000 & 0xFFFFFFFF
    match sample_kind(value):
        case "pressure":
            celsius = _signed(_number(value, "temperature") * 100, 16)
            return dialect.MAVLink_scaled_pressure2_message(ms, value["pressure"] / 100.0, 0.0, celsius)
        case "fix":
            place = (_signed(value[name] / _E7, 32) for name in ("latitude", "longitude"))
            height = _signed(_number(value, "height") * 1000, 32)
            fix, satellites = (
                min(max(int(_number(value, "fix")), 0), 8),
                min(max(int(_number(value, "satellites")), 0), 255),
            )
            unknown = [65535] * 4  # dilutions of precision, speed and course
            return dialect.MAVLink_gps_raw_int_message(t_ns // 1000, fix, *place, height, *unknown, satellites)
        case "imu":
            forces, rates = [_signed(f / _G, 16) for f in value["f_S"]], [_signed(w * 1000, 16) for w in value["w_S"]]
            return dialect.MAVLink_scaled_imu2_message(ms, *forces, *rates, 0, 0, 0)
        case "range":
            downwards = 25
            centimetres = min(max(round(value["range"] * 100), 0), 65535)
            return dialect.MAVLink_distance_sensor_message(ms, 0, 65535, centimetres, 2, 0, downwards, 255)
    return None


def _number(value: Mapping[str, Any], name: str) -> float:
    """Return a field of a sample as a number; 0 when it has none."""
    number = value.get(name)
    return float(number) if isinstance(number, int | float) else 0.0


def _signed(number: float, bits: int) -> int:
    """Return a signed integer, clipped to this number of bits."""
    most = (1 << (bits - 1)) - 1
    return round(min(max(number, -most - 1), most))


# -- ROS 2 ------------------------------------------------------------------------------------------------------------------------------

_Entry = tuple[int, str, str, Any]
"""Time (ns), topic, type, message."""


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
    made = _RosMessages(store, log.epoch_ns or 0)
    written: set[str] = set()
    poses = [made.track(name, found) for name, found in tracks.items()]
    connections: dict[tuple[str, str], Any] = {}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for t_ns, topic, type_, message in heapq.merge(*poses, made.ports(log, mapping, written), key=lambda e: e[0]):
            if (topic, type_) not in connections:
                connections[topic, type_] = writer.add_connection(topic, type_, typestore=store)
            writer.write(connections[topic, type_], made.epoch_ns + t_ns, store.serialize_cdr(message, type_))
    return left_out(mapping, written)


class _RosMessages:
    """Makes messages of the types in a type store."""

    def __init__(self, store: Any, epoch_ns: int) -> None:
        self._types, self.epoch_ns = store.types, epoch_ns

    def track(self, name: str, found: FoundTrack) -> Iterator[_Entry]:
        """Yield Odometry in the frames ``odom`` (ENU) and ``<name>/base_link`` (FLU)."""
        track, kind = found.track, "nav_msgs/msg/Odometry"
        topic, body = f"/{_ros_name(name)}/odometry", f"{_ros_name(name)}/base_link"
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
            topic = "/" + "/".join(_ros_name(part) for part in port.split("/"))
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


def _ros_name(name: str) -> str:
    """Return a name with the characters that ROS allows."""
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "x"
    return plain if plain[0].isalpha() else f"x{plain}"
