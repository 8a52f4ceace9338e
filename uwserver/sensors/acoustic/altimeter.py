"""Echosounder altimeter: the first echo in a cone, how sure it is, and what it hears when it hears wrong."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.frames import Vec3, matrix
from uwserver.modifiers.base import Measurement, Memory, Time
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import NOTHING, Hits
from uwserver.ports import Argument, Field
from uwserver.sensors.acoustic.echo import MU_SEDIMENT, Absorption, cast, load_kernels, scattering
from uwserver.sensors.base import Distance, Gain, Pose, Scope, Sensor, SensorTable, Settings, SoundSpeed, blank
from uwserver.table import NonNegative, Positive, Probability
from uwserver.units import NANOSECONDS, rad

THRESHOLD_DB = 6.0
"""Signal over noise at which half of the echoes are found."""
_SLOPE_DB = 1.5
"""How fast the chance of detection grows about the threshold: logistic."""
_SURE_DB = 20.0
"""So far above the threshold the device is sure."""
_BEYOND = 1.2
"""Rays look so much farther than the device: a bottom at its largest range fills the cone."""


class AltimeterConfig(SensorTable, tag="altimeter", kw_only=True, frozen=True):
    """An echosounder with one conical beam along the sensor's z. `rate_hz` at most: a ping waits until the last one is over.

    Attributes:
        ideal: the exact distance of the nearest point in the cone.
        frequency_hz: of the sound; absorption depends on it.
        beam_width_deg: of the whole cone.
        rings: of rays about the axis; ring k has 6 k rays.
        min_range_m: blanking: nearer echoes are not heard, but their multiples may be.
        max_range_m: the strength of the echo is such that half of the pings find sediment there.
        range_m: how far it listens at the start, default the largest; a shorter range pings faster.
        range_sigma_m, range_sigma_relative: white error, fixed and as a part of the range.
        assumed_sound_speed_mps: what the device believes; default: the truth.
        multiple_loss_db: of each further trip between bottom and vehicle.
        multiple_probability: the second echo is taken for the first.
        processing_s: from the echo to the delivery.
    """

    ideal: bool = False
    frequency_hz: Positive = 5e5
    beam_width_deg: Annotated[float, Meta(gt=0, lt=120)] = 6.0
    rings: Annotated[int, Meta(ge=0, le=30)] = 4
    min_range_m: NonNegative = 0.3
    max_range_m: Positive = 50.0
    range_m: Positive | UnsetType = UNSET
    range_sigma_m: NonNegative = 0.01
    range_sigma_relative: NonNegative = 0.0
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    multiple_loss_db: NonNegative = 10.0
    multiple_probability: Probability = 0.0
    processing_s: NonNegative = 0.0

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        if not self.min_range_m < self.max_range_m:
            raise ValueError("min_range_m must be less than max_range_m")
        if self.range_m is not UNSET and not self.min_range_m <= self.range_m <= self.max_range_m:
            raise ValueError("range_m must lie between min_range_m and max_range_m")

    def build(self, mount: Pose) -> Altimeter:
        return Altimeter(mount, self)


class AltimeterSettings(Settings, frozen=True):
    """See `AltimeterConfig`; `sound_speed` 0 stands for the truth; a `gain` below 0 dB needs stronger echoes."""

    range: Distance
    gain: Gain
    sound_speed: SoundSpeed


class AltimeterMemory(Memory):
    """Attributes:
    ready: time of the next ping, s."""

    ready: Time = 0.0


class Altimeter(Sensor):
    """Range of the first echo and the confidence in it."""

    doc = "Echosounder: range of the first echo in a cone along the sensor's z, and the confidence in it; invalid without echo."
    fields = (
        Field("range", "m", "distance of the first echo"),
        Field("confidence", "1", "how far the echo stands out of the noise, 0 to 1"),
    )
    paces = True
    settings: AltimeterSettings
    memory: AltimeterMemory

    def __init__(self, mount: Pose, config: AltimeterConfig) -> None:
        self._mount, self._config = mount, config
        self._half = rad(config.beam_width_deg) / 2.0
        self._cone = cone(self._half, config.rings)
        self._absorption = Absorption(config.frequency_hz)
        low, high = config.min_range_m, config.max_range_m
        self.arguments = (
            Argument("range", "float", "how far it listens", "m", False, minimum=low, maximum=high),
            Argument("gain", "float", "sensitivity; a lower one needs stronger echoes", "dB", False, minimum=-60, maximum=0),
            Argument("sound_speed", "float", "what the device believes; 0 for the truth", "m/s", False, minimum=0, maximum=2000),
        )  # fmt: skip
        speed = 0.0 if config.assumed_sound_speed_mps is UNSET else config.assumed_sound_speed_mps
        super().__init__(AltimeterSettings(high if config.range_m is UNSET else config.range_m, 0.0, speed))

    def load_kernels(self) -> None:
        load_kernels()

    def turn_on(self) -> AltimeterMemory:
        """Ready at once."""
        return AltimeterMemory()

    def sense(self, scope: Scope) -> Measurement | None:
        """A ping; None while the last one is not over."""
        now = scope.t
        if now < self.memory.ready - 1e-6:
            return None
        p_NS = scope.position(self._mount.p)
        c = scope.water.sound_speed(p_NS[2])
        listening = 2.0 * self.settings.range / c
        found = self._echo(scope, p_NS) if scope.submergence(p_NS) > 0.0 else None
        self.memory.ready = now + listening
        wait = listening + self._config.processing_s
        if found is None:
            reading = Measurement(blank(self.fields), False)
        else:
            reach, confidence = found
            wait = 2.0 * reach / c + self._config.processing_s
            reading = Measurement([self._believed(reach, c), confidence], True)
        reading.delay_ns = round(wait * NANOSECONDS)
        return reading

    def _believed(self, reach: float, c: float) -> float:
        """What the device makes of a range."""
        config = self._config
        if config.ideal:
            return reach
        if self.settings.sound_speed:
            reach *= self.settings.sound_speed / c
        sigma = math.hypot(config.range_sigma_m, config.range_sigma_relative * reach)
        return reach + sigma * self.rng.standard_normal()

    def _echo(self, scope: Scope, p_NS: Vec3) -> tuple[float, float] | None:
        """Range (m) of the echo that is taken for the first, and the confidence."""
        config, high = self._config, self.settings.range
        R = np.array(matrix(scope.attitude(self._mount.q)))
        direction = self._cone @ R.T
        hits = cast(scope, p_NS, direction, _BEYOND * config.max_range_m)
        bodies = sorted({*hits.body.tolist()} - {NOTHING})
        if config.ideal:
            ranges = [self._nearest(scope, p_NS, R, direction, hits, body) for body in bodies]
            nearest = min(ranges, default=math.inf)
            return (nearest, 1.0) if config.min_range_m <= nearest <= high else None
        chance, wrong = self.rng.random(2).tolist()
        power = self._power(scope, hits, direction, p_NS[2])
        audible: list[tuple[float, float]] = []
        for body in bodies:
            excess = 10.0 * math.log10(max(float(power[hits.body == body].sum()), 1e-30)) - self._threshold(chance)
            if excess >= 0.0:
                audible.append((self._nearest(scope, p_NS, R, direction, hits, body), excess))
        if not audible:
            return None
        reach, excess = min(audible)
        trips = 1
        # Within the blanking the device is deaf: it takes the first multiple behind it.
        while trips * reach < config.min_range_m or (trips == 1 and wrong < config.multiple_probability):
            trips += 1
            excess -= config.multiple_loss_db + 20.0 * math.log10(trips / (trips - 1))
        if excess < 0.0 or trips * reach > high:
            return None
        return trips * reach, min(1.0, excess / _SURE_DB)

    def _threshold(self, chance: float) -> float:
        """Signal over noise (dB) that this ping needs: logistic about the threshold, so that weak echoes come and go."""
        luck = math.log(max(chance, 1e-12) / max(1.0 - chance, 1e-12))
        return THRESHOLD_DB - self.settings.gain + _SLOPE_DB * luck

    def _power(self, scope: Scope, hits: Hits, direction: FloatArray, z: float) -> FloatArray:
        """(n) signal over noise that each ray brings: an extended bottom loses 20 lg r + 2 alpha r; sediment that fills the cone at the largest
        range is just heard."""
        reach = self._config.max_range_m
        loss = 0.2 * self._absorption.at(scope, z)
        r = np.clip(hits.distance, 1e-3, _BEYOND * reach)
        level: FloatArray = (reach / r) ** 2 * 10.0 ** (loss * (reach - r)) * scattering(scope, hits, direction)
        level *= 10.0 ** (0.1 * THRESHOLD_DB) / (MU_SEDIMENT * len(direction))
        return level

    def _nearest(self, scope: Scope, p_NS: Vec3, R: FloatArray, direction: FloatArray, hits: Hits, body: int) -> float:
        """Distance (m) of the nearest point of a body in the cone: the foot of the perpendicular on what the nearest ray hits, or the point
        at the edge of the cone that comes closest to it, unless the rays know better."""
        distance = np.where(hits.body == body, hits.distance, math.inf)
        k = int(distance.argmin())
        best = float(distance[k])
        foot = -R.T @ hits.normal[k]
        across = math.hypot(foot[0], foot[1])
        if math.atan2(across, foot[2]) > self._half:
            side = math.sin(self._half) / max(across, 1e-12)
            foot = np.array((foot[0] * side, foot[1] * side, math.cos(self._half)))
        again = cast(scope, p_NS, (R @ foot)[None, :], _BEYOND * self._config.max_range_m)
        return min(best, float(again.distance[0])) if again.body[0] == body else best


def cone(half: float, rings: int) -> FloatArray:
    """(n, 3) unit rays about z, spread evenly over a cone of this half angle (rad): the axis, and ring k of 6 k rays."""
    rays = [(0.0, 0.0, 1.0)]
    for k in range(1, rings + 1):
        angle = half * k / rings
        for j in range(6 * k):
            # Each ring is turned against the last, so that no plane holds more rays than others.
            azimuth = 2.0 * math.pi * (j + 0.5 * (k % 2)) / (6 * k)
            rays.append((math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)))
    return np.array(rays)
