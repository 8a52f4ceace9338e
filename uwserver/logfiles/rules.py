"""The mapping that a log most likely wants, found by the names of its topics and types. A person edits it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

from uwserver.logfiles.log import Log
from uwserver.logfiles.mapping import Actuators, Attitude, Entry, Mapping, PortSource, Position, Track, Value, Velocity
from uwserver.logfiles.port_rules import ports_of

_REPORTS_READ = 2000
_MOST_OUTPUTS = 16
_Found = Iterator[tuple[str, Track]]


def mapping_of(log: Log) -> Mapping:
    """Tracks and ports that the rules find in a log; none of them where nothing fits.

    Raises:
        LogError: the log is damaged.
    """
    tracks: dict[str, Track] = {}
    for name, track in _RULES[log.kind](log):
        plain = re.sub(r"\W+", "_", name).strip("_").lower() or "track"
        free = next(n for n in (plain, *(f"{plain}_{k}" for k in range(2, 100_000))) if n not in tracks)
        tracks[free] = track
    ports: dict[str, PortSource] = {}
    for name, source in ports_of(log):
        ports.setdefault(name, source)
    return Mapping(tracks=tracks, ports=ports)


def _ned(topic: str, north: str, east: str, down: str) -> Position:
    return Position(topic=topic, north=north, east=east, down=down)


def _quaternion(topic: str, parts: str, indices: str = "0123") -> Attitude:
    """w, x, y, z under names that end in these four characters."""
    w, x, y, z = (f"{parts}{k}" for k in indices)
    return Attitude(topic=topic, unit="1", w=w, x=x, y=y, z=z)


def _euler(topic: str, unit: str, *names: str) -> Attitude:
    return Attitude(topic=topic, unit=unit, roll=names[0], pitch=names[1], yaw=names[2])


def _outputs(log: Log, topic: str, name: str) -> Actuators | None:
    """The first outputs of an autopilot as pulses of the actuators by their numbers; those beyond a vehicle's own count for nothing."""
    fields = {field.name for field in log.topics[topic].fields} if topic else set()
    found: dict[str, Entry] = {str(k): name.format(k) for k in range(1, _MOST_OUTPUTS + 1) if name.format(k) in fields}
    return Actuators(topic=topic, unit="us", outputs=found) if found else None


# -- MAVLink ----------------------------------------------------------------------------------------------------------------------------


def _telemetry(log: Log) -> _Found:
    senders = dict.fromkeys(name.rpartition("/")[0] for name in log.topics)
    for sender in senders:

        def topic(message: str, sender: str = sender) -> str:
            name = f"{sender}/{message}"
            return name if name in log.topics else ""

        outputs = _outputs(log, topic("SERVO_OUTPUT_RAW"), "servo{}_raw")
        vehicle = "vehicle_" + (sender.partition("/")[0] if sender.endswith("/1") else sender)
        attitude = None
        if quaternion := topic("ATTITUDE_QUATERNION"):
            attitude = _quaternion(quaternion, "q", "1234")
        elif euler := topic("ATTITUDE"):
            attitude = _euler(euler, "rad", "roll", "pitch", "yaw")
        if local := topic("LOCAL_POSITION_NED"):
            velocity = Velocity(topic=local, north="vx", east="vy", down="vz")
            yield vehicle, Track(_ned(local, "x", "y", "z"), attitude, velocity, outputs)
        if odometry := topic("ODOMETRY"):
            # MAV_FRAME_LOCAL_NED; of a body in its own axes.
            position = Position(topic=odometry, where={"frame_id": 1}, north="x", east="y", down="z")
            velocity = Velocity(topic=odometry, where={"frame_id": 1}, forward="vx", right="vy", down="vz")
            yield f"{vehicle}_odometry", Track(position, _quaternion(odometry, "q."), velocity, outputs)
        if fused := topic("GLOBAL_POSITION_INT"):
            position = Position(
                topic=fused, unit="mm", angle_unit="degE7", latitude="lat", longitude="lon", up="relative_alt"
            )
            velocity = Velocity(topic=fused, unit="cm/s", north="vx", east="vy", down="vz")
            yield f"{vehicle}_global", Track(position, attitude, velocity, outputs)
        if truth := topic("SIM_STATE"):
            position = Position(topic=truth, latitude="lat", longitude="lon", up="alt")
            velocity = Velocity(topic=truth, north="vn", east="ve", down="vd")
            yield f"{vehicle}_truth", Track(position, _quaternion(truth, "q", "1234"), velocity, outputs)


# -- ArduPilot --------------------------------------------------------------------------------------------------------------------------


def _dataflash(log: Log) -> _Found:
    def topic(*names: str) -> str:
        return next((n for name in names for n in (f"{name}[0]", name) if n in log.topics), "")

    outputs = _outputs(log, topic("RCOU"), "C{}")
    attitude = None
    if quaternion := topic("XKQ", "NKQ"):
        attitude = _quaternion(quaternion, "Q", "1234")
    elif euler := topic("ATT"):
        attitude = _euler(euler, "deg", "Roll", "Pitch", "Yaw")
    if fused := topic("XKF1", "NKF1"):
        velocity = Velocity(topic=fused, north="VN", east="VE", down="VD")
        yield "filter", Track(_ned(fused, "PN", "PE", "PD"), attitude, velocity, outputs)
    if truth := topic("SIM"):
        turn = (
            _quaternion(truth, "Q", "1234") if _has(log, truth, "Q1") else _euler(truth, "deg", "Roll", "Pitch", "Yaw")
        )
        yield "truth", Track(Position(topic=truth, latitude="Lat", longitude="Lng", up="Alt"), turn, None, outputs)
    if place := topic("POS"):
        yield (
            "position",
            Track(Position(topic=place, latitude="Lat", longitude="Lng", up="Alt"), attitude, None, outputs),
        )
    if fix := topic("GPS"):
        yield "gps", Track(Position(topic=fix, latitude="Lat", longitude="Lng", up="Alt"), attitude, None, outputs)


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
            at: dict[str, str | float | int | bool] = {"NAME": name}
            position = Position(topic=topic, where=at, east="X", north="Y", depth="DEP")
            yield f"report_{name}", Track(position, Attitude(topic=topic, where=at, unit="deg", yaw="HDG"))


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
        w, x, y, z = (f"{prefix}orientation.{k}" for k in "wxyz")
        attitude = Attitude(topic=topic.name, unit="1", axes="ENU/FLU", w=w, x=x, y=y, z=z)
        velocity = None
        if topic.schema.endswith("Odometry"):
            of = "twist.twist.linear."
            velocity = Velocity(topic=topic.name, forward=f"{of}x", left=f"{of}y", up=f"{of}z")
        yield topic.name, Track(position, attitude, velocity)


# -- PX4, ours, tables --------------------------------------------------------------------------------------------------------------------


def _outputs_of_px4(log: Log) -> Actuators | None:
    """What motors shall give, -1 to 1; in older logs the pulses of all outputs."""
    for topic, name, unit in (("actuator_motors", "control", "1"), ("actuator_outputs", "output", "us")):
        field = next((f for f in log.topics[topic].fields if f.name == name), None) if topic in log.topics else None
        size = re.fullmatch(r"float32\[(\d{1,2})\]", field.type) if field is not None else None
        if size is not None:
            outputs: dict[str, Entry] = {str(k + 1): f"{name}.{k}" for k in range(min(int(size[1]), _MOST_OUTPUTS))}
            return Actuators(topic=topic, unit=unit, outputs=outputs)
    return None


def _ulog(log: Log) -> _Found:
    outputs = _outputs_of_px4(log)
    for suffix, name in (("", "filter"), ("_groundtruth", "truth")):
        place, turn = f"vehicle_local_position{suffix}", f"vehicle_attitude{suffix}"
        if place in log.topics:
            attitude = _quaternion(turn, "q.") if turn in log.topics else None
            yield (
                name,
                Track(
                    _ned(place, "x", "y", "z"),
                    attitude,
                    Velocity(topic=place, north="vx", east="vy", down="vz"),
                    outputs,
                ),
            )
    if (odometry := "vehicle_odometry") in log.topics and _has(log, odometry, "position"):
        position = _ned(odometry, "position.0", "position.1", "position.2")
        yield "odometry", Track(position, _quaternion(odometry, "q."), None, outputs)


def _ours(log: Log) -> _Found:
    for name in log.topics:
        vehicle, _, rest = name.partition("/")
        if not vehicle:  # of viewers, who say it in their own words
            continue
        if rest == "truth/pose" or (_has(log, name, "value.p_NB") and _has(log, name, "value.q_NB")):
            velocity = None
            if (of := f"{vehicle}/truth/velocity") in log.topics:
                f, r, d = (f"value.v_NB_B.{k}" for k in range(3))
                velocity = Velocity(topic=of, forward=f, right=r, down=d)
            place = _ned(name, *(f"value.p_NB.{k}" for k in range(3)))
            yield (
                vehicle,
                Track(place, _quaternion(name, "value.q_NB."), velocity, commanded(log, f"{vehicle}/thrusters")),
            )
        elif _has(log, name, "value.p_N") and _has(log, name, "value.q_NB"):
            n, e, d = (f"value.v_N.{k}" for k in range(3))
            place = Position(
                topic=name,
                where={"value.position_valid": True},
                north="value.p_N.0",
                east="value.p_N.1",
                down="value.p_N.2",
            )
            yield name, Track(place, _quaternion(name, "value.q_NB."), Velocity(topic=name, north=n, east=e, down=d))
    if not log.topics.keys().isdisjoint({"/pose", "/odom"}):
        yield from _ros(log)


def commanded(log: Log, port: str) -> Actuators | None:
    """What the thrusters of a vehicle of ours were commanded."""
    topic = log.topics.get(port)
    field = next((f for f in topic.fields if f.name == "value.u"), None) if topic is not None else None
    size = re.fullmatch(r"number\[(\d{1,2})\]", field.type) if field is not None else None
    if size is None or topic is None or topic.count == 0:
        return None
    return Actuators(topic=port, outputs={str(k + 1): f"value.u.{k}" for k in range(int(size[1]))})


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
        place = {k: found[k] for k in ("north", "east", "latitude", "longitude") if k in found}
        if not ({"north", "east"} <= place.keys() or {"latitude", "longitude"} <= place.keys()):
            continue
        if {"north", "east"} <= place.keys():
            place = {k: v for k, v in place.items() if k in ("north", "east")}
        vertical = next((k for k in ("down", "depth", "up", "altitude") if k in found), "")
        attitude = None
        if {"w", "x", "y", "z"} <= found.keys():
            attitude = Attitude(topic=topic.name, unit="1", **{k: found[k] for k in "wxyz"})
        elif "yaw" in found:
            attitude = Attitude(topic=topic.name, **{k: found[k] for k in ("roll", "pitch", "yaw") if k in found})
        velocity = None
        if {"v_north", "v_east", "v_down"} <= found.keys():
            velocity = Velocity(topic=topic.name, **{k: found[f"v_{k}"] for k in ("north", "east", "down")})
        more = {vertical: found[vertical]} if vertical else {}
        yield topic.name, Track(Position(topic=topic.name, **place, **more), attitude, velocity)


def _has(log: Log, topic: str, field: str) -> bool:
    return any(f.name == field or f.name.startswith(f"{field}.") for f in log.topics[topic].fields)


_RULES: dict[str, Callable[[Log], _Found]] = {
    "uwserver": _ours, "mcap": _ros, "bag": _ros, "rosbag2": _ros, "tlog": _telemetry, "bin": _dataflash, "alog": _moos,
    "ulg": _ulog, "csv": _table, "parquet": _table,
}  # fmt: skip
