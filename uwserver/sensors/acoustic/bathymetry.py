"""Bathymetric multibeam echosounder: a swath of narrow beams across the way, and the range of the bottom in each."""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta, structs

from uwserver.modifiers.base import Measurement
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import BeamView, Buffer, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.imaging.array import Taper, difference, elements, pattern
from uwserver.sensors.acoustic.imaging.soundings import HEARD, bands
from uwserver.sensors.acoustic.imaging.swath import Plane, Swath, check_size, columns_of, cost
from uwserver.sensors.acoustic.pinging import Instant, Lighting, PingingSonar, PingSettings, PingTable, fade_of
from uwserver.sensors.acoustic.receiver import Echoes
from uwserver.sensors.acoustic.sounding import Array, Soundings, blanked, listen, listen_apart, sound_out
from uwserver.sensors.base import Pose, Scope, Traits
from uwserver.sensors.job import Job
from uwserver.table import Positive
from uwserver.units import rad

_ONE_WAY = 1.39
"""A two-way pattern of so much wider beams is that of one transmitter alone: along the way the receiver hears all that is lit."""
_AXES: FloatArray = np.array(((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)))
"""The swath's x is down, its y starboard."""


_SHOWN = 15
"""Beams of a swath that a picture of the world shows."""


class BathymetryConfig(PingTable, tag="bathymetry", kw_only=True, frozen=True):
    """A multibeam echosounder; x ahead, y starboard, z down: beams look down, and to both sides.

    Attributes:
        beams: equal angles apart.
        field_deg: angle that the beams cover.
        beam_width_across_deg: of a receiving beam straight down, between half-power points; at an angle it is wider, as of any array.
        beam_width_along_deg: of the transmitter.
        receiver_height_deg: of the receiver along the way: how much noise it hears.
        taper: of the receiving array.
        rays_along: of each column of rays.
        threshold_db: above the noise, for an echo to count.
        detection: of a range: the middle of the echo; or, where that is surer, where the phase between both halves of the array is zero, as in outer
            beams. An `ideal` one has no phases.
    """

    message = "Bathymetry"
    frequency_hz: Positive = 400e3
    bandwidth_hz: Positive = 3e4
    pulse_s: Positive = 1e-4
    bins: Annotated[int, Meta(ge=8, le=4096)] = 512
    beams: Annotated[int, Meta(ge=2, le=1024)] = 256
    field_deg: Annotated[float, Meta(gt=0, le=170)] = 140.0
    beam_width_across_deg: Annotated[float, Meta(ge=0.1, le=30)] = 1.0
    beam_width_along_deg: Annotated[float, Meta(ge=0.1, le=30)] = 1.0
    receiver_height_deg: Annotated[float, Meta(ge=0.1, le=120)] = 25.0
    taper: Taper = "hamming"
    rays_along: Annotated[int, Meta(ge=4, le=256)] = 12
    threshold_db: Annotated[float, Meta(ge=0, le=60)] = 14.0
    detection: Literal["amplitude", "phase"] = "phase"

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        super().__post_init__()
        columns = columns_of(rad(self.field_deg), rad(self.beam_width_across_deg))
        check_size(columns, self.rays_along, self.beams, "wider beams, a smaller field or fewer rays_along")

    @property
    def computing_s(self) -> float:
        """About the processor time of a ping, s."""
        columns = columns_of(rad(self.field_deg), rad(self.beam_width_across_deg))
        formed = self.beams * (1 if self.detection == "amplitude" or self.ideal else 2)
        return cost(columns, self.rays_along, formed, self.bins, HEARD)

    def traits(self) -> Traits:
        """Some beams of its swath."""
        half, last = 0.5 * rad(self.field_deg), _SHOWN - 1
        angles = (half * (2.0 * k / last - 1.0) for k in range(_SHOWN))
        width = rad(self.beam_width_across_deg)
        beams = (BeamView((0.0, math.sin(a), math.cos(a)), width, self.min_range_m, self.range_m) for a in angles)
        return structs.replace(super().traits(), beams=tuple(beams))

    def build(self, mount: Pose) -> Bathymetry:
        return Bathymetry(mount, self)


class _Recording(NamedTuple):
    """What a job knows besides the instant: keys, rays, beams, the directivity of a beam (ratio), and settings of the device: range (m) and
    gain (dB)."""

    config: BathymetryConfig
    echoes: Echoes
    array: Array
    directivity: float
    angle: Buffer
    reach: float
    gain: float


class _Swath(Job):
    """Ranges of a ping."""

    def __init__(self, instant: Instant, recording: _Recording) -> None:
        self._instant, self._recording = instant, recording

    def run(self) -> tuple[Value, ...]:
        """Angles, ranges, qualities, hits, levels and methods of the beams."""
        config, reach = self._recording.config, self._recording.reach
        found = self._found()
        ranges = (found.place * (reach / config.bins)).astype(np.float32)
        level = 10.0 * np.log10(np.maximum(found.level, 1e-30))
        return (
            self._recording.angle,
            Buffer.of(ranges),
            Buffer.of(found.quality.astype(np.float32)),
            Buffer.of(np.minimum(found.hits, 0xFFFF).astype(np.uint16)),
            Buffer.of(np.where(found.hits > 0, level, np.nan).astype(np.float32)),
            Buffer.of(found.method),
        )

    def _found(self) -> Soundings:
        instant, recording = self._instant, self._recording
        energy = instant.energy(recording.echoes)
        divided, noise, directivity, array = instant.ranges, instant.noise, recording.directivity, recording.array
        if noise is None:
            sound, apart = listen(energy, divided, None, directivity, array), None
        else:
            sound, apart = listen_apart(energy, divided, noise, directivity, array)
        config, alpha = recording.config, instant.water.alpha
        blanked(sound, config.min_range_m, recording.reach / config.bins)
        threshold = config.threshold_db - recording.gain
        return sound_out(sound, config.bins, instant.ranges, recording.directivity, alpha, threshold, apart=apart)


class Bathymetry(PingingSonar):
    """One range a beam."""

    doc = "Multibeam echosounder: range of the bottom in each beam of a swath across the way, from the pose at the start of the ping."
    takes_time = True

    def __init__(self, mount: Pose, config: BathymetryConfig) -> None:
        self._config = config
        width, along = rad(config.beam_width_across_deg), rad(config.beam_width_along_deg)
        swath = Swath(rad(config.field_deg), width, _ONE_WAY * along, config.beams, config.rays_along, config.taper)
        self._echoes = Echoes(swath, config.bins)
        apart = _apart(config, swath) if config.detection == "phase" else None
        self._array = Array(swath.pattern, swath.power, bands(swath.pattern), apart)
        self._directivity = max(4.0 * np.pi / (width * rad(config.receiver_height_deg)), 1.0)
        self._angle = Buffer.of(swath.azimuth.astype(np.float32))
        one = Layout("float32", (config.beams,))
        self.fields = (
            Field("max_range", "m", "range at which the device stops listening"),
            Field("gain", "dB", "gain of this ping: below 0 an echo must be stronger to count"),
            Field("frequency", "Hz", "of this ping"),
            Field("sound_speed", "m/s", "by which the device makes ranges of times"),
            Field("angle", "rad", "of each beam, from z towards y of the sensor", type="buffer", buffer=one),
            Field("range", "m", "of each beam, along it; NaN without an echo", type="buffer", buffer=one),
            Field("quality", "1", "of each range: 1 for an echo without noise, 0 for none", type="buffer", buffer=one),
            Field("hits", "1", "bins of each echo", type="buffer", buffer=Layout("uint16", (config.beams,))),
            Field("level", "dB", "of each echo, re 1 uPa; NaN without one", type="buffer", buffer=one),
            Field(
                "method",
                "1",
                "by which each range was found: 0 none, 1 amplitude, 2 phase",
                type="buffer",
                buffer=Layout("uint8", (config.beams,)),
            ),
        )
        super().__init__(
            mount,
            config,
            Lighting(swath, _AXES, min(width, along), fade_of(width, config.frequency_hz)),
            PingSettings(config.range_m, 0.0),
        )

    def sense(self, scope: Scope) -> Measurement | None:
        """A ping; None while the last one is not over."""
        return self.ping(scope, 6, self._swath)

    def _swath(self, instant: Instant) -> Job:
        reach, gain = self.settings.range, self.settings.gain
        recording = _Recording(self._config, self._echoes, self._array, self._directivity, self._angle, reach, gain)
        return _Swath(instant, recording)


def _apart(config: BathymetryConfig, swath: Swath) -> Plane:
    """(beams, columns) of the difference of both halves of its array."""
    count = elements(config.taper, rad(config.beam_width_across_deg))
    return pattern(config.taper, count, swath.azimuth, swath.grid.azimuth, difference)
