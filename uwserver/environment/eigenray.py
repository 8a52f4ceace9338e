"""The way of sound between two points of a layered sea: travel time and angles by Snell's law, in closed form layer by layer."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import FloatArray

_TOLERANCE = 1e-9
"""m of horizontal distance."""
_LEAST_GRADIENT = 1e-9
"""1/s; below it sound goes straight."""
_STEEPEST = 1e7
"""Horizontal over vertical distance (as in water of one sound speed) beyond which no ray is looked for."""


class Path(NamedTuple):
    """A ray from a to b.

    Attributes:
        time: of travel, s.
        dip_a, dip_b: angle of the ray below the horizontal at its ends, in the direction of travel, rad.
    """

    time: float
    dip_a: float
    dip_b: float


def eigenray(depth: FloatArray, speed: FloatArray, horizontal: float, a: float, b: float) -> Path:
    """The ray that leads from depth a to depth b without turning, between a profile's points as circle arcs.

    Where none does (both nearly as deep, far apart), the arc in water whose sound speed changes linearly from a to b, which may turn.

    Args:
        depth, speed: (n) of the profile, m ascending and m/s; linear between its points and constant beyond.
        horizontal: distance, m.
        a, b: depths, m.
    """
    if horizontal < _TOLERANCE or a == b:
        return _arc(depth, speed, horizontal, a, b)
    z, c = _between(depth, speed, a, b)
    thickness, upper, lower, fastest = np.diff(z), c[:-1], c[1:], float(c.max())

    def reach(w: float) -> float:
        s1, s2 = _sines(w, upper, fastest), _sines(w, lower, fastest)
        p = w / (fastest * math.hypot(1.0, w))
        return float(p * ((upper + lower) * thickness / (s1 + s2)).sum())

    w = _solve(reach, horizontal, horizontal / abs(b - a))
    if w is None:
        return _arc(depth, speed, horizontal, a, b)
    s1, s2 = _sines(w, upper, fastest), _sines(w, lower, fastest)
    p = w / (fastest * math.hypot(1.0, w))
    bend = p * p * (upper + lower) / ((s1 + s2) * (1.0 + s2))
    slowness = _log_ratio((lower - upper) / upper) / upper + _log_ratio(bend * (lower - upper)) * bend
    time = float((thickness * slowness).sum())
    dips = (math.acos(min(1.0, p * float(np.interp(end, depth, speed)))) for end in (a, b))
    down = 1.0 if b > a else -1.0
    return Path(time, *(down * dip for dip in dips))


def straight(depth: FloatArray, speed: FloatArray, horizontal: float, a: float, b: float) -> Path:
    """The straight line between two points, at the mean slowness of the depths between them. Arguments as `eigenray`."""
    z, c = _between(depth, speed, a, b)
    length, dip = math.hypot(horizontal, b - a), math.atan2(b - a, horizontal)
    if a == b:
        return Path(length / float(c[0]), dip, dip)
    slowness = float((np.diff(z) * _log_ratio((c[1:] - c[:-1]) / c[:-1]) / c[:-1]).sum()) / float(z[-1] - z[0])
    return Path(length * slowness, dip, dip)


def _between(depth: FloatArray, speed: FloatArray, a: float, b: float) -> tuple[FloatArray, FloatArray]:
    """Depths and sound speeds of a profile from one depth to another, ascending, both ends included."""
    low, high = min(a, b), max(a, b)
    first, last = np.searchsorted(depth, low, "right"), np.searchsorted(depth, high, "left")
    ends = np.interp((low, high), depth, speed)
    z = np.concatenate(((low,), depth[first:last], (high,)))
    return z, np.concatenate((ends[:1], speed[first:last], ends[1:]))


def _sines(w: float, c: FloatArray, fastest: float) -> FloatArray:
    """(n) sine of the ray's angle to the horizontal where the sound speed is c; w is its cotangent where it is fastest."""
    ratio = c / fastest
    # 1 - w^2 ratio^2 / (1 + w^2), without the difference of two nearly equal numbers
    square: FloatArray = (1.0 + w * w * ((1.0 - ratio) * (1.0 + ratio))) / (1.0 + w * w)
    return np.sqrt(square)


def _log_ratio(u: FloatArray) -> FloatArray:
    """log(1 + u) / u, 1 at 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        result: FloatArray = np.where(np.abs(u) < 1e-12, 1.0 - 0.5 * u, np.log1p(u) / u)
    return result


def _solve(reach: Callable[[float], float], wanted: float, first: float) -> float | None:
    """The w with reach(w) = wanted, as reach grows with w; None when it does not get there."""
    low, high = 0.0, first
    at_low, at_high = -wanted, reach(first) - wanted
    while at_high < 0.0:
        low, at_low = high, at_high
        high *= 2.0
        if high > _STEEPEST:
            return None
        at_high = reach(high) - wanted
    for _ in range(100):  # false position, of which half of the weight of an end that stays is taken (Illinois)
        w = (low * at_high - high * at_low) / (at_high - at_low)
        at = reach(w) - wanted
        if abs(at) < _TOLERANCE:
            return float(w)
        if at < 0.0:
            low, at_low, at_high = w, at, 0.5 * at_high
        else:
            high, at_high, at_low = w, at, 0.5 * at_low
    return float(w)


def _arc(depth: FloatArray, speed: FloatArray, horizontal: float, a: float, b: float) -> Path:
    """In water whose sound speed changes linearly; closed form: t = acosh(1 + g^2 d^2 / (2 c_a c_b)) / |g|."""
    c_a, c_b = (float(np.interp(end, depth, speed)) for end in (a, b))
    if abs(b - a) > 1e-3:
        gradient = (c_b - c_a) / (b - a)
    else:
        gradient = float(np.interp(a + 0.5, depth, speed) - np.interp(a - 0.5, depth, speed))
    if abs(gradient) < _LEAST_GRADIENT or horizontal < _TOLERANCE:
        return straight(depth, speed, horizontal, a, b)
    square = horizontal * horizontal + (b - a) * (b - a)
    time = math.asinh(abs(gradient) * math.sqrt(square / (c_a * c_b)) / 2.0) * 2.0 / abs(gradient)
    # The arc's centre lies where the sound speed would be zero.
    z_a, z_b = c_a / gradient, c_a / gradient + (b - a)
    x = (horizontal * horizontal + z_b * z_b - z_a * z_a) / (2.0 * horizontal)
    sign = math.copysign(1.0, gradient)
    return Path(time, math.atan2(sign * x, sign * z_a), math.atan2(sign * (x - horizontal), sign * z_b))
