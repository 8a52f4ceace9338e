"""Smooth profiles of sound speed, and rays by shooting: the ray equations integrated numerically, unfolded at surface and bottom."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from uwserver.environment.acoustics.channel import Channel

Speed = Callable[[Any], tuple[Any, Any]]
"""Sound speed (m/s) and its derivative (1/s) at depths (m), one or many."""


class Shot(NamedTuple):
    """A ray from a to b: time (s), dips (rad), reflections at surface and bottom, and the area of its tube (m2 for 1 m2 at 1 m)."""

    time: float
    dip_a: float
    dip_b: float
    surface: int
    bottom: int
    area: float


def _unfolded(speed: Speed, bottom: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sea mirrored at surface and bottom, again and again, so that reflected rays go straight on."""
    if math.isinf(bottom):
        c, slope = speed(np.abs(z))
        return c, slope * np.sign(z)
    folded = np.mod(z, 2.0 * bottom)
    mirrored = folded > bottom
    c, slope = speed(np.where(mirrored, 2.0 * bottom - folded, folded))
    return c, np.where(mirrored, -slope, slope)


def _fan(speed: Speed, bottom: float, x: float, a: float, angles: np.ndarray, step: float) -> np.ndarray:
    """Unfolded depths of rays at a range, by Runge and Kutta's rule over the range."""

    def motion(z, theta):
        c, slope = _unfolded(speed, bottom, z)
        return np.tan(theta), -slope / c

    n = math.ceil(x / step)
    h, z, theta = x / n, np.full(angles.shape, float(a)), angles.copy()
    for _ in range(n):
        k1 = motion(z, theta)
        k2 = motion(z + 0.5 * h * k1[0], theta + 0.5 * h * k1[1])
        k3 = motion(z + 0.5 * h * k2[0], theta + 0.5 * h * k2[1])
        k4 = motion(z + h * k3[0], theta + h * k3[1])
        z = z + h / 6.0 * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0])
        theta = theta + h / 6.0 * (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1])
    return z


def _single(speed: Speed, bottom: float, x: float, a: float, angle: float) -> tuple[float, float, float]:
    """Unfolded depth, unfolded dip and time of one ray at a range; integrated from boundary to boundary, where the gradient jumps."""
    here, z, theta, time, image = 0.0, float(a), angle, 0.0, 0
    depth = bottom if math.isfinite(bottom) else 1e9

    def motion(_, y):
        c, slope = speed(y[0])
        return [math.tan(y[1]), -slope / c, 1.0 / (c * math.cos(y[1]))]

    def surface(_, y):
        return y[0]

    def floor(_, y):
        return y[0] - depth

    surface.terminal, floor.terminal = True, True
    surface.direction, floor.direction = -1.0, 1.0
    while here < x:
        way = solve_ivp(
            motion, (here, x), [z, theta, time], method="DOP853", rtol=1e-10, atol=1e-10, events=(surface, floor)
        )
        here = float(way.t[-1])
        z, theta, time = way.y[:, -1]
        if way.status == 1:
            up = len(way.t_events[0]) > 0
            z, theta = (0.0 if up else depth), -theta
            image += 1 if (image % 2 == 0) != up else -1
            if not (up or len(way.t_events[1])):
                raise AssertionError("an event that is none")
    flipped = image % 2 != 0
    cells = image // 2 if not flipped else (image + 1) // 2
    return (2.0 * depth * cells + (-z if flipped else z)), (-theta if flipped else theta), time


def shoot(
    speed: Speed, bottom: float, x: float, a: float, b: float, order: int, widest: float, rays: int, step: float
) -> list[Shot]:
    """All rays up to an order of reflections and to an angle (rad), the earliest first.

    Args:
        rays: of the fan.
        step: of its coarse integration, m.
    """
    angles = np.linspace(-widest, widest, rays)
    z = _fan(speed, bottom, x, a, angles, step)
    found = []
    for cell in range(-2, 3) if math.isfinite(bottom) else (0,):
        for sign in (1, -1):
            goal = 2.0 * (bottom if math.isfinite(bottom) else 0.0) * cell + sign * b
            crossed, bounced = _reflections(goal, bottom)
            if crossed + bounced > order:
                continue
            for k in np.nonzero((z[:-1] - goal) * (z[1:] - goal) < 0.0)[0]:
                shot = _refine(speed, bottom, x, a, goal, angles[k], angles[k + 1], crossed, bounced)
                found += [shot] if shot else []
    found.sort()
    return [shot for k, shot in enumerate(found) if not k or abs(shot.dip_a - found[k - 1].dip_a) > 1e-9]


def _refine(speed, bottom, x, a, goal, low, high, surface, floor) -> Shot | None:
    def miss(angle):
        return _single(speed, bottom, x, a, angle)[0] - goal

    # The coarse fan steps across the boundaries, where the gradient jumps: its crossing lies a little aside.
    width = high - low
    for _ in range(12):
        if miss(low) * miss(high) <= 0.0:
            break
        low, high = low - width, high + width
    if miss(low) * miss(high) > 0.0:
        return None
    angle = brentq(miss, low, high, xtol=1e-11)
    if abs(miss(angle)) > 1e-3:  # where rays begin to reach a boundary the fan is torn
        return None
    _, theta, time = _single(speed, bottom, x, a, angle)
    small = 1e-6
    dz = (miss(angle + small) - miss(angle - small)) / (2.0 * small)
    flipped = (surface + floor) % 2 == 1
    (c_a, _), (c_b, _) = speed(a), speed(_fold(goal, bottom))
    area = x * abs(dz) * math.cos(theta) / math.cos(angle) * c_a / c_b
    return Shot(time, angle, -theta if flipped else theta, surface, floor, area)


def _fold(z: float, bottom: float) -> float:
    if math.isinf(bottom):
        return abs(z)
    folded = z % (2.0 * bottom)
    return min(folded, 2.0 * bottom - folded)


def _reflections(goal: float, bottom: float) -> tuple[int, int]:
    """How often surface and bottom lie between the sea and an image of it."""
    if math.isinf(bottom):
        return (1, 0) if goal < 0.0 else (0, 0)
    cell = math.floor(goal / bottom)
    count = abs(cell)
    return (count // 2, (count + 1) // 2) if cell > 0 else ((count + 1) // 2, count // 2)


def still(z):
    return 1500.0 + 0.0 * z, 0.0 * z


def munk(z):
    """W. H. Munk, J. Acoust. Soc. Am. 55 (1974) 220, with its axis at 1300 m."""
    eta = 2.0 * (z - 1300.0) / 1300.0
    return 1500.0 * (1.0 + 0.00737 * (eta - 1.0 + np.exp(-eta))), 1500.0 * 0.00737 * (1.0 - np.exp(-eta)) * 2.0 / 1300.0


def duct(z):
    u = (z - 60.0) / 20.0
    return 1500.0 - 20.0 / np.cosh(u) ** 2, 2.0 * np.tanh(u) / np.cosh(u) ** 2


def thermocline(z):
    u = (z - 40.0) / 10.0
    return 1500.0 - 20.0 * np.tanh(u) + 0.016 * z, 0.016 - 2.0 / np.cosh(u) ** 2


def channel(speed, deepest, spacing, frequency=26e3) -> Channel:
    z = np.arange(0.0, deepest + 0.5 * spacing, spacing)
    return Channel(z, speed(z)[0], frequency)
