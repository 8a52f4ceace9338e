"""The ports of a log: rules find them by the message types of each format, and a mapping gives their samples in our units and axes."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import numpy as np

from uwserver.logfiles.log import Datum, Kind, Log, Topic, matches, member
from uwserver.logfiles.mapping import Entry, Mapping, PortMapping, Value, value_of
from uwserver.logfiles.si import Scale, is_known, scale_of

_Part = tuple[str, Scale, float]
"""Name of a log field, its conversion to SI, and the mapping's own factor."""
_FLU = (1.0, -1.0, -1.0)
_STAMPS = ("time_ns", "seq", "t_ns", "t_sent_ns", "valid")


def port_samples(
    log: Log,
    mapping: Mapping,
    ports: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Datum]:
    """Yield samples of ports in the order of their times: ``Datum(t_ns, port, {field: number, text or tuple})``, in SI.

    A value that is not a finite number is None. A datum without any value of a port gives no sample.

    Raises:
        LogError: the log is damaged.
    """
    by_topic: dict[str, list[tuple[str, PortMapping, dict[str, list[_Part] | _Part]]]] = {}
    for name, source in mapping.ports.items():
        if ports is None or name in ports:
            by_topic.setdefault(source.topic, []).append((name, source, _parts(source)))
    for t_ns, topic, datum in log.read(set(by_topic), start_ns, end_ns):
        for name, source, parts in by_topic[topic]:
            if matches(datum, source.where):
                found = {
                    field: tuple(_value(datum, p) for p in part) if isinstance(part, list) else _value(datum, part)
                    for field, part in parts.items()
                }
                if any(value is not None for value in found.values()):
                    yield Datum(t_ns, name, found)


def _parts(source: PortMapping) -> dict[str, list[_Part] | _Part]:
    def part(entry: Entry) -> _Part:
        value = value_of(entry)
        return value.field, scale_of(value.unit or ""), value.scale

    return {
        field: [part(entry) for entry in entries] if isinstance(entries, list) else part(entries)
        for field, entries in source.fields.items()
    }


def _value(datum: Any, part: _Part) -> object:
    field, scale, factor = part
    value = member(datum, field)
    if isinstance(value, bool | str):
        return value
    converted = (number(value) * scale.factor + scale.offset) * factor
    return converted if math.isfinite(converted) else None


def number(value: object) -> float:
    """Return a number of a log; NaN for everything else."""
    try:
        return float(value) if isinstance(value, int | float | np.number) else math.nan
    except OverflowError:
        return math.nan


# -- rules ------------------------------------------------------------------------------------------------------------------------------


class _Rule(NamedTuple):
    """A message type gives a port of this name and kind. Each port field is a message field with its unit, or a list of three."""

    port: str
    kind: str
    fields: dict[str, Entry | list[Entry]]


def _v(field: str, unit: str, scale: float = 1.0) -> Value:
    return Value(field, "", unit, scale)


def _three(
    pattern: str, unit: str, keys: str = "xyz", signs: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> list[Entry]:
    return [Value(pattern.format(key), "", unit, sign) for key, sign in zip(keys, signs, strict=True)]


_MAVLINK = {
    "SCALED_PRESSURE": _Rule("barometer", "pressure", {"pressure": _v("press_abs", "hPa"), "temperature": _v("temperature", "cdegC")}),
    "SCALED_PRESSURE2": _Rule("pressure", "pressure", {"pressure": _v("press_abs", "hPa"), "temperature": _v("temperature", "cdegC")}),
    "SCALED_IMU2": _Rule("imu2", "imu", {"f_S": _three("{}acc", "mG"), "w_S": _three("{}gyro", "mrad/s")}),
    "SCALED_IMU": _Rule("imu", "imu", {"f_S": _three("{}acc", "mG"), "w_S": _three("{}gyro", "mrad/s")}),
    "RAW_IMU": _Rule("imu_raw", "imu", {"f_S": _three("{}acc", "mG"), "w_S": _three("{}gyro", "mrad/s")}),
    "GPS_RAW_INT": _Rule("gps", "gps", {"latitude": _v("lat", "degE7"), "longitude": _v("lon", "degE7"), "height": _v("alt", "mm"),
                                        "satellites": _v("satellites_visible", "1"), "fix": _v("fix_type", "1")}),
    "DISTANCE_SENSOR": _Rule("altimeter", "altimeter", {"range": _v("current_distance", "cm")}),
    "RANGEFINDER": _Rule("rangefinder", "altimeter", {"range": _v("distance", "m")}),
    "ATTITUDE": _Rule("attitude", "attitude", {"roll": _v("roll", "rad"), "pitch": _v("pitch", "rad"), "heading": _v("yaw", "rad")}),
    "SYS_STATUS": _Rule("battery", "battery", {"voltage": _v("voltage_battery", "mV"), "current": _v("current_battery", "cA")}),
}  # fmt: skip
_ARDUPILOT = {
    "IMU": _Rule("imu", "imu", {"f_S": _three("Acc{}", "m/s^2", "XYZ"), "w_S": _three("Gyr{}", "rad/s", "XYZ")}),
    "BARO": _Rule("pressure", "pressure", {"pressure": _v("Press", "Pa"), "temperature": _v("Temp", "degC")}),
    "ATT": _Rule("attitude", "attitude", {"roll": _v("Roll", "deg"), "pitch": _v("Pitch", "deg"), "heading": _v("Yaw", "deg")}),
    "GPS": _Rule("gps", "gps", {"latitude": _v("Lat", "deg"), "longitude": _v("Lng", "deg"), "height": _v("Alt", "m"),
                                "satellites": _v("NSats", "1"), "fix": _v("Status", "1")}),
    "RFND": _Rule("altimeter", "altimeter", {"range": _v("Dist", "m")}),
    "BAT": _Rule("battery", "battery", {"voltage": _v("Volt", "V"), "current": _v("Curr", "A")}),
    "MAG": _Rule("magnetometer", "magnetometer", {"B_S": _three("Mag{}", "mgauss", "XYZ")}),
}  # fmt: skip
_ROS = {
    "Imu": _Rule("imu", "imu", {"f_S": _three("linear_acceleration.{}", "m/s^2", signs=_FLU),
                                "w_S": _three("angular_velocity.{}", "rad/s", signs=_FLU)}),
    "FluidPressure": _Rule("pressure", "pressure", {"pressure": _v("fluid_pressure", "Pa")}),
    "NavSatFix": _Rule("gps", "gps", {"latitude": _v("latitude", "deg"), "longitude": _v("longitude", "deg"), "height": _v("altitude", "m")}),
    "LocationFix": _Rule("gps", "gps", {"latitude": _v("latitude", "deg"), "longitude": _v("longitude", "deg"), "height": _v("altitude", "m")}),
    "Range": _Rule("altimeter", "altimeter", {"range": _v("range", "m")}),
    "BatteryState": _Rule("battery", "battery", {"voltage": _v("voltage", "V"), "current": _v("current", "A", -1.0)}),
    "MagneticField": _Rule("magnetometer", "magnetometer", {"B_S": _three("magnetic_field.{}", "T", signs=_FLU)}),
    "TwistWithCovarianceStamped": _Rule("dvl", "dvl", {"v_S": _three("twist.twist.linear.{}", "m/s", signs=_FLU)}),
}  # fmt: skip
_PX4 = {
    "sensor_combined": _Rule("imu", "imu", {"f_S": _three("accelerometer_m_s2.{}", "m/s^2", "012"), "w_S": _three("gyro_rad.{}", "rad/s", "012")}),
    "vehicle_air_data": _Rule("pressure", "pressure", {"pressure": _v("baro_pressure_pa", "Pa")}),
    "distance_sensor": _Rule("altimeter", "altimeter", {"range": _v("current_distance", "m")}),
    "battery_status": _Rule("battery", "battery", {"voltage": _v("voltage_v", "V"), "current": _v("current_a", "A")}),
}  # fmt: skip
_MOOS = {
    "NAV_DEPTH": _Rule("depth", "depth", {"depth": _v("value", "m")}),
    "NAV_HEADING": _Rule("heading", "compass", {"heading": _v("value", "deg")}),
    "NAV_ALTITUDE": _Rule("altimeter", "altimeter", {"range": _v("value", "m")}),
}


def ports_of(log: Log) -> Iterator[tuple[str, PortMapping]]:
    """Yield the ports that the topics of a log give, with names made from its vehicles and topics."""
    for topic in log.topics.values():
        rule = _rule(log.kind, topic)
        if rule is not None:
            known = {field.name for field in topic.fields}
            fields = {key: entry for key, entry in rule.fields.items() if not known or _is_there(entry, known)}
            if fields:
                yield _name(log.kind, topic, rule), PortMapping(topic.name, fields, rule.kind)


def _is_there(entry: Entry | list[Entry], known: set[str]) -> bool:
    names = [value_of(e).field for e in (entry if isinstance(entry, list) else [entry])]
    return all(name in known or name.rpartition(".")[0] in known for name in names)


def _rule(kind: Kind, topic: Topic) -> _Rule | None:
    if kind == "uwserver":
        return _recorded(topic)
    if kind in ("csv", "parquet"):
        return _exported(topic)
    if kind == "alog":
        return _MOOS.get(topic.name)
    if kind in ("tlog", "bin", "ulg"):
        return {"tlog": _MAVLINK, "bin": _ARDUPILOT, "ulg": _PX4}[kind].get(topic.schema)
    return _ROS.get(re.split(r"[/.]", topic.schema)[-1])


def _name(kind: Kind, topic: Topic, rule: _Rule) -> str:
    if kind == "tlog":
        system, component = topic.name.split("/")[:2]
        return f"vehicle_{system}{'' if component == '1' else f'_{component}'}/{rule.port}"
    if kind in ("bin", "ulg", "alog"):
        instance = topic.name.partition("[")[2].rstrip("]")
        return f"vehicle/{rule.port}{'' if instance == '0' else instance}"
    if kind in ("mcap", "bag", "rosbag2"):
        return re.sub(r"[^\w/]+", "_", topic.name).strip("/") or "topic"
    return topic.name


def _exported(topic: Topic) -> _Rule | None:
    """Return the rule for a sensor in a table of `uwserver export`. Its columns are ``name [unit]``; of a vector ``name.0 [unit]`` and so on."""
    names = {field.name for field in topic.fields}
    if not {"seq", "t_sent_ns", "valid"} <= names or "/truth/" in topic.name:
        return None
    fields: dict[str, Entry | list[Entry]] = {}
    for field in topic.fields:
        stem = re.sub(r"\s*\[[^\]]*\]$", "", field.name)
        outer, dot, number = stem.rpartition(".")
        if stem in _STAMPS or not is_known(field.unit):
            continue
        value = Value(field.name, "", field.unit)
        if dot and number.isdecimal():
            parts = fields.setdefault(outer, [])
            if isinstance(parts, list) and int(number) == len(parts):
                parts.append(value)
        else:
            fields[stem] = value
    return _Rule(topic.name, "", fields) if fields else None


def _recorded(topic: Topic) -> _Rule | None:
    """Return the rule for a sensor in a recording of ours: its numeric fields as they are. Truth ports are no sensors."""
    if "/truth/" in topic.name or all(field.name != "valid" for field in topic.fields):
        return None
    fields: dict[str, Entry | list[Entry]] = {}
    for field in topic.fields:
        outer, _, name = field.name.partition(".")
        size = re.fullmatch(r"(?:number|integer)\[(\d{1,3})\]", field.type)
        if outer == "value" and size and is_known(field.unit):
            fields[name] = [Value(f"{field.name}.{k}", "", field.unit) for k in range(int(size[1]))]
        elif outer == "value" and field.type in ("number", "integer", "boolean") and is_known(field.unit):
            fields[name] = Value(field.name, "", field.unit)
    return _Rule(topic.name, "", fields)
