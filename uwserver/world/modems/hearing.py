"""What a modem hears: whether a solid hides a signal, how its level fades, whether a packet that has arrived is understood, and the message
by which the modem reports it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from uwserver.frames import Vec3
from uwserver.modifiers.base import Draws
from uwserver.physics.kernel.random import EVENT, key_of
from uwserver.physics.rays.raycast import Geometry
from uwserver.sensors.modem import Event, Modem, ModemReport
from uwserver.world.modems.packets import Leg, Packet


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


def drawn(modem: Modem, number: int) -> tuple[float, float, float, float, float]:
    """Return the random numbers of a modem for a packet: a uniform one (0 to 1) that decides whether it is understood, and normal ones for
    time, direction (two) and speed."""
    draws = modem.draws
    draws.seek(number, EVENT)
    luck = float(draws.rng.random())
    time, across, up, speed = draws.rng.standard_normal(4).tolist()
    return luck, time, across, up, speed


def why_lost(leg: Leg, modem: Modem, packet: Packet, there: Sequence[Leg], own: Iterable[Packet]) -> str:
    """Return why a packet is not understood, as a name of `Counts`; "" if it is understood.

    Args:
        leg: leg of the packet, which has ended.
        modem: the receiver.
        packet: the packet.
        there: all legs that are or were heard at the receiver lately, this one included.
        own: packets that the modem has sent itself.
    """
    if not modem.notices(leg.signal / leg.noise):
        return "faint"
    if any(leg.meets(each.left, each.over) for each in own):
        return "deaf"
    if abs(leg.speed) > modem.fastest:
        return "doppler"
    crowd = math.fsum(each.signal for each in there if each.packet != leg.packet and leg.meets(each.begin, each.over))
    luck, size = drawn(modem, packet.number)[0], max(len(packet.data), modem.table.fixed_bytes)

    def passes(disturbance: float) -> bool:
        return luck >= modem.error_rate(leg.signal / disturbance, size)

    if passes(leg.noise + leg.late + crowd):
        return ""
    if passes(leg.noise + leg.late):
        return "collided"
    return "smeared" if passes(leg.noise) else "faint"


def report_of(event: Event, leg: Leg, modem: Modem, packet: Packet) -> ModemReport:
    """Return the report of a packet."""
    snr, sigma = leg.signal / leg.noise, modem.speed_sigma
    speed = None
    if sigma is not None:
        speed = leg.speed if modem.table.ideal else leg.speed + sigma * drawn(modem, packet.number)[4]
    return ModemReport(
        event, packet.source, packet.destination, packet.data, leg.begin, leg.over, leg.level,
        10.0 * math.log10(snr) if snr > 0.0 else None, None, leg.bearing, leg.elevation, speed,
    )  # fmt: skip
