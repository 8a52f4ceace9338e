"""VectorNav's ASCII protocol: ``$VNRRG,08*4B``. Forms of the numbers as the maker's manuals show them (UM001 of the VN-100, UM004 of the VN-200)."""

from __future__ import annotations

import binascii
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from uwserver_adapters.devices.codec import NANOSECONDS, deg
from uwserver_adapters.devices.device import Garbage
from uwserver_adapters.devices.inertial import Readings

LINE_LIMIT = 512
"""Longest line that is read of a peer, bytes."""
GAUSS = 1e4
"""In a tesla."""
NO_CHECKSUM = b"XX"
"""In place of a checksum: it is not looked at."""
BAD_CHECKSUM, UNKNOWN_COMMAND, TOO_FEW, TOO_MANY, BAD_PARAMETER, UNKNOWN_REGISTER, NOT_ALLOWED = 3, 4, 5, 6, 7, 8, 9
"""Numbers of the device's errors."""
TIME_ERROR_S = 2.1e-8
"""What the receiver tells of the error of its clock: as in the manual's example."""
_LINE = re.compile(rb"\$(VN[A-Z]{3}(?:,[^,*$]*)*)\*([0-9A-Fa-f]{4}|[0-9A-Fa-f]{2}|XX)")


@dataclass(frozen=True)
class Command:
    """One message of a peer: ``VNWRG`` and what follows it."""

    verb: str
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class Misread:
    """A line with a wrong checksum: the device tells its sender."""


def checksum(body: bytes) -> int:
    """Exclusive or of all characters between the dollar sign and the asterisk."""
    total = 0
    for byte in body:
        total ^= byte
    return total


def crc16(data: bytes) -> int:
    """CCITT, from 0, as the device has it in both protocols."""
    return binascii.crc_hqx(data, 0)


def line(*parts: str) -> bytes:
    """A whole message of the device."""
    body = ",".join(parts).encode("ascii")
    return b"$%b*%02X\r\n" % (body, checksum(body))


def error(number: int) -> bytes:
    """``VNERR``."""
    return line("VNERR", f"{number:02d}")


def read(text: bytes) -> Command | Misread | Garbage | None:
    """A line without its end; None where it is empty."""
    text = text.strip()
    if not text:
        return None
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


def _ypr(r: Readings) -> str:
    roll, pitch, yaw = map(deg, r.rpy)
    return f"{yaw:+08.3f},{pitch:+08.3f},{roll:+08.3f}"


def _quaternion(r: Readings) -> str:
    w, x, y, z = r.q_NS
    return f"{x:+09.6f},{y:+09.6f},{z:+09.6f},{w:+09.6f}"


def _mag(r: Readings) -> str:
    return ",".join(f"{GAUSS * value:+08.4f}" for value in r.field_S)


def _accel(r: Readings) -> str:
    return ",".join(f"{value:+07.3f}" for value in r.f_S)


def _gyro(r: Readings) -> str:
    return ",".join(f"{value:+010.6f}" for value in r.w_S)


def _climate(r: Readings) -> str:
    return f"{r.temperature:+05.1f},{0.0:+08.3f}"


def _place(r: Readings) -> str:
    fix = r.fix
    north, east, down = fix.v_N
    place = f"{deg(fix.latitude):+012.8f},{deg(fix.longitude):+013.8f},{fix.height:+010.3f}"
    return f"{place},{north:+08.3f},{east:+08.3f},{down:+08.3f}"


def _time(r: Readings) -> str:
    return f"{r.gps_tow_ns / NANOSECONDS:013.6f},{r.gps_week:04d}"


def _gps(r: Readings) -> str:
    fix = r.fix
    h, v, s = fix.horizontal_accuracy, fix.vertical_accuracy, fix.velocity_accuracy
    return f"{_time(r)},{fix.kind},{fix.satellites:02d},{_place(r)},{h:+08.3f},{h:+08.3f},{v:+08.3f},{s:+08.3f},{TIME_ERROR_S:.2E}"


def ins_status(r: Readings) -> int:
    """Tracking while the receiver has a fix: there is no filter that would bridge a dive."""
    return 0x6 if r.fix.kind else 0x0


def _ins(r: Readings) -> str:
    fix = r.fix
    uncertain = f"{0.0:04.1f},{fix.horizontal_accuracy:04.1f},{fix.velocity_accuracy:04.2f}"
    return f"{_time(r)},{ins_status(r):04X},{_ypr(r)},{_place(r)},{uncertain}"


@dataclass(frozen=True)
class Output:
    """A measurement: its asynchronous message, and the register where it is read.

    Attributes:
        header: ``VNYPR``.
        register: number.
        parts: texts of its values, joined by commas.
        needs_gps: whether a device without a receiver lacks it.
    """

    header: str
    register: int
    parts: tuple[Callable[[Readings], str], ...]
    needs_gps: bool = False

    def values(self, readings: Readings) -> str:
        """As the device writes them."""
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
    20: Output("VNGPS", 58, (_gps,), needs_gps=True),
    22: Output("VNINS", 63, (_ins,), needs_gps=True),
}
"""By the number of the asynchronous message (register 6)."""
FREQUENCIES_HZ = (1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200)
"""Of asynchronous messages (register 7)."""
