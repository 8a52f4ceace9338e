"""Samples as bodies of Player's messages.

Player's axes are right-handed with z upwards: here they are east, north, up in the world and forward, left, up in the body. Its angles are in rad,
counted from the world's x.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

from uwserver.frames import attitude_enu_flu, frd_from_flu, ned_from_enu, rpy_from_quat
from uwserver.ports import Sample, Value
from uwserver.units import NANOSECONDS, deg
from uwserver_adapters.player import wire

DataMessage = tuple[int, bytes]
"""Subtype and body of a data message."""
DataMaker = Callable[[Sample], DataMessage | None]
"""Makes the message of a sample; None for no message."""

CALIBRATED = 2
"""Subtype of an IMU's data: accelerations, rates, magnetic field."""

_LARGEST_FLOAT = 3.4028234e38
_STANDS = 1e-9
"""Speed below which the course is unknown, m/s."""


def timestamp(ns: int) -> float:
    """Return the time of a message, s."""
    return ns / NANOSECONDS


def is_whole(value: Value) -> bool:
    """Return whether an array has all its numbers."""
    return isinstance(value, tuple) and None not in value


def state(p_N: Any, q_NB: Any, v_B: Any, w_B: Any) -> DataMessage:
    """Return PLAYER_POSITION3D_DATA_STATE: position in the world, velocity in the body."""
    rpy = rpy_from_quat(attitude_enu_flu(q_NB))
    return 1, wire.doubles(*ned_from_enu(p_N), *rpy, *frd_from_flu(v_B), *frd_from_flu(w_B)) + wire.u32(0)


def heading(yaw: float) -> float:
    """Return an angle clockwise from north for one counter-clockwise from east, rad."""
    return (math.pi / 2 - yaw) % (2 * math.pi) if math.isfinite(yaw) else yaw


def imu(force: int, rate: int) -> DataMaker:
    """Return what makes PLAYER_IMU_DATA_CALIB from the fields at these places. The magnetic field is NaN."""

    def tell(sample: Sample) -> DataMessage | None:
        f_S, w_S = sample.value[force], sample.value[rate]
        if not (is_whole(f_S) and is_whole(w_S)):
            return None
        numbers = (*frd_from_flu(f_S), *frd_from_flu(w_S))  # type: ignore[arg-type]  # whole
        return CALIBRATED, wire.floats(*map(_short, numbers), math.nan, math.nan, math.nan)

    return tell


def gps(names: Sequence[str], epoch_ns: int) -> DataMaker:
    """Return what makes PLAYER_GPS_DATA_STATE from a sensor with these fields, without UTM and dilution of precision."""

    def tell(sample: Sample) -> DataMessage:
        of = dict(zip(names, sample.value, strict=True))
        seconds, rest = divmod(epoch_ns + sample.t_ns, NANOSECONDS)
        time = wire.u32(seconds & 0xFFFFFFFF, rest // 1000)
        angles = [of[name] for name in ("latitude", "longitude", "height")]
        numbers = [each for each in angles if isinstance(each, float) and math.isfinite(each)]
        if len(numbers) < 3 or not is_whole(of["v_NS"]):
            return 1, time + struct.pack(">3i4d4I2d", 0, 0, 0, 0, 0, math.nan, math.nan, 0, 0, 0, 0, math.nan, math.nan)
        v: Any = of["v_NS"]
        place = [_int32(deg(numbers[0]) * 1e7), _int32(deg(numbers[1]) * 1e7), _int32(numbers[2] * 1e3)]
        speed = math.hypot(v[0], v[1])
        course = math.atan2(v[1], v[0]) % (2 * math.pi) if speed > _STANDS else 0.0
        errors = [_or_nan(of.get(name)) for name in ("horizontal_accuracy", "vertical_accuracy")]
        satellites = of.get("satellites")
        seen = satellites & 0xFFFF if isinstance(satellites, int) else 0
        return 1, time + struct.pack(">3i4d4I2d", *place, speed, course, math.nan, math.nan, 1, seen, 0, 0, *errors)

    return tell


def ranger(index: int) -> DataMaker:
    """Return what makes PLAYER_RANGER_DATA_RANGE from the field at this place; NaN without an echo."""

    def tell(sample: Sample) -> DataMessage:
        value = sample.value[index]
        return 1, wire.rows([_or_nan(each) for each in (value if isinstance(value, tuple) else (value,))])

    return tell


def _short(number: float) -> float:
    """Return the nearest number that a float of four bytes can hold."""
    return max(-_LARGEST_FLOAT, min(number, _LARGEST_FLOAT)) if math.isfinite(number) else number


def _int32(number: float) -> int:
    """Return the nearest whole number that four bytes can hold."""
    return round(max(-(2.0**31), min(number, 2.0**31 - 1)))


def _or_nan(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
