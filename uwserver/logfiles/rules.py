"""Finds the most likely mapping of a log from the names of its topics and types, for a user to edit."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from collections.abc import Mapping as Mapping_
from itertools import islice
from typing import Any

from msgspec import structs

from uwserver.logfiles.log import Log
from uwserver.logfiles.mapping import (
    Actuators,
    Attitude,
    Axes,
    Entry,
    Mapping,
    Match,
    PortMapping,
    Position,
    Track,
    Value,
    Velocity,
)
from uwserver.logfiles.ports import ports_of

_REPORTS_READ = 2000
_MOST_OUTPUTS = 16
_Found = Iterator[tuple[str, Track]]


def mapping_of(log: Log) -> Mapping:
    """Return the tracks and ports that the rules find in a log; an empty mapping when nothing fits.

    Raises:
        LogError: the log is damaged.
    """
    tracks: dict[str, Track] = {}
    for name, track in _RULES[log.kind](log):
        plain = re.sub(r"\W+", "_", name).strip("_").lower() or "track"
        free = next(n for n in (plain, *(f"{plain}_{k}" for k in range(2, 100_000))) if n not in tracks)
        tracks[free] = track
    ports: dict[str, PortMapping] = {}
    for name, source in ports_of(log):
        ports.setdefault(name, source)
    return Mapping(tracks=tracks, ports=ports)


def _ned(north: str, east: str, down: str, where: Match | None = None, topic: str = "") -> Position:
    return Position(topic=topic, where=where or {}, north=north, east=east, down=down)


def _quaternion(parts: str, indices: str = "0123", axes: Axes = "NED/FRD", topic: str = "") -> Attitude:
    """Return an attitude whose w, x, y, z have names that begin with `parts` and end in these four characters."""
    w, x, y, z = (f"{parts}{k}" for k in indices)
    return Attitude(topic=topic, unit="1", axes=axes, w=w, x=x, y=y, z=z)


def _euler(unit: str, roll: str, pitch: str, yaw: str, topic: str) -> Attitude | None:
    """Return an attitude of Euler angles; None without a topic."""
    return Attitude(topic=topic, unit=unit, roll=roll, pitch=pitch, yaw=yaw) if topic else None


def _filled(track: Track, topic: str, attitude: Attitude | None, outputs: Actuators | None) -> Track:
    """Return a track whose sections have this topic. A track without attitude gets the given one."""
    own, velocity = track.attitude, track.velocity
    return Track(
        structs.replace(track.position, topic=topic),
        attitude if own is None else structs.replace(own, topic=topic),
        None if velocity is None else structs.replace(velocity, topic=topic),
        outputs,
    )


def _outputs(log: Log, topic: str, name: str) -> Actuators | None:
    """Return the first outputs of an autopilot as pulses of the actuators with these numbers; a vehicle ignores those it does not have."""
    fields = {field.name for field in log.topics[topic].fields} if topic else set()
    found: dict[str, Entry] = {str(k): name.format(k) for k in range(1, _MOST_OUTPUTS + 1) if name.format(k) in fields}
    return Actuators(topic=topic, unit="us", outputs=found) if found else None


# -- MAVLink ----------------------------------------------------------------------------------------------------------------------------

_LOCAL_NED: Match = {"frame_id": 1}
"""MAV_FRAME_LOCAL_NED."""
_MAVLINK_TRACKS: Mapping_[str, tuple[str, Track]] = {
    "LOCAL_POSITION_NED": ("", Track(_ned("x", "y", "z"), velocity=Velocity(north="vx", east="vy", down="vz"))),
    "ODOMETRY": ("_odometry", Track(  # velocities in body axes
        _ned("x", "y", "z", _LOCAL_NED), _quaternion("q."), Velocity(where=_LOCAL_NED, forward="vx", right="vy", down="vz"))),
    "GLOBAL_POSITION_INT": ("_global", Track(
        Position(unit="mm", angle_unit="degE7", latitude="lat", longitude="lon", up="relative_alt"),
        velocity=Velocity(unit="cm/s", north="vx", east="vy", down="vz"))),
    "SIM_STATE": ("_truth", Track(
        Position(latitude="lat", longitude="lon", up="alt"), _quaternion("q", "1234"), Velocity(north="vn", east="ve", down="vd"))),
}  # fmt: skip
"""Tracks by message: the suffix of their names, and their sections without topics. A track without attitude uses that of its system."""


def _telemetry(log: Log) -> _Found:
    for sender in dict.fromkeys(name.rpartition("/")[0] for name in log.topics):

        def topic(message: str, sender: str = sender) -> str:
            name = f"{sender}/{message}"
            return name if name in log.topics else ""

        outputs = _outputs(log, topic("SERVO_OUTPUT_RAW"), "servo{}_raw")
        vehicle = "vehicle_" + (sender.partition("/")[0] if sender.endswith("/1") else sender)
        attitude = _euler("rad", "roll", "pitch", "yaw", topic("ATTITUDE"))
        if quaternion := topic("ATTITUDE_QUATERNION"):
            attitude = _quaternion("q", "1234", topic=quaternion)
        for message, (suffix, track) in _MAVLINK_TRACKS.items():
            if source := topic(message):
                yield f"{vehicle}{suffix}", _filled(track, source, attitude, outputs)


# -- ArduPilot --------------------------------------------------------------------------------------------------------------------------

_FIX = Track(Position(latitude="Lat", longitude="Lng", up="Alt"))
_ROLL_PITCH_YAW = ("Roll", "Pitch", "Yaw")
_DATAFLASH_TRACKS: Mapping_[str, tuple[tuple[str, ...], Track]] = {
    "filter": (("XKF1", "NKF1"), Track(_ned("PN", "PE", "PD"), velocity=Velocity(north="VN", east="VE", down="VD"))),
    "truth": (("SIM",), _FIX), "position": (("POS",), _FIX), "gps": (("GPS",), _FIX),
}  # fmt: skip
"""Tracks by name: the record types of which the first that exists is used, and their sections without topics."""


def _dataflash(log: Log) -> _Found:
    def topic(*names: str) -> str:
        return next((n for name in names for n in (f"{name}[0]", name) if n in log.topics), "")

    outputs = _outputs(log, topic("RCOU"), "C{}")
    attitude = _euler("deg", *_ROLL_PITCH_YAW, topic("ATT"))
    if quaternion := topic("XKQ", "NKQ"):
        attitude = _quaternion("Q", "1234", topic=quaternion)
    for name, (types, track) in _DATAFLASH_TRACKS.items():
        if source := topic(*types):
            if name == "truth":  # it has an attitude of its own
                is_quaternion = _has(log, source, "Q1")
                own = _quaternion("Q", "1234") if is_quaternion else _euler("deg", *_ROLL_PITCH_YAW, source)
                track = structs.replace(track, attitude=own)
            yield name, _filled(track, source, attitude, outputs)


# -- MOOS -------------------------------------------------------------------------------------------------------------------------------


def _moos(log: Log) -> _Found:
    def value(name: str, unit: str | None = None) -> Value | None:
        return Value("value", name, unit) if name in log.topics else None

    prefixes = [
        name.removesuffix("_X") for name in log.topics if name.endswith("_X") and f"{name[:-2]}_Y" in log.topics
    ]
    for prefix in sorted(prefixes, key=lambda p: p != "NAV"):
        attitude = None
        if f"{prefix}_HEADING" in log.topics:
            attitude = Attitude(
                unit="rad",
                yaw=value(f"{prefix}_HEADING", "deg"),
                pitch=value(f"{prefix}_PITCH"),
                roll=value(f"{prefix}_ROLL"),
            )
        position = Position(east=value(f"{prefix}_X"), north=value(f"{prefix}_Y"), depth=value(f"{prefix}_DEPTH"))
        yield prefix, Track(position, attitude)
    for topic in ("NODE_REPORT_LOCAL", "NODE_REPORT"):
        names = (d.value.get("NAME") for d in islice(log.read({topic}), _REPORTS_READ))
        for name in dict.fromkeys(str(n) for n in names if n):
            reporter: Match = {"NAME": name}
            position = Position(topic=topic, where=reporter, east="X", north="Y", depth="DEP")
            yield f"report_{name}", Track(position, Attitude(topic=topic, where=reporter, unit="deg", yaw="HDG"))


# -- ROS --------------------------------------------------------------------------------------------------------------------------------


def _ros(log: Log) -> _Found:
    poses = {
        "Odometry": "pose.pose.",
        "PoseStamped": "pose.",
        "PoseWithCovarianceStamped": "pose.pose.",
        "PoseInFrame": "pose.",
    }
    for topic in log.topics.values():
        prefix = poses.get(re.split(r"[/.]", topic.schema)[-1])
        if prefix is None:
            continue
        at = f"{prefix}position."
        position = Position(topic=topic.name, east=f"{at}x", north=f"{at}y", up=f"{at}z")
        attitude = _quaternion(f"{prefix}orientation.", "wxyz", "ENU/FLU", topic.name)
        velocity = None
        if topic.schema.endswith("Odometry"):
            of = "twist.twist.linear."
            velocity = Velocity(topic=topic.name, forward=f"{of}x", left=f"{of}y", up=f"{of}z")
        yield topic.name, Track(position, attitude, velocity)


# -- PX4, recordings of uwserver, tables ---------------------------------------------------------------------------------------------------


def _array_outputs(log: Log, topic: str, field: str, unit: str, type_: str) -> Actuators | None:
    """Return the items of an array field, of type ``float32[8]`` say, as outputs of the actuators with their numbers."""
    types = [f.type for f in log.topics[topic].fields if f.name == field] if topic in log.topics else []
    size = re.fullmatch(rf"{type_}\[(\d{{1,2}})\]", types[0]) if types else None
    if size is None:
        return None
    return Actuators(topic=topic, unit=unit, outputs={str(k + 1): f"{field}.{k}" for k in range(int(size[1]))})


_PX4_POSE = Track(_ned("x", "y", "z"), velocity=Velocity(north="vx", east="vy", down="vz"))
_PX4_ODOMETRY = Track(_ned("position.0", "position.1", "position.2"), _quaternion("q."))


def _ulog(log: Log) -> _Found:
    # Set points of the motors, -1 to 1; older logs have the pulses of all outputs.
    motors = _array_outputs(log, "actuator_motors", "control", "1", "float32")
    outputs = motors or _array_outputs(log, "actuator_outputs", "output", "us", "float32")
    for suffix, name in (("", "filter"), ("_groundtruth", "truth")):
        place, turn = f"vehicle_local_position{suffix}", f"vehicle_attitude{suffix}"
        if place in log.topics:
            attitude = _quaternion("q.", topic=turn) if turn in log.topics else None
            yield name, _filled(_PX4_POSE, place, attitude, outputs)
    if (odometry := "vehicle_odometry") in log.topics and _has(log, odometry, "position"):
        yield "odometry", _filled(_PX4_ODOMETRY, odometry, None, outputs)


def _recorded(log: Log) -> _Found:
    for name in log.topics:
        vehicle, _, rest = name.partition("/")
        if not vehicle:  # the channels for other viewers repeat the poses
            continue
        attitude = _quaternion("value.q_NB.", topic=name)
        if rest == "truth/pose" or (_has(log, name, "value.p_NB") and _has(log, name, "value.q_NB")):
            velocity = None
            if (of := f"{vehicle}/truth/velocity") in log.topics:
                f, r, d = (f"value.v_NB_B.{k}" for k in range(3))
                velocity = Velocity(topic=of, forward=f, right=r, down=d)
            n, e, d = (f"value.p_NB.{k}" for k in range(3))
            thrusters = commanded(log, f"{vehicle}/thrusters")
            yield vehicle, Track(_ned(n, e, d, topic=name), attitude, velocity, thrusters)
        elif _has(log, name, "value.p_N") and _has(log, name, "value.q_NB"):
            n, e, d = (f"value.p_N.{k}" for k in range(3))
            place = _ned(n, e, d, {"value.position_valid": True}, name)
            n, e, d = (f"value.v_N.{k}" for k in range(3))
            yield name, Track(place, attitude, Velocity(topic=name, north=n, east=e, down=d))
    if not log.topics.keys().isdisjoint({"/pose", "/odom"}):
        yield from _ros(log)


def commanded(log: Log, port: str) -> Actuators | None:
    """Return the commands to the thrusters of a vehicle in a recording of ours; None when there are none."""
    return (
        _array_outputs(log, port, "value.u", "1", "number")
        if port in log.topics and log.topics[port].count != 0
        else None
    )


_COLUMNS = {
    "north": r"(pos_?)?n(orth)?(ing)?|p_nb?\.0", "east": r"(pos_?)?e(ast)?(ing)?|p_nb?\.1", "down": r"d(own)?|p_nb?\.2", "depth": "depth", "up": "up",
    "altitude": "alt(itude)?|height", "latitude": "lat(itude)?", "longitude": "lon(g|gitude)?",
    "roll": "roll|phi", "pitch": "pitch|theta", "yaw": "yaw|heading|hdg|psi",
    "w": r"q_?w|q_nb\.0", "x": r"q_?x|q_nb\.1", "y": r"q_?y|q_nb\.2", "z": r"q_?z|q_nb\.3",
    "v_north": r"v_?n(orth)?|v_n\.0", "v_east": r"v_?e(ast)?|v_n\.1", "v_down": r"v_?d(own)?|v_n\.2",
}  # fmt: skip


def _table(log: Log) -> _Found:
    for topic in log.topics.values():
        found: dict[str, Any] = {}
        for field in topic.fields:
            for part, pattern in _COLUMNS.items():
                default = "deg" if part in ("roll", "pitch", "yaw", "latitude", "longitude") else None
                stem = field.name.lower().removesuffix(f"_{field.unit.lower().replace('/', 'p')}")
                if part not in found and re.fullmatch(pattern, re.sub(r"\s*[\[(].*", "", stem).strip()):
                    found[part] = Value(field.name, "", field.unit or default)
        pairs = (("north", "east"), ("latitude", "longitude"))
        place = next(({k: found[k] for k in pair} for pair in pairs if found.keys() >= set(pair)), None)
        if place is None:
            continue
        vertical = [k for k in ("down", "depth", "up", "altitude") if k in found][:1]
        attitude = None
        if {"w", "x", "y", "z"} <= found.keys():
            attitude = Attitude(topic=topic.name, unit="1", **{k: found[k] for k in "wxyz"})
        elif "yaw" in found:
            attitude = Attitude(topic=topic.name, **{k: found[k] for k in ("roll", "pitch", "yaw") if k in found})
        velocity = None
        if {"v_north", "v_east", "v_down"} <= found.keys():
            velocity = Velocity(topic=topic.name, **{k: found[f"v_{k}"] for k in ("north", "east", "down")})
        position = Position(topic=topic.name, **place, **{k: found[k] for k in vertical})
        yield topic.name, Track(position, attitude, velocity)


def _has(log: Log, topic: str, field: str) -> bool:
    return any(f.name == field or f.name.startswith(f"{field}.") for f in log.topics[topic].fields)


_RULES: dict[str, Callable[[Log], _Found]] = {
    "uwserver": _recorded, "mcap": _ros, "bag": _ros, "rosbag2": _ros, "tlog": _telemetry, "bin": _dataflash, "alog": _moos,
    "ulg": _ulog, "csv": _table, "parquet": _table,
}  # fmt: skip
