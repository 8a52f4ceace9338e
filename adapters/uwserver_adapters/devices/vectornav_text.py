"""VectorNav's ASCII protocol: ``$VNRRG,08*4B``. Numbers have the forms of the maker's manuals (UM001 of the VN-100, UM004 of the VN-200)."""

from __future__ import annotations

import binascii
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from uwserver.frames import Quat, Vec3
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
FREQUENCIES_HZ = (1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200)
"""Rates of asynchronous messages that register 7 takes."""
