"""Side-scan sonar: two transducers that point to port and starboard and give a row of echoes each a ping; along the track the rows make a picture."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from msgspec import Meta, structs

from uwserver.modifiers.base import Measurement
from uwserver.ports import BeamView, Buffer, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.cross_talk import ping_arguments
from uwserver.sensors.acoustic.imaging.fan import COLUMNS, Sides, cost, rows_above
from uwserver.sensors.acoustic.pinging import (
    Head,
    ImagingTable,
    Instant,
    Lighting,
    PingingSonar,
    PingSettings,
    fade_of,
)
from uwserver.sensors.acoustic.receiver import Echoes, hear, picture_of
from uwserver.sensors.base import Pose, Scope, Traits
from uwserver.units import rad

_FULL_SCALE = 255.0


class SideScanConfig(ImagingTable, tag="side_scan", kw_only=True, frozen=True):
    """A side-scan sonar; x ahead, y starboard, z down. Ranges are slant ranges from the transducers.

    Attributes:
        beam_width_horizontal_deg: along the track, between half-power points of transmitter and receiver each.
        beam_width_vertical_deg: across the track, likewise.
        tilt_deg: tilt of the axes of both transducers below the horizon.
        rays_vertical: rays below the horizon in each of four columns a side; they divide the range into so many equal parts.
    """

    message = "SideScan"
    beam_width_horizontal_deg: Annotated[float, Meta(ge=0.05, le=10)] = 1.0
    beam_width_vertical_deg: Annotated[float, Meta(gt=0, le=120)] = 50.0
    tilt_deg: Annotated[float, Meta(ge=0, le=90)] = 20.0
    rays_vertical: Annotated[int, Meta(ge=16, le=4096)] = 384

    @property
    def computing_s(self) -> float:
        """Return about the processor time of a ping, s."""
        rows = self.rays_vertical + rows_above(self.rays_vertical)
        return cost(2 * COLUMNS, rows, 2, self.bins)

    def traits(self) -> Traits:
        """Return what all pinging sonars declare, and a beam to each side."""
        tilt, width = rad(self.tilt_deg), rad(self.beam_width_horizontal_deg)
        sides = ((0.0, side * math.cos(tilt), math.sin(tilt)) for side in (-1.0, 1.0))
        beams = tuple(BeamView(side, width, self.min_range_m, self.range_m) for side in sides)
        return structs.replace(super().traits(), beams=beams)

    def build(self, mount: Pose) -> SideScan:
        return SideScan(mount, self)


class SideScan(PingingSonar):
    """Gives two rows of echoes a ping."""

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
            Field("sound_speed", "m/s", "with which the device converts times to ranges"),
            Field("port", unit, f"{what} by range, nearest first, to port", type="buffer", buffer=layout),
            Field("starboard", unit, f"{what} by range, nearest first, to starboard", type="buffer", buffer=layout),
        )
        head = Head(config, Lighting(self._sides, np.eye(3), width, fade_of(width, config.frequency_hz)))
        settings = PingSettings(config.range_m, config.gain_db)
        super().__init__(mount, {"": head}, ping_arguments(config), settings)

    def sense(self, scope: Scope) -> Measurement | None:
        """Return a ping; None while the last one is not over."""
        return self.ping(scope, 2, self._rows, self.settings)

    def _rows(self, instant: Instant, settings: PingSettings) -> tuple[Value, ...]:
        """Return the echoes to port and to starboard. Runs in another thread, so it uses only constants of self."""
        config, level = self._config, self._config.level(settings, instant.water.alpha)
        sound = hear(self._sides, instant.energy(self._echoes), instant.ranges, instant.noise)
        both = picture_of(sound, np.ones(2), level, _FULL_SCALE / config.dynamic_range_db, config.output)
        return tuple(Buffer.of(both[:, side]) for side in range(2))
