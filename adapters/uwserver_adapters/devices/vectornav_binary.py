"""VectorNav's binary outputs: 0xFA, groups, fields of each group, payload, CRC16.

Source: UM001 and UM004, chapter "User Configurable Binary Output Messages".
"""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct

from uwserver.adapter.earth import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS
from uwserver.frames import Vec3, conjugate, matrix, rotate
from uwserver_adapters.devices.codec import deg
from uwserver_adapters.devices.inertial import Readings
from uwserver_adapters.devices.vectornav_text import TIME_ERROR_S, crc16, gauss, ins_status, quaternion, ypr_deg

SYNC = 0xFA
IMU_RATE_HZ = 800
"""Rate of the device's IMU; an output has this rate over its divisor."""
Field = Callable[[Readings], bytes]


def ecef(latitude: float, longitude: float, height: float) -> Vec3:
    """Return the Earth-centred position, m, of a geodetic one of WGS 84 (rad, rad, m)."""
    s, c = math.sin(latitude), math.cos(latitude)
    n = SEMI_MAJOR_AXIS / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s * s)
    across = (n + height) * c
    return across * math.cos(longitude), across * math.sin(longitude), (n * (1.0 - ECCENTRICITY_SQUARED) + height) * s


def _place_ecef(r: Readings) -> Vec3:
    fix = r.fix
    return ecef(fix.latitude, fix.longitude, fix.height) if fix.kind else (0.0, 0.0, 0.0)


def _packed(form: str, values: Callable[[Readings], Sequence[float]]) -> Field:
    """Return a field that packs these values in a format of `struct`."""
    packer = struct.Struct(form)
    return lambda r: packer.pack(*values(r))


def _in_ecef(v_N: Callable[[Readings], Vec3]) -> Field:
    """Return a field with a vector of N along the axes of the Earth."""

    def turned(r: Readings) -> Vec3:
        (north, east, down), lat, lon = v_N(r), r.fix.latitude, r.fix.longitude
        outward = -north * math.sin(lat) - down * math.cos(lat)
        x, y = outward * math.cos(lon) - east * math.sin(lon), outward * math.sin(lon) + east * math.cos(lon)
        return x, y, north * math.cos(lat) - down * math.sin(lat)

    return _packed("<3f", turned)


def _zero(form: str) -> Field:
    data = bytes(struct.calcsize(form))
    return lambda _: data


def _utc(r: Readings) -> Sequence[int]:
    t = r.utc
    year = max(-128, min(t.year - 2000, 127))  # all that the field holds
    return year, t.month, t.day, t.hour, t.minute, t.second, t.microsecond // 1000


def _accel_ned(r: Readings) -> Vec3:
    return rotate(r.q_NS, r.f_S)


def _mag_ned(r: Readings) -> Vec3:
    return gauss(rotate(r.q_NS, r.field_S))


_STARTUP = _packed("<Q", lambda r: (r.t_ns,))
_GPS_TIME = _packed("<Q", lambda r: (r.gps_ns,))
_TOW = _packed("<Q", lambda r: (r.gps_tow_ns,))
_WEEK = _packed("<H", lambda r: (r.gps_week & 0xFFFF,))
_UTC = _packed("<bBBBBBH", _utc)
_YPR = _packed("<3f", ypr_deg)
_QUATERNION = _packed("<4f", quaternion)
_GYRO = _packed("<3f", lambda r: r.w_S)
_ACCEL = _packed("<3f", lambda r: r.f_S)
_MAG = _packed("<3f", lambda r: gauss(r.field_S))
_PLACE = _packed("<3d", lambda r: (deg(r.fix.latitude), deg(r.fix.longitude), r.fix.height))
_PLACE_ECEF = _packed("<3d", _place_ecef)
_VELOCITY = _packed("<3f", lambda r: r.fix.v_N)
_VELOCITY_ECEF = _in_ecef(lambda r: r.fix.v_N)
_VELOCITY_ACCURACY = _packed("<f", lambda r: (r.fix.velocity_accuracy,))
_STATUS = _packed("<H", lambda r: (ins_status(r),))
# From N to the body, column by column: those are the rows of the matrix from the body to N.
_ROTATION = _packed("<9f", lambda r: tuple(itertools.chain(*matrix(r.q_NS))))

# By group and bit. Some values that no sensor of the world measures (pressure, edges of a synchronising line) are 0, as drivers ask for them
# together with others. All other fields are missing, and a request for them is refused.
FIELDS: Sequence[Mapping[int, Field]] = (
    {
        0: _STARTUP, 1: _GPS_TIME, 2: _zero("<Q"), 3: _YPR, 4: _QUATERNION, 5: _GYRO, 6: _PLACE, 7: _VELOCITY, 8: _ACCEL,
        9: lambda r: _ACCEL(r) + _GYRO(r), 10: lambda r: _MAG(r) + struct.pack("<2f", r.temperature, 0.0), 12: _STATUS,
        13: _zero("<I"), 14: _zero("<Q"),
    },
    {
        0: _STARTUP, 1: _GPS_TIME, 2: _TOW, 3: _WEEK, 4: _zero("<Q"), 5: _zero("<Q"), 6: _UTC, 7: _zero("<I"), 8: _zero("<I"),
    },
    {
        0: _zero("<H"), 1: _MAG, 2: _ACCEL, 3: _GYRO, 4: _packed("<f", lambda r: (r.temperature,)), 5: _zero("<f"), 8: _MAG,
        9: _ACCEL, 10: _GYRO, 11: _zero("<H"),
    },
    {
        0: _UTC, 1: _TOW, 2: _WEEK, 3: _packed("<B", lambda r: (r.fix.satellites,)), 4: _packed("<B", lambda r: (r.fix.kind,)),
        5: _PLACE, 6: _PLACE_ECEF, 7: _VELOCITY, 8: _VELOCITY_ECEF,
        9: _packed("<3f", lambda r: (r.fix.horizontal_accuracy, r.fix.horizontal_accuracy, r.fix.vertical_accuracy)),
        10: _VELOCITY_ACCURACY, 11: _packed("<f", lambda _: (TIME_ERROR_S,)),
    },
    {
        0: _zero("<H"), 1: _YPR, 2: _QUATERNION, 3: _ROTATION, 4: _packed("<3f", _mag_ned), 5: _packed("<3f", _accel_ned),
        8: _zero("<3f"),
    },
    {
        0: _STATUS, 1: _PLACE, 2: _PLACE_ECEF, 3: _packed("<3f", lambda r: rotate(conjugate(r.q_NS), r.fix.v_N)), 4: _VELOCITY,
        5: _VELOCITY_ECEF, 6: _in_ecef(_mag_ned), 7: _in_ecef(_accel_ned),
        9: _packed("<f", lambda r: (r.fix.horizontal_accuracy,)), 10: _VELOCITY_ACCURACY,
    },
)  # fmt: skip


class BinaryOutput(Struct, frozen=True):
    """One of the device's three binary outputs.

    Attributes:
        ports: 1 to 3 where the device sends it by itself; 0 where it is sent only when a client asks for it.
        divisor: of `IMU_RATE_HZ`.
        groups: a bit for each group.
        fields: for each group that is there, a bit for each field.
    """

    ports: int = 0
    divisor: int = 0
    groups: int = 0
    fields: tuple[int, ...] = ()

    @property
    def numbers(self) -> list[int]:
        """Numbers of the groups that are there, from 0 on."""
        return [group for group in range(len(FIELDS)) if self.groups >> group & 1]


def fault_of(output: BinaryOutput) -> str:
    """Return why the device cannot send an output, or ""."""
    if output.groups >> len(FIELDS):
        return f"groups {output.groups:02X}: only the first {len(FIELDS)} are there"
    if len(output.numbers) != len(output.fields):
        return f"{len(output.numbers)} groups, but fields of {len(output.fields)}"
    for group, bits in zip(output.numbers, output.fields, strict=True):
        missing = [bit for bit in range(16) if bits >> bit & 1 and bit not in FIELDS[group]]
        if missing:
            return f"field {missing[0]} of group {group + 1} is not simulated"
    return ""


def encode(output: BinaryOutput, readings: Readings) -> bytes:
    """Return the message of an output."""
    body = struct.pack(f"<B{len(output.fields)}H", output.groups, *output.fields)
    for group, bits in zip(output.numbers, output.fields, strict=True):
        for bit, field in FIELDS[group].items():
            if bits >> bit & 1:
                body += field(readings)
    return bytes((SYNC,)) + body + crc16(body).to_bytes(2, "big")
