"""Effects on a signal between two modems besides those on its rays: a solid hides it, and its level fades."""

from __future__ import annotations

import math

import numpy as np

from uwserver.frames import Vec3
from uwserver.modifiers.base import Draws
from uwserver.physics.kernel.random import EVENT, key_of
from uwserver.physics.rays.raycast import Geometry
from uwserver.sensors.modem import Modem


def is_hidden(geometry: Geometry, modem: Modem, a: Vec3, b: Vec3) -> bool:
    """Return whether a solid between two points (N, m), not near their ends, is so wide that the signal does not get round it."""
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
    """The fading of levels between modems. A state need not keep it."""

    def __init__(self, seed: int, path: str) -> None:
        """Take the seed of the world and the path of the medium, for the random numbers."""
        self._seed, self._path = seed, path
        self._pairs: dict[tuple[str, str], Draws] = {}

    def between(self, sender: str, receiver: str, modem: Modem, t: float) -> float:
        """Return the fading of the level between two modems at a time, dB. It is the same in both directions. Random numbers are drawn at
        fixed instants, and interpolated by straight lines whose weights keep the deviation the same everywhere.

        Args:
            sender, receiver: ports at which the modems report what they hear.
            modem: the receiver.
            t: time at which the signal was sent, s.
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
