"""What happens to a signal between two modems besides what its rays do: something solid hides it, and its level fades."""

from __future__ import annotations

import math

import numpy as np

from uwserver.frames import Vec3
from uwserver.modifiers.base import Draws
from uwserver.physics.kernel.random import EVENT, key_of
from uwserver.physics.rays.raycast import Geometry
from uwserver.sensors.modem import Modem


def is_hidden(geometry: Geometry, modem: Modem, a: Vec3, b: Vec3) -> bool:
    """Whether something solid, not near their ends, stands between two points (N, m) that is too wide for the signal to get round it."""
    clear, distance = modem.table.clearance_m, math.dist(a, b)
    free = distance - 2.0 * clear
    if free <= 0.0:
        return False
    way = (np.array(b) - a) / distance
    across = np.cross(way, np.eye(3)[int(np.argmin(np.abs(way)))])
    across /= np.linalg.norm(across)
    up = np.cross(way, across)
    aside = modem.blur(distance) * np.array((0.0 * up, across, -across, up, -up))
    begin = np.array(a) + clear * way + aside
    found = geometry.raycast(begin, np.tile(way, (len(begin), 1)), free)
    return bool((found.distance <= free).all())


class Fading:
    """Of the levels between modems; it remembers nothing that a run depends on."""

    def __init__(self, seed: int, path: str) -> None:
        """seed, path: of the world and of the medium, for its random numbers."""
        self._seed, self._path = seed, path
        self._pairs: dict[tuple[str, str], Draws] = {}

    def between(self, sender: str, receiver: str, modem: Modem, t: float) -> float:
        """Of the level between two modems at a time (s), dB, the same both ways: random numbers at the beats of its time, and straight lines
        between, so weighted that their deviation is the same everywhere.

        Args:
            sender, receiver: ports where they tell what they hear.
            modem: that receives.
            t: when the signal left, s.
        """
        sigma, time = modem.fading
        if not sigma or modem.table.ideal:
            return 0.0
        pair = (min(sender, receiver), max(sender, receiver))
        if pair not in self._pairs:
            self._pairs[pair] = Draws(key_of(self._seed, f"{self._path}/{pair[0]} {pair[1]}"))
        draws, beat = self._pairs[pair], t / time
        ends = []
        for k in (math.floor(beat), math.floor(beat) + 1):
            draws.seek(k, EVENT)
            ends.append(float(draws.rng.standard_normal()))
        part = beat - math.floor(beat)
        return sigma * ((1.0 - part) * ends[0] + part * ends[1]) / math.hypot(1.0 - part, part)
