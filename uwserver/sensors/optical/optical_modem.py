"""Optical modem: packets of light in a cone, over a few tens of metres in clear water."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated

from msgspec import Meta

from uwserver.environment.light import WATER_TYPES, WAVELENGTHS_NM
from uwserver.frames import Quat, Vec3, rotate
from uwserver.sensors.base import Pose, Scope
from uwserver.sensors.modem import Crossing, Modem, ModemTable, Signal
from uwserver.units import rad

_SPEED = 2.998e8 / 1.34
"""Speed of light in water, m/s."""
_Q_AT_SENSITIVITY = 3.0902
"""Argument at which the tail of the normal distribution is 1e-3."""


class OpticalModemConfig(ModemTable, tag="optical_modem", kw_only=True, frozen=True):
    """A modem that shines and sees along the x axis of its mount.

    Attributes:
        wavelength_nm: wavelength of the light.
        power_w: optical power within the cone.
        beam_width_deg: full angle of the cone, which is evenly lit.
        aperture_m2: area of the receiver.
        view_width_deg: full angle that the receiver sees.
        sensitivity_w: received power at which one bit in a thousand is wrong.
    """

    message = "OpticalPacket"
    wavelength_nm: Annotated[float, Meta(ge=400, le=700)] = 470.0
    power_w: Annotated[float, Meta(ge=1e-9, le=1e6)] = 1.0
    beam_width_deg: Annotated[float, Meta(gt=0, le=170)] = 60.0
    aperture_m2: Annotated[float, Meta(ge=1e-9, le=10)] = 1e-3
    view_width_deg: Annotated[float, Meta(gt=0, le=170)] = 60.0
    sensitivity_w: Annotated[float, Meta(ge=1e-18, le=1e3)] = 1e-8

    def build(self, mount: Pose) -> OpticalModem:
        return OpticalModem(mount, self)


class OpticalModem(Modem):
    """Powers of signals are electrical powers of the receiver over its noise. They go with the square of the optical power."""

    speed = _SPEED
    fading = (0.0, 1.0)

    def __init__(self, mount: Pose, config: OpticalModemConfig) -> None:
        self._config = config
        self._cone, self._view = (math.cos(0.5 * rad(w)) for w in (config.beam_width_deg, config.view_width_deg))
        super().__init__(mount, config)

    def signal(self, q_NS: Quat) -> Signal:
        """See `Modem`. `bandwidth` is the cosine of half the cone's angle."""
        c = self._config
        level = 10.0 * math.log10(c.power_w) + self.settings.gain
        return Signal(c.protocol, 2.998e17 / c.wavelength_nm, self._cone, level, rotate(q_NS, (1.0, 0.0, 0.0)))

    def overlap(self, signal: Signal) -> float:
        """See `Modem`. It receives light of any colour, and no sound."""
        return 1.0 if signal.frequency > 1e9 else 0.0

    def crossing(self, scope: Scope, signal: Signal, a: Vec3, b: Vec3, q_NS: Quat, gain: float) -> Crossing | None:
        """See `Modem`. Nothing arrives outside the cone of the sender or outside the view of the receiver."""
        c = self._config
        distance = max(math.dist(a, b), 0.1)
        way = tuple((q - p) / distance for p, q in zip(a, b, strict=True))
        sent = math.fsum(u * v for u, v in zip(way, signal.axis, strict=True))
        facing = -math.fsum(u * v for u, v in zip(way, rotate(q_NS, (1.0, 0.0, 0.0)), strict=True))
        if sent < signal.bandwidth or facing < self._view:
            return None
        spot = 2.0 * math.pi * max(1.0 - signal.bandwidth, 1e-9) * distance * distance
        caught = min(1.0, c.aperture_m2 * facing / spot) * math.exp(-self.attenuation(scope) * distance)
        power = 10.0 ** (0.1 * (signal.level + gain)) * caught
        if power <= 0.0:
            return None
        towards: Vec3 = (-way[0], -way[1], -way[2])
        strength = (_Q_AT_SENSITIVITY * power / c.sensitivity_w) ** 2
        return Crossing(
            distance / _SPEED, strength, 1.0, 0.0, 10.0 * math.log10(power), towards, (way[0], way[1], way[2])
        )

    def attenuation(self, scope: Scope) -> float:
        """Return the attenuation of its light in this water, 1/m, interpolated linearly between the known wavelengths."""
        known = sorted(zip(WAVELENGTHS_NM, WATER_TYPES[scope.water.jerlov].attenuation, strict=True))
        w = min(max(self._config.wavelength_nm, known[0][0]), known[-1][0])
        (w0, c0), (w1, c1) = next(pair for pair in pairwise(known) if w <= pair[1][0])
        return c0 + (c1 - c0) * (w - w0) / (w1 - w0)

    def notices(self, snr: float) -> bool:
        """See `Modem`. It detects a packet from a third of the sensitivity on."""
        return snr >= (_Q_AT_SENSITIVITY / 3.0) ** 2

    def error_rate(self, snr: float, size: int) -> float:
        """See `Modem`. On-off keying with the threshold in the middle."""
        wrong = 0.5 * math.erfc(math.sqrt(0.5 * snr))
        return -math.expm1(8 * max(size, 1) * math.log1p(-wrong))

    def jitter(self, snr: float) -> float:
        """See `Modem`. A tenth of a bit."""
        return 0.1 / self._config.bits_per_s
