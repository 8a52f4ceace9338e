"""A log as MAVLink telemetry: a system a track, and the sensors of its vehicle, as ground stations replay it."""

from __future__ import annotations

import heapq
import importlib
import math
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from uwserver.logfiles.export.left_out import left_out
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
"""Time (ns), system, message."""


def write_tlog(log: Log, mapping: LogMapping, tracks: dict[str, FoundTrack], file: Path) -> list[str]:
    """Write it: ATTITUDE_QUATERNION and LOCAL_POSITION_NED of tracks; SCALED_PRESSURE2, SCALED_IMU2, GPS_RAW_INT, DISTANCE_SENSOR of ports.

    Stamps are UTC; of a log that does not know it, ns since its start.

    Returns:
        Sentences about ports that gave no message.

    Raises:
        LogError: the log is damaged.
        OSError: the file is there already, or cannot be written.
    """
    dialect: Any = importlib.import_module("pymavlink.dialects.v20.ardupilotmega")
    systems = {name: 1 + k % _MOST_SYSTEMS for k, name in enumerate(tracks)}
    links = {system: dialect.MAVLink(None, srcSystem=system, srcComponent=1) for system in {1, *systems.values()}}
    written: set[str] = set()
    ways = [_track(dialect, systems[name], found) for name, found in tracks.items()]
    ports = _ports(dialect, log, mapping, systems, written)
    beats = _beats(dialect, log, sorted(links))
    epoch = log.epoch_ns or 0
    with file.open("xb") as out:
        for t_ns, system, message in heapq.merge(beats, *ways, ports, key=lambda frame: frame[0]):
            link = links[system]
            out.write(struct.pack(">Q", (epoch + t_ns) // 1000) + message.pack(link))
            link.seq = (link.seq + 1) % 256
    return left_out(mapping, written)


def _beats(dialect: Any, log: Log, systems: list[int]) -> Iterator[_Frame]:
    """A heartbeat a second: without it no ground station takes a system for one."""
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
    """The message of a sample, told by its fields; None where there is none."""
    ms = t_ns // 1_000_000 & 0xFFFFFFFF
    pressure, heat = _real(value, "pressure"), _real(value, "temperature")
    if pressure is not None:
        celsius = 0 if heat is None else _whole(heat * 100, 16)
        return dialect.MAVLink_scaled_pressure2_message(ms, pressure / 100.0, 0.0, celsius)
    latitude, longitude = _real(value, "latitude"), _real(value, "longitude")
    if latitude is not None and longitude is not None:
        height = _whole((_real(value, "height") or 0.0) * 1000, 32)
        fix, satellites = int(_real(value, "fix") or 0), int(_real(value, "satellites") or 0)
        place = _whole(latitude / _E7, 32), _whole(longitude / _E7, 32)
        unknown = 65535
        return dialect.MAVLink_gps_raw_int_message(
            t_ns // 1000,
            min(max(fix, 0), 8),
            *place,
            height,
            unknown,
            unknown,
            unknown,
            unknown,
            min(max(satellites, 0), 255),
        )
    force, turn = value.get("f_S"), value.get("w_S")
    if (
        isinstance(force, tuple)
        and isinstance(turn, tuple)
        and len(force) == len(turn) == 3
        and None not in (*force, *turn)
    ):
        rates = [_whole(w * 1000, 16) for w in turn]
        return dialect.MAVLink_scaled_imu2_message(ms, *(_whole(f / _G, 16) for f in force), *rates, 0, 0, 0)
    distance = _real(value, "range")
    if distance is not None and "head_angle" not in value:
        downwards = 25
        centimetres = min(max(round(distance * 100), 0), 65535)
        return dialect.MAVLink_distance_sensor_message(ms, 0, 65535, centimetres, 2, 0, downwards, 255)
    return None


def _real(value: Mapping[str, Any], name: str) -> float | None:
    number = value.get(name)
    return float(number) if isinstance(number, int | float) and math.isfinite(number) else None


def _whole(number: float, bits: int) -> int:
    """A signed integer, held at its limits."""
    most = (1 << (bits - 1)) - 1
    return round(min(max(number, -most - 1), most))
