"""ArduPilot's JSON simulator interface: servo packets in, lines out. Sans-IO. docs/how-to/ardusub.md names the source of each rule."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Literal, NamedTuple

from uwserver.frames import Quat, Vec3

MAGIC_16, MAGIC_32 = 18458, 29569
_FORMS = {MAGIC_16: struct.Struct("<HHI16H"), MAGIC_32: struct.Struct("<HHI32H")}
_MAGIC = struct.Struct("<H")

RANGEFINDERS = 6
"""Distances that a line can hold."""

Bad = Literal["bad_magic", "bad_length"]


class Frame(NamedTuple):
    """A servo packet.

    Attributes:
        rate_hz: physics rate that the autopilot requests, which may differ in each frame.
        number: frames answered since the autopilot started.
        pwm: pulse widths of outputs 1 to 16 or 32, us; 0 for an output that is not driven.
    """

    rate_hz: int
    number: int
    pwm: tuple[int, ...]


def parse(data: bytes) -> Frame | Bad:
    """Return the frame in a datagram, or what is wrong with it."""
    if len(data) < _MAGIC.size:
        return "bad_length"
    form = _FORMS.get(_MAGIC.unpack_from(data)[0])
    if form is None:
        return "bad_magic"
    if len(data) != form.size:
        return "bad_length"
    _, rate_hz, number, *pwm = form.unpack(data)
    return Frame(rate_hz, number, tuple(pwm))


# The autopilot looks for the first occurrence of a key's name, so no name may be part of an earlier one. It allows no blank after a colon.
_LINE = (
    '\n{"timestamp":%.9f,"imu":{"gyro":[%.9g,%.9g,%.9g],"accel_body":[%.9g,%.9g,%.9g]},"position":[%.9g,%.9g,%.9g],'
    '"quaternion":[%.9g,%.9g,%.9g,%.9g],"velocity":[%.9g,%.9g,%.9g]%s}\n'
)
_DISTANCES = tuple(f',"rng_{n}":%.6g' for n in range(1, RANGEFINDERS + 1))
_BATTERY = ',"battery":{"voltage":%.6g,"current":%.6g}'


def extras(distances: Sequence[float], battery: tuple[float, float] | None, no_time_sync: bool) -> str:
    """Return the optional rest of a line: distances of rangefinders (m), voltage and current (V, A), and who sets the pace."""
    text = "".join(form % distance for form, distance in zip(_DISTANCES, distances, strict=False))
    if battery is not None:
        text += _BATTERY % battery
    return text + ',"no_time_sync":1' if no_time_sync else text


def line(t_ns: int, w_B: Vec3, f_B: Vec3, p_NB: Vec3, q_NB: Quat, v_NB_N: Vec3, rest: str) -> bytes:
    """Return a line of state: time, angular rate (rad/s), specific force (m/s2), position (m), attitude, velocity (m/s). All are finite."""
    return (_LINE % (t_ns * 1e-9, *w_B, *f_B, *p_NB, *q_NB, *v_NB_N, rest)).encode()
