"""Acoustic modem: packets of sound between addressable nodes."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType, structs

from uwserver.environment.acoustics.noise import ambient_db, wind_of
from uwserver.frames import Quat, Vec3
from uwserver.sensors.acoustic.link import Link, LinkTable, ray, stages_of
from uwserver.sensors.base import Pose, Scope, Traits
from uwserver.sensors.modem import Crossing, Modem, ModemTable, Signal
from uwserver.table import NonNegative, Positive, Probability

_FASTEST = 1700.0
"""An upper limit of the sound speed in any sea, m/s."""

_Level = Annotated[float, Meta(ge=-100, le=300)]
"""dB re 1 uPa, or 1 uPa^2/Hz."""
_Gain = Annotated[float, Meta(ge=-100, le=100)]
"""dB."""


class AcousticModemConfig(ModemTable, tag="acoustic_modem", kw_only=True, frozen=True):
    """An acoustic modem. Its sound takes the same paths as that of USBL and LBL: along bent rays, and by way of surface and bottom.

    Attributes:
        propagation, arrival, reflections: as in `usbl`; the receiver locks to the first or to the strongest arrival that it detects.
        frequency_hz, bandwidth_hz: middle and width of the band.
        source_level_db: dB re 1 uPa at 1 m.
        noise_level_db: at the receiver, dB re 1 uPa^2/Hz; default: ambient noise for the frequency, the wind that made the scenario's waves, and
            `shipping`.
        shipping: amount of distant ships, 0 to 1.
        self_noise_db: additional noise of its own vehicle, dB re 1 uPa^2/Hz; default: none.
        threshold_db: signal over noise in the band from which on the receiver detects a packet.
        modulation: gives the bit error rate for a signal: "psk" (coherent), or "fsk" (non-coherent).
        coding_gain_db: gain of its error-correcting code.
        guard_s: arrivals that are later than the signal by at most this add to it: guard time of a symbol, or length of the equaliser.
        multipath_rejection_db: weakening of later arrivals, for instance by spreading or hopping.
        doppler_limit_mps: packets from a modem that approaches or departs faster than this are lost; default: none are.
        speed_sigma_mps: error of the relative speed that it measures by Doppler; default: it gives none.
        fading_sigma_db, fading_time_s: slow normal variation of the level between two modems, the same both ways, so that losses come in bursts.
    """

    message = "AcousticPacket"
    propagation: Literal["straight", "layered"] = "layered"
    arrival: Literal["first", "strongest"] = "first"
    reflections: Annotated[int, Meta(ge=0, le=8)] = 2
    frequency_hz: Annotated[float, Meta(ge=100, le=1e7)] = 26e3
    bandwidth_hz: Annotated[float, Meta(ge=1, le=1e7)] = 4e3
    source_level_db: _Level = 185.0
    noise_level_db: _Level | UnsetType = UNSET
    shipping: Probability = 0.5
    self_noise_db: _Level | UnsetType = UNSET
    threshold_db: _Gain = 3.0
    modulation: Literal["psk", "fsk"] = "psk"
    coding_gain_db: _Gain = 0.0
    guard_s: NonNegative = 0.01
    multipath_rejection_db: Annotated[float, Meta(ge=0, le=100)] = 0.0
    doppler_limit_mps: Positive | UnsetType = UNSET
    speed_sigma_mps: NonNegative | UnsetType = UNSET
    fading_sigma_db: Annotated[float, Meta(ge=0, le=40)] = 0.0
    fading_time_s: Positive = 5.0

    def traits(self) -> Traits:
        """Return its address, and the stages of compiled code that its sound needs."""
        return structs.replace(super().traits(), stages=stages_of(self.propagation))

    def build(self, mount: Pose) -> AcousticModem:
        return AcousticModem(mount, self)


class AcousticModem(Modem):
    """Implements `Modem` for sound. All powers are those in the band, uPa^2."""

    speed = _FASTEST

    def __init__(self, mount: Pose, config: AcousticModemConfig) -> None:
        self._config = config
        self._link = Link(
            LinkTable(
                rate_hz=config.rate_hz,
                propagation=config.propagation,
                reflections=config.reflections,
                frequency_hz=config.frequency_hz,
                bandwidth_hz=config.bandwidth_hz,
            )
        )
        super().__init__(mount, config)

    def load_kernels(self) -> None:
        self._link.load_kernels()

    def speed_at(self, scope: Scope, p: Vec3) -> float:
        """See `Modem`."""
        return scope.water.sound_speed(p[2])

    def blur(self, distance: float) -> float:
        """See `Modem`."""
        return 0.5 * math.sqrt(1500.0 / self._config.frequency_hz * distance)

    def signal(self, q_NS: Quat) -> Signal:
        """See `Modem`; the same in all directions."""
        c = self._config
        return Signal(c.protocol, c.frequency_hz, c.bandwidth_hz, c.source_level_db + self.settings.gain)

    def overlap(self, signal: Signal) -> float:
        """See `Modem`: the spectrum is flat in the band."""
        c = self._config
        half, other = 0.5 * c.bandwidth_hz, 0.5 * signal.bandwidth
        low, high = (
            max(c.frequency_hz - half, signal.frequency - other),
            min(c.frequency_hz + half, signal.frequency + other),
        )
        return max(0.0, high - low) / signal.bandwidth

    def crossing(self, scope: Scope, signal: Signal, a: Vec3, b: Vec3, q_NS: Quat, gain: float) -> Crossing | None:
        """See `Modem`. A signal too weak to be detected has a time and a level too, as it may still disturb another one."""
        c = self._config
        # Paths from the receiver to the sender, which are also those back: so `dip_a` is the angle at the receiver.
        paths = self._link.paths(scope, b, a)
        if not paths:
            return None
        noise = self.noise(scope)
        most = signal.level + gain - 10.0 * math.log10(noise) - c.threshold_db
        heard = [path for path in paths if path.loss <= most]
        main = heard[0] if heard and c.arrival == "first" else min(paths, key=lambda path: path.loss)
        power = [10.0 ** (0.1 * (signal.level + gain - path.loss)) for path in paths]
        near = [0.0 <= path.time - main.time <= c.guard_s for path in paths]
        useful = math.fsum(p for p, is_near in zip(power, near, strict=True) if is_near)
        late = math.fsum(p for p, is_near in zip(power, near, strict=True) if not is_near)
        if useful <= 0.0:
            return None  # so weak that the power is rounded to 0
        # At a, the ray leaves against the direction in which the ray from b to a ends there.
        x, y, z = ray(b, a, main.dip_b)
        rejected = late * 10.0 ** (-0.1 * c.multipath_rejection_db)
        return Crossing(
            main.time, useful, noise, rejected, 10.0 * math.log10(useful), ray(b, a, main.dip_a), (-x, -y, -z)
        )

    def noise(self, scope: Scope) -> float:
        """Return the noise of the sea and of its own vehicle in the band, uPa^2."""
        c = self._config
        if isinstance(c.noise_level_db, float):
            sea = c.noise_level_db
        else:
            roughness = 0.0 if scope.water.sea is None else scope.water.sea.roughness
            sea = ambient_db(c.frequency_hz, wind_of(roughness, scope.water.gravity), c.shipping)
        own = 0.0 if isinstance(c.self_noise_db, UnsetType) else 10.0 ** (0.1 * c.self_noise_db)
        return float(c.bandwidth_hz * (10.0 ** (0.1 * sea) + own))

    def notices(self, snr: float) -> bool:
        """See `Modem`."""
        return bool(snr >= 10.0 ** (0.1 * self._config.threshold_db))

    def error_rate(self, snr: float, size: int) -> float:
        """See `Modem`: bit errors are independent, and one of them spoils the packet (Proakis, Digital Communications, 4th ed. 2001, section 5.2)."""
        c = self._config
        per_bit = snr * c.bandwidth_hz / c.bits_per_s * 10.0 ** (0.1 * c.coding_gain_db)
        if c.modulation == "fsk":
            wrong = 0.5 * math.exp(-0.5 * min(per_bit, 1400.0))
        else:
            wrong = 0.5 * math.erfc(math.sqrt(per_bit))
        return -math.expm1(8 * max(size, 1) * math.log1p(-wrong))

    def jitter(self, snr: float) -> float:
        """See `Modem`."""
        return 1.0 / (self._config.bandwidth_hz * math.sqrt(snr))

    @property
    def fastest(self) -> float:
        """See `Modem`."""
        limit = self._config.doppler_limit_mps
        return math.inf if isinstance(limit, UnsetType) else limit

    @property
    def speed_sigma(self) -> float | None:
        """See `Modem`."""
        sigma = self._config.speed_sigma_mps
        return None if isinstance(sigma, UnsetType) else sigma

    @property
    def fading(self) -> tuple[float, float]:
        """See `Modem`."""
        return self._config.fading_sigma_db, self._config.fading_time_s
