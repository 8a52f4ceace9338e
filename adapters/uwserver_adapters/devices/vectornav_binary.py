"""VectorNav's binary outputs: 0xFA, groups, their fields, payload, CRC16 (UM001, UM004, chapter "User Configurable Binary Output Messages")."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct

from uwserver.frames import conjugate, matrix, rotate
from uwserver_adapters.devices.codec import deg
from uwserver_adapters.devices.inertial import Readings, Vector
from uwserver_adapters.devices.vectornav_text import GAUSS, TIME_ERROR_S, crc16, ins_status

SYNC = 0xFA
IMU_RATE_HZ = 800
"""By which a divisor gives the rate of an output."""
SEMI_MAJOR_M, ECCENTRICITY_2 = 6_378_137.0, 6.69437999014e-3
"""Of the ellipsoid WGS 84."""
Field = Callable[[Readings], bytes]
_U64, _U16, _U8 = struct.Struct("<Q"), struct.Struct("<H"), struct.Struct("<B")


def _floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


def _startup(r: Readings) -> bytes:
    return _U64.pack(r.t_ns)


def _gps_time(r: Readings) -> bytes:
    return _U64.pack(max(r.gps_ns, 0))  # before 1980 there is no such time


def _tow(r: Readings) -> bytes:
    return _U64.pack(r.gps_tow_ns)


def _week(r: Readings) -> bytes:
    return _U16.pack(r.gps_week & 0xFFFF)


def _utc(r: Readings) -> bytes:
    t = r.utc
    year = max(-128, min(t.year - 2000, 127))  # the byte holds those from 1872 to 2127
    return struct.pack("<bBBBBBH", year, t.month, t.day, t.hour, t.minute, t.second, t.microsecond // 1000)


def _ypr(r: Readings) -> bytes:
    roll, pitch, yaw = map(deg, r.rpy)
    return _floats(yaw, pitch, roll)


def _quaternion(r: Readings) -> bytes:
    w, x, y, z = r.q_NS
    return _floats(x, y, z, w)


def _gyro(r: Readings) -> bytes:
    return _floats(*r.w_S)


def _accel(r: Readings) -> bytes:
    return _floats(*r.f_S)


def _mag(r: Readings) -> bytes:
    return _floats(*(GAUSS * value for value in r.field_S))


def _place(r: Readings) -> bytes:
    return struct.pack("<3d", deg(r.fix.latitude), deg(r.fix.longitude), r.fix.height)


def _velocity(r: Readings) -> bytes:
    return _floats(*r.fix.v_N)


def _body_velocity(r: Readings) -> bytes:
    return _floats(*rotate(conjugate(r.q_NS), r.fix.v_N))


def _temperature(r: Readings) -> bytes:
    return _floats(r.temperature)


def _accel_gyro(r: Readings) -> bytes:
    return _accel(r) + _gyro(r)


def _mag_climate(r: Readings) -> bytes:
    return _mag(r) + _floats(r.temperature, 0.0)


def _status(r: Readings) -> bytes:
    return _U16.pack(ins_status(r))


def _satellites(r: Readings) -> bytes:
    return _U8.pack(r.fix.satellites)


def _fix(r: Readings) -> bytes:
    return _U8.pack(r.fix.kind)


def _place_accuracy(r: Readings) -> bytes:
    return _floats(r.fix.horizontal_accuracy)


def _velocity_accuracy(r: Readings) -> bytes:
    return _floats(r.fix.velocity_accuracy)


def _time_accuracy(r: Readings) -> bytes:
    return _floats(TIME_ERROR_S)


def _accuracies(r: Readings) -> bytes:
    h = r.fix.horizontal_accuracy
    return _floats(h, h, r.fix.vertical_accuracy)


def ecef(latitude: float, longitude: float, height: float) -> Vector:
    """Earth-centred position, m, of a geodetic one of WGS 84 (rad, rad, m)."""
    s, c = math.sin(latitude), math.cos(latitude)
    n = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY_2 * s * s)
    across = (n + height) * c
    return across * math.cos(longitude), across * math.sin(longitude), (n * (1.0 - ECCENTRICITY_2) + height) * s


def _place_ecef(r: Readings) -> bytes:
    fix = r.fix
    return struct.pack("<3d", *(ecef(fix.latitude, fix.longitude, fix.height) if fix.kind else (0.0, 0.0, 0.0)))


def _in_ecef(v: Callable[[Readings], Vector]) -> Field:
    """A vector of N, along the axes of the Earth."""

    def field(r: Readings) -> bytes:
        (north, east, down), lat, lon = v(r), r.fix.latitude, r.fix.longitude
        outward = -north * math.sin(lat) - down * math.cos(lat)
        x, y = outward * math.cos(lon) - east * math.sin(lon), outward * math.sin(lon) + east * math.cos(lon)
        return _floats(x, y, north * math.cos(lat) - down * math.sin(lat))

    return field


def _in_ned(v: Callable[[Readings], Vector]) -> Field:
    return lambda r: _floats(*v(r))


def _accel_ned(r: Readings) -> Vector:
    return rotate(r.q_NS, r.f_S)


def _mag_ned(r: Readings) -> Vector:
    x, y, z = rotate(r.q_NS, r.field_S)
    return GAUSS * x, GAUSS * y, GAUSS * z


def _dcm(r: Readings) -> bytes:
    """From N to the body, column by column."""
    rows = matrix(r.q_NS)
    return _floats(*(value for row in rows for value in row))


_velocity_ecef = _in_ecef(lambda r: r.fix.v_N)


def _zero(form: str) -> Field:
    data = bytes(struct.calcsize(form))
    return lambda _: data


# By group and bit. What no sensor of the world measures is 0 where drivers ask for it with the rest (pressure, edges of a synchronising line);
# other fields are not there, and asking for them is refused.
FIELDS: Sequence[Mapping[int, Field]] = (
    {
        0: _startup, 1: _gps_time, 2: _zero("<Q"), 3: _ypr, 4: _quaternion, 5: _gyro, 6: _place, 7: _velocity, 8: _accel,
        9: _accel_gyro, 10: _mag_climate, 12: _status, 13: _zero("<I"), 14: _zero("<Q"),
    },
    {
        0: _startup, 1: _gps_time, 2: _tow, 3: _week, 4: _zero("<Q"), 5: _zero("<Q"), 6: _utc, 7: _zero("<I"), 8: _zero("<I"),
    },
    {
        0: _zero("<H"), 1: _mag, 2: _accel, 3: _gyro, 4: _temperature, 5: _zero("<f"), 8: _mag, 9: _accel, 10: _gyro,
        11: _zero("<H"),
    },
    {
        0: _utc, 1: _tow, 2: _week, 3: _satellites, 4: _fix, 5: _place, 6: _place_ecef, 7: _velocity, 8: _velocity_ecef,
        9: _accuracies, 10: _velocity_accuracy, 11: _time_accuracy,
    },
    {0: _zero("<H"), 1: _ypr, 2: _quaternion, 3: _dcm, 4: _in_ned(_mag_ned), 5: _in_ned(_accel_ned), 8: _zero("<3f")},
    {
        0: _status, 1: _place, 2: _place_ecef, 3: _body_velocity, 4: _velocity, 5: _velocity_ecef, 6: _in_ecef(_mag_ned),
        7: _in_ecef(_accel_ned), 9: _place_accuracy, 10: _velocity_accuracy,
    },
)  # fmt: skip


class BinaryOutput(Struct, frozen=True):
    """One of the device's three.

    Attributes:
        ports: 0 none, 1 to 3: sent by itself; 0 is sent when it is asked for alone.
        divisor: of `IMU_RATE_HZ`.
        groups: bits.
        fields: of each group that is there, bits.
    """

    ports: int = 0
    divisor: int = 0
    groups: int = 0
    fields: tuple[int, ...] = ()


def fault_of(output: BinaryOutput) -> str:
    """Why the device cannot send it; "" where it can."""
    if output.groups >> len(FIELDS):
        return f"groups {output.groups:02X}: only the first {len(FIELDS)} are there"
    groups = [group for group in range(len(FIELDS)) if output.groups >> group & 1]
    if len(groups) != len(output.fields):
        return f"{len(groups)} groups, but fields of {len(output.fields)}"
    for group, bits in zip(groups, output.fields, strict=True):
        missing = [bit for bit in range(16) if bits >> bit & 1 and bit not in FIELDS[group]]
        if missing:
            return f"field {missing[0]} of group {group + 1} is not simulated"
    return ""


def encode(output: BinaryOutput, readings: Readings) -> bytes:
    """The message."""
    groups = [group for group in range(len(FIELDS)) if output.groups >> group & 1]
    body = _U8.pack(output.groups) + struct.pack(f"<{len(output.fields)}H", *output.fields)
    for group, bits in zip(groups, output.fields, strict=True):
        for bit, field in FIELDS[group].items():
            if bits >> bit & 1:
                body += field(readings)
    return bytes((SYNC,)) + body + crc16(body).to_bytes(2, "big")
