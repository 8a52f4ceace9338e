"""Decides whether a packet that has arrived is understood, and makes the message by which the modem reports it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from uwserver.physics.kernel.random import EVENT
from uwserver.sensors.modem import Modem
from uwserver.sensors.modem_memory import Event, ModemReport
from uwserver.world.modems.packets import Leg, Packet


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
        leg: of the packet, which has ended.
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
