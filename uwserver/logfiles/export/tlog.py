"""Writes a log as MAVLink telemetry (.tlog), which ground stations replay. Each track becomes a system with the sensors of its vehicle."""

from __future__ import annotations

import heapq
import importlib
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from uwserver.logfiles.export.left_out import left_out, sample_kind
from uwserver.logfiles.log import Log
from uwserver.logfiles.mapping import Mapping as LogMapping
from uwserver.logfiles.poses import FoundTrack
from uwserver.logfiles.samples import port_samples
from uwserver.logfiles.si import scale_of
from uwserver.units import NANOSECONDS

_MOST_SYSTEMS = 254
_G = scale_of("mG").factor
_E7 = scale_of("degE7").factor
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
    poses = [_track(dialect, systems[name], found) for name, found in tracks.items()]
    ports = _ports(dialect, log, mapping, systems, written)
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


def _track(dialect: Any, system: int, found: FoundTrack) -> Iterator[_Frame]:
    track = found.track
    for k, t_ns in enumerate(track.t_ns.tolist()):
        ms = t_ns // 1_000_000 & 0xFFFFFFFF
        v = [0.0, 0.0, 0.0] if track.v_N is None else track.v_N[k].tolist()
        yield t_ns, system, dialect.MAVLink_attitude_quaternion_message(ms, *track.q_NB[k].tolist(), 0.0, 0.0, 0.0)
        yield t_ns, system, dialect.MAVLink_local_position_ned_message(ms, *track.p_NB[k].tolist(), *v)


def _ports(
    dialect: Any, log: Log, mapping: LogMapping, systems: Mapping[str, int], written: set[str]
) -> Iterator[_Frame]:
    for t_ns, port, value in port_samples(log, mapping):
        message = _message(dialect, t_ns, value)
        if message is not None:
            written.add(port)
            yield t_ns, systems.get(port.partition("/")[0], 1), message


def _message(dialect: Any, t_ns: int, value: Mapping[str, Any]) -> Any:
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
