"""Side-scan sonar: two transducers that look to port and starboard, one row of echoes each a ping; the vehicle's way makes a picture of them."""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta, structs

from uwserver.modifiers.base import Measurement
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import BeamView, Buffer, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.imaging import columns
from uwserver.sensors.acoustic.imaging.sides import COLUMNS, Sides, rows_above
from uwserver.sensors.acoustic.imaging.swath import cost
from uwserver.sensors.acoustic.pinging import Instant, Lighting, PingingSonar, PingSettings, PingTable, fade_of
from uwserver.sensors.acoustic.receiver import Echoes, gain_over_range, hear
from uwserver.sensors.base import Pose, Scope, Traits
from uwserver.sensors.job import Job
from uwserver.table import NonNegative, Positive
from uwserver.units import rad

_FULL_SCALE = 255.0
_MICRO = np.float32(1e-6)
_GAINS = np.ones(2, np.float32)


class SideScanConfig(PingTable, tag="side_scan", kw_only=True, frozen=True):
    """A side-scan sonar; x ahead, y starboard, z down. Ranges are slant ranges, from the transducers on.

    Attributes:
        output: 8-bit counts on a logarithmic scale; the sound pressure (amplitude, Pa); or the same as real and imaginary part.
        beam_width_horizontal_deg: along the way, between half-power points of transmitter and receiver each.
        beam_width_vertical_deg: across the way, likewise.
        tilt_deg: of the axes of both transducers below the horizon.
        rays_vertical: below the horizon, of each of four columns a side; so many ranges are told apart, in equal parts of the range.
        tvg_spreading, tvg_limit_db: k of the time-varied gain k lg r + 2 alpha r, and the most that it gives.
        floor_db: level (dB re 1 uPa after time-varied gain and gain) of count 0.
        dynamic_range_db: of the 255 counts.
        gain_db: at the start.
    """

    message = "SideScan"
    output: Literal["counts", "pressure", "complex"] = "counts"
    beam_width_horizontal_deg: Annotated[float, Meta(ge=0.05, le=10)] = 1.0
    beam_width_vertical_deg: Annotated[float, Meta(gt=0, le=120)] = 50.0
    tilt_deg: Annotated[float, Meta(ge=0, le=90)] = 20.0
    rays_vertical: Annotated[int, Meta(ge=16, le=4096)] = 384
    tvg_spreading: NonNegative = 30.0
    tvg_limit_db: NonNegative = 80.0
    floor_db: float = 118.0
    dynamic_range_db: Positive = 60.0
    gain_db: Annotated[float, Meta(ge=-60, le=60)] = 0.0

    @property
    def computing_s(self) -> float:
        """About the processor time of a ping, s."""
        rows = self.rays_vertical + rows_above(self.rays_vertical)
        return cost(2 * COLUMNS, rows, 2, self.bins)

    def traits(self) -> Traits:
        """Its two sides."""
        tilt, width = rad(self.tilt_deg), rad(self.beam_width_horizontal_deg)
        sides = ((0.0, side * math.cos(tilt), math.sin(tilt)) for side in (-1.0, 1.0))
        beams = tuple(BeamView(side, width, self.min_range_m, self.range_m) for side in sides)
        return structs.replace(super().traits(), beams=beams)

    def build(self, mount: Pose) -> SideScan:
        return SideScan(mount, self)


class _Recording(NamedTuple):
    """What a job knows besides the instant: keys, both sides, and the level (bins) that is added, dB."""

    config: SideScanConfig
    sides: Sides
    echoes: Echoes
    level: FloatArray


class _Rows(Job):
    """Both rows of a ping."""

    def __init__(self, instant: Instant, recording: _Recording) -> None:
        self._instant, self._recording = instant, recording

    def run(self) -> tuple[Value, ...]:
        """Port and starboard."""
        instant, (config, sides, echoes, level) = self._instant, self._recording
        sound = hear(sides, instant.energy(echoes), instant.ranges, instant.noise)[:, :, : config.bins]
        if instant.noise is None:  # an amplitude of the same intensity, of phase 0
            sound = np.concatenate([np.sqrt(sound), np.zeros_like(sound)])
        if config.output == "complex":
            return tuple(Buffer.of(np.ascontiguousarray(_MICRO * sound[:, side].T)) for side in range(2))
        intensity = np.empty((config.bins, 2), np.float32)
        columns.intensities(sound, _GAINS, intensity)
        if config.output == "pressure":
            pressure = _MICRO * np.sqrt(intensity)
            return tuple(Buffer.of(np.ascontiguousarray(pressure[:, side])) for side in range(2))
        rows = np.empty(intensity.shape, np.uint8)
        columns.counts(intensity, level, _FULL_SCALE / config.dynamic_range_db, columns.LOGARITHMS, rows)
        return tuple(Buffer.of(np.ascontiguousarray(rows[:, side])) for side in range(2))


class SideScan(PingingSonar):
    """Two rows a ping."""

    doc = "Side-scan sonar: echoes of one ping over slant range to port and to starboard, from the pose at its start."
    takes_time = True

    def __init__(self, mount: Pose, config: SideScanConfig) -> None:
        self._config = config
        width, height = rad(config.beam_width_horizontal_deg), rad(config.beam_width_vertical_deg)
        self._sides = Sides(width, height, rad(config.tilt_deg), config.rays_vertical)
        self._echoes = Echoes(self._sides, config.bins)
        unit, what, layout = {
            "counts": ("1", "counts", Layout("uint8", (config.bins,))),
            "pressure": ("Pa", "amplitude of the echo", Layout("float32", (config.bins,))),
            "complex": ("Pa", "real and imaginary part of the echo", Layout("float32", (config.bins, 2))),
        }[config.output]
        self.fields = (
            Field("range", "m", "slant range at the end of the last bin"),
            Field("gain", "dB", "gain of this ping"),
            Field("frequency", "Hz", "of this ping"),
            Field("sound_speed", "m/s", "by which the device makes ranges of times"),
            Field("port", unit, f"{what} by range, nearest first, to port", type="buffer", buffer=layout),
            Field("starboard", unit, f"{what} by range, nearest first, to starboard", type="buffer", buffer=layout),
        )
        lighting = Lighting(self._sides, np.eye(3), width, fade_of(width, config.frequency_hz))
        super().__init__(mount, config, lighting, PingSettings(config.range_m, config.gain_db))

    def sense(self, scope: Scope) -> Measurement | None:
        """A ping; None while the last one is not over."""
        return self.ping(scope, 2, self._rows)

    def _rows(self, instant: Instant) -> Job:
        config = self._config
        level = gain_over_range(
            self.settings.range, config.bins, config.tvg_spreading, instant.water.alpha, config.tvg_limit_db
        ) + (self.settings.gain - config.floor_db)  # fmt: skip
        return _Rows(instant, _Recording(config, self._sides, self._echoes, level))
