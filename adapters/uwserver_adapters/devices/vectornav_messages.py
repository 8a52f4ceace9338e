"""VectorNav's messages: the ASCII protocol (``$VNRRG,08*4B``) and binary outputs (0xFA, groups, fields of each group, payload, CRC16).

Numbers have the forms of the maker's manuals (UM001 of the VN-100, UM004 of the VN-200; of binary outputs the chapter "User Configurable Binary
Output Messages").
"""

from __future__ import annotations

import binascii
import itertools
import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from msgspec import Struct

from uwserver.adapter.earth import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS
from uwserver.frames import Quat, Vec3, conjugate, matrix, rotate
from uwserver_adapters.devices.codec import NANOSECONDS, checksum, deg, sentence
from uwserver_adapters.devices.device import Garbage
from uwserver_adapters.devices.inertial import Readings

LINE_LIMIT = 512
"""Longest line of a peer, bytes."""
GAUSS = 1e4
"""Gauss in a tesla."""
NO_CHECKSUM = b"XX"
"""Stands in place of a checksum that the device shall not check."""
BAD_CHECKSUM, UNKNOWN_COMMAND, TOO_FEW, TOO_MANY, BAD_PARAMETER, UNKNOWN_REGISTER, NOT_ALLOWED = 3, 4, 5, 6, 7, 8, 9
"""Error numbers of the device."""
TIME_ERROR_S = 2.1e-8
"""Error of the receiver's clock that the device tells, s, as in the manual's example."""
_LINE = re.compile(rb"\$(VN[A-Z]{3}(?:,[^,*$]*)*)\*([0-9A-Fa-f]{4}|[0-9A-Fa-f]{2}|XX)")
FREQUENCIES_HZ = (1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200)
"""Rates of asynchronous messages that register 7 takes."""
SYNC = 0xFA
IMU_RATE_HZ = 800
"""Rate of the device's IMU; an output has this rate over its divisor."""


@dataclass(frozen=True)
class Command:
    """One message of a peer: a word such as ``VNWRG``, and the values behind it."""

    verb: str
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class Misread:
    """A line with a wrong checksum, of which the device tells its sender."""


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT that begins with 0, as both protocols of the device have it."""
    return binascii.crc_hqx(data, 0)


def line(word: str, *values: str) -> bytes:
    """Return a whole message of the device."""
    return sentence(word, values)


def error(number: int) -> bytes:
    """Return the message ``VNERR``."""
    return line("VNERR", f"{number:02d}")


def read(text: bytes) -> Command | Misread | Garbage:
    """Parse a line without its end."""
    found = _LINE.fullmatch(text)
    if found is None:
        return Garbage("a line is no message of the VectorNav protocol")
    body, sum_ = found[1], found[2]
    if sum_ != NO_CHECKSUM and int(sum_, 16) != (checksum(body) if len(sum_) == 2 else crc16(body)):
        return Misread()
    try:
        verb, *values = body.decode("ascii").split(",")
    except UnicodeDecodeError:
        return Garbage("a message of the VectorNav protocol holds bytes that are no ASCII")
    return Command(verb, tuple(values))


# -- measurements ---------------------------------------------------------------------------------------------------------------------


def ypr_deg(r: Readings) -> Vec3:
    """Return yaw, pitch and roll, degrees."""
    roll, pitch, yaw = map(deg, r.rpy)
    return yaw, pitch, roll


def quaternion(r: Readings) -> Quat:
    """Return the attitude as x y z w."""
    w, x, y, z = r.q_NS
    return x, y, z, w


def gauss(field_T: Vec3) -> Vec3:
    """Return a magnetic flux density (T) in gauss."""
    x, y, z = field_T
    return GAUSS * x, GAUSS * y, GAUSS * z


def ins_status(r: Readings) -> int:
    """Return the INS status. It is "tracking" while the receiver has a fix: no filter bridges a dive."""
    return 0x6 if r.fix.kind else 0x0


Part = Callable[[Readings], str]
"""Writes some values of a measurement, joined by commas."""


def _numbers(form: str, values: Callable[[Readings], Sequence[float]]) -> Part:
    """Return a part that writes all these values in one form."""
    return lambda r: ",".join(format(value, form) for value in values(r))


_ypr = _numbers("+08.3f", ypr_deg)
_quaternion = _numbers("+09.6f", quaternion)
_mag = _numbers("+08.4f", lambda r: gauss(r.field_S))
_accel = _numbers("+07.3f", lambda r: r.f_S)
_gyro = _numbers("+010.6f", lambda r: r.w_S)
_velocity = _numbers("+08.3f", lambda r: r.fix.v_N)


def _climate(r: Readings) -> str:
    return f"{r.temperature:+05.1f},{0.0:+08.3f}"


def _place(r: Readings) -> str:
    fix = r.fix
    return f"{deg(fix.latitude):+012.8f},{deg(fix.longitude):+013.8f},{fix.height:+010.3f}"


def _time(r: Readings) -> str:
    return f"{r.gps_tow_ns / NANOSECONDS:013.6f},{r.gps_week:04d}"


def _receiver(r: Readings) -> str:
    return f"{r.fix.kind},{r.fix.satellites:02d}"


def _accuracies(r: Readings) -> str:
    h, v, s = r.fix.horizontal_accuracy, r.fix.vertical_accuracy, r.fix.velocity_accuracy
    return f"{h:+08.3f},{h:+08.3f},{v:+08.3f},{s:+08.3f},{TIME_ERROR_S:.2E}"


def _ins_status(r: Readings) -> str:
    return f"{ins_status(r):04X}"


def _ins_uncertainty(r: Readings) -> str:
    return f"{0.0:04.1f},{r.fix.horizontal_accuracy:04.1f},{r.fix.velocity_accuracy:04.2f}"


@dataclass(frozen=True)
class Output:
    """A measurement: its asynchronous message, and the register where it is read.

    Attributes:
        header: first word of the message, such as ``VNYPR``.
        register: number of the register.
        parts: write the values, in this order.
        needs_gps: a device without a satellite receiver lacks it.
    """

    header: str
    register: int
    parts: tuple[Part, ...]
    needs_gps: bool = False

    def values(self, readings: Readings) -> str:
        """Return the values as the device writes them."""
        return ",".join(part(readings) for part in self.parts)


OUTPUTS: Mapping[int, Output] = {
    1: Output("VNYPR", 8, (_ypr,)),
    2: Output("VNQTN", 9, (_quaternion,)),
    8: Output("VNQMR", 15, (_quaternion, _mag, _accel, _gyro)),
    10: Output("VNMAG", 17, (_mag,)),
    11: Output("VNACC", 18, (_accel,)),
    12: Output("VNGYR", 19, (_gyro,)),
    13: Output("VNMAR", 20, (_mag, _accel, _gyro)),
    14: Output("VNYMR", 27, (_ypr, _mag, _accel, _gyro)),
    19: Output("VNIMU", 54, (_mag, _accel, _gyro, _climate)),
    20: Output("VNGPS", 58, (_time, _receiver, _place, _velocity, _accuracies), needs_gps=True),
    22: Output("VNINS", 63, (_time, _ins_status, _ypr, _place, _velocity, _ins_uncertainty), needs_gps=True),
}
"""Number of an asynchronous message (register 6) -> the measurement."""


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
