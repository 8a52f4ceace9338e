"""Bathymetric multibeam echosounder: a swath of narrow beams across the track, and the range of the bottom in each."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, structs

from uwserver.modifiers.base import Measurement
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import BeamView, Buffer, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.cross_talk import ping_arguments
from uwserver.sensors.acoustic.imaging.array import Taper, difference, elements, pattern
from uwserver.sensors.acoustic.imaging.fan import Swath, check_size, columns_of, cost
from uwserver.sensors.acoustic.imaging.soundings import HEARD, bands
from uwserver.sensors.acoustic.pinging import (
    Head,
    Instant,
    Lighting,
    PingingSonar,
    PingSettings,
    PingTable,
    fade_of,
)
from uwserver.sensors.acoustic.receiver import Array, Echoes, blanked, listen, sound_out
from uwserver.sensors.base import Pose, Scope, Traits
from uwserver.table import Positive
from uwserver.units import rad

_ONE_WAY = 1.39
"""The two-way pattern of beams wider by this factor is that of the transmitter alone, as along the track the receiver hears all that is lit."""
_AXES: FloatArray = np.array(((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)))
"""Axes of the swath in the sensor frame, as columns: its x is down, its y starboard."""
_SHOWN = 15
"""Number of beams that a picture of the world shows."""


class BathymetryConfig(PingTable, tag="bathymetry", kw_only=True, frozen=True):
    """A multibeam echosounder; x ahead, y starboard, z down. Its beams point down, and to both sides.

    Attributes:
        beams: number of beams, at equal angles.
        field_deg: angle that the beams cover.
        beam_width_across_deg: width across the track of a receiving beam straight down, between half-power points; to the side it is wider, as with
            any array.
        beam_width_along_deg: width along the track of the transmitter's beam.
        receiver_height_deg: width of the receiver's beams along the track; it decides how much noise they hear.
        taper: taper of the receiving array.
        rays_along: number of rays in each column.
        threshold_db: level above the noise from which on an echo counts.
        detection: how ranges are found: by the middle of the echo; or, where that is more precise, as in outer beams, by the place where the phase
            between both halves of the array is zero. An `ideal` echosounder has no phases.
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
        """Raise ValueError if keys contradict each other."""
        super().__post_init__()
        columns = columns_of(rad(self.field_deg), rad(self.beam_width_across_deg))
        check_size(columns, self.rays_along, self.beams, "wider beams, a smaller field or fewer rays_along")

    @property
    def computing_s(self) -> float:
        """Return about the processor time of a ping, s."""
        columns = columns_of(rad(self.field_deg), rad(self.beam_width_across_deg))
        formed = self.beams * (1 if self.detection == "amplitude" or self.ideal else 2)
        return cost(columns, self.rays_along, formed, self.bins, HEARD)

    def traits(self) -> Traits:
        """Return what all pinging sonars declare, and some beams of the swath."""
        half, last = 0.5 * rad(self.field_deg), _SHOWN - 1
        angles = (half * (2.0 * k / last - 1.0) for k in range(_SHOWN))
        width = rad(self.beam_width_across_deg)
        beams = (BeamView((0.0, math.sin(a), math.cos(a)), width, self.min_range_m, self.range_m) for a in angles)
        return structs.replace(super().traits(), beams=tuple(beams))

    def build(self, mount: Pose) -> Bathymetry:
        return Bathymetry(mount, self)


class Bathymetry(PingingSonar):
    """Gives one range a beam."""

    doc = "Multibeam echosounder: range of the bottom in each beam of a swath across the way, from the pose at the start of the ping."
    takes_time = True

    def __init__(self, mount: Pose, config: BathymetryConfig) -> None:
        self._config = config
        width, along = rad(config.beam_width_across_deg), rad(config.beam_width_along_deg)
        swath = Swath(rad(config.field_deg), width, _ONE_WAY * along, config.beams, config.rays_along, config.taper)
        self._echoes = Echoes(swath, config.bins)
        apart = None
        if config.detection == "phase":
            apart = pattern(config.taper, elements(config.taper, width), swath.azimuth, swath.grid.azimuth, difference)
        self._array = Array(swath.pattern, swath.power, bands(swath.pattern), apart)
        self._directivity = max(4.0 * np.pi / (width * rad(config.receiver_height_deg)), 1.0)
        self._angle = Buffer.of(swath.azimuth.astype(np.float32))
        one, methods = Layout("float32", (config.beams,)), Layout("uint8", (config.beams,))
        self.fields = (
            Field("max_range", "m", "range at which the device stops listening"),
            Field("gain", "dB", "gain of this ping: below 0 an echo must be stronger to count"),
            Field("frequency", "Hz", "of this ping"),
            Field("sound_speed", "m/s", "with which the device converts times to ranges"),
            Field("angle", "rad", "of each beam, from z towards y of the sensor", type="buffer", buffer=one),
            Field("range", "m", "of each beam, along it; NaN without an echo", type="buffer", buffer=one),
            Field("quality", "1", "of each range: 1 for an echo without noise, 0 for none", type="buffer", buffer=one),
            Field("hits", "1", "bins of each echo", type="buffer", buffer=Layout("uint16", (config.beams,))),
            Field("level", "dB", "of each echo, re 1 uPa; NaN without one", type="buffer", buffer=one),
            Field("method", "1", "by which each range was found: 0 none, 1 amplitude, 2 phase", type="buffer", buffer=methods),
        )  # fmt: skip
        head = Head(config, Lighting(swath, _AXES, min(width, along), fade_of(width, config.frequency_hz)))
        super().__init__(mount, {"": head}, ping_arguments(config), PingSettings(config.range_m, 0.0))

    def sense(self, scope: Scope) -> Measurement | None:
        """Return a ping; None while the last one is not over."""
        return self.ping(scope, 6, self._ranges, self.settings)

    def _ranges(self, instant: Instant, settings: PingSettings) -> tuple[Value, ...]:
        """Return angles, ranges, qualities, hits, levels and methods of the beams. Runs in another thread, so it uses only constants of self."""
        config, directivity, divided = self._config, self._directivity, instant.ranges
        sound, apart = listen(instant.energy(self._echoes), divided, instant.noise, directivity, self._array)
        bin_m, threshold = settings.range / config.bins, config.threshold_db - settings.gain
        blanked(sound, config.min_range_m, bin_m)
        found = sound_out(sound, config.bins, divided, directivity, instant.water.alpha, threshold, apart=apart)
        level = 10.0 * np.log10(np.maximum(found.level, 1e-30))
        return (
            self._angle,
            Buffer.of((found.place * bin_m).astype(np.float32)),
            Buffer.of(found.quality.astype(np.float32)),
            Buffer.of(np.minimum(found.hits, 0xFFFF).astype(np.uint16)),
            Buffer.of(np.where(found.hits > 0, level, np.nan).astype(np.float32)),
            Buffer.of(found.method),
        )
