"""Profiling sonar: a pencil beam, fixed or on a head that steps, and the range of the echo that each ping brings."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from uwserver.frames import IDENTITY
from uwserver.modifiers.base import Measurement
from uwserver.ports import Argument, Field, Value
from uwserver.sensors.acoustic.head import (
    Index,
    SectorCenter,
    SectorWidth,
    Sense,
    Step,
    axes,
    head_arguments,
    step_on,
)
from uwserver.sensors.acoustic.imaging.pencil import Pencil
from uwserver.sensors.acoustic.pinging import (
    Instant,
    Lighting,
    PingingSonar,
    PingMemory,
    PingSettings,
    PingTable,
    fade_of,
)
from uwserver.sensors.acoustic.receiver import Echoes
from uwserver.sensors.acoustic.sounding import Soundings, blanked, listen, sound_out
from uwserver.sensors.base import Pose, Scope
from uwserver.table import NonNegative, Positive
from uwserver.units import rad


class ProfilerConfig(PingTable, tag="profiler", kw_only=True, frozen=True):
    """A profiling sonar. The head turns about the sensor's z, from x towards y: with `rpy_deg = [0, -90, 0]` across the way, from down to starboard.

    Attributes:
        beam_width_deg: of the cone, between half-power points of transmitter and receiver each.
        rays: of each side of a square of rays.
        step_deg: of the head.
        sector_center_deg, sector_width_deg: the sector that the head covers, to and fro; of width 0 it stands still, of width 360 it rotates.
        detection: the strongest echo of a ping, or the first one.
        threshold_db: above the noise, for an echo to count.
    """

    frequency_hz: Positive = 1e6
    bandwidth_hz: Positive = 5e4
    pulse_s: Positive = 2e-5
    bins: Annotated[int, Meta(ge=8, le=4096)] = 1000
    range_m: Positive = 20.0
    max_range_m: Positive = 40.0
    min_range_m: Positive = 0.4
    beam_width_deg: Annotated[float, Meta(ge=0.2, le=20)] = 1.5
    rays: Annotated[int, Meta(ge=3, le=32)] = 9
    step_deg: Annotated[float, Meta(gt=0, le=30)] = 0.9
    sector_center_deg: float = 0.0
    sector_width_deg: NonNegative = 0.0
    detection: Literal["strongest", "first"] = "strongest"
    threshold_db: Annotated[float, Meta(ge=0, le=60)] = 14.0
    processing_s: NonNegative = 0.0

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        super().__post_init__()
        if rad(self.sector_width_deg) > 2.0 * math.pi + 1e-9:
            raise ValueError("sector_width_deg is more than a full turn")

    def build(self, mount: Pose) -> Profiler:
        return Profiler(mount, self)


class ProfilerSettings(PingSettings, frozen=True):
    """See `ProfilerConfig`; angles in rad. A `gain` below 0 dB needs stronger echoes."""

    step: Step
    sector_center: SectorCenter
    sector_width: SectorWidth


class ProfilerMemory(PingMemory):
    """Attributes:
    index: step of the head, from 0.
    sense: whether it turns back (-1) or on (1)."""

    index: Index = 0
    sense: Sense = 1


class Profiler(PingingSonar):
    """One range a ping. It casts so few rays that it reads within the tick."""

    doc = "Profiling sonar: where its pencil beam pointed and how far the echo came from; each ping from the pose at its start."
    settings: ProfilerSettings
    memory: ProfilerMemory

    def __init__(self, mount: Pose, config: ProfilerConfig) -> None:
        self._config = config
        width = rad(config.beam_width_deg)
        pencil = Pencil(width, config.rays)
        self._echoes, self._directivity = Echoes(pencil, config.bins), pencil.directivity
        self.fields = (
            Field("max_range", "m", "range at which the device stops listening"),
            Field("gain", "dB", "gain of this ping"),
            Field("frequency", "Hz", "of this ping"),
            Field("sound_speed", "m/s", "by which the device makes ranges of times"),
            Field("head_angle", "rad", "where the beam points, from x towards y of the sensor"),
            Field("range", "m", "of the echo, along the beam; missing without one"),
            Field("level", "dB", "of the echo, re 1 uPa; missing without one"),
            Field("quality", "1", "of the range: 1 for an echo without noise, 0 for none"),
        )
        settings = ProfilerSettings(
            config.range_m, 0.0, rad(config.step_deg), rad(config.sector_center_deg), rad(config.sector_width_deg)
        )
        lighting = Lighting(pencil, np.eye(3), width, fade_of(width, config.frequency_hz))
        super().__init__(mount, config, lighting, settings)
        self.arguments: tuple[Argument, ...] = (*self.arguments, *head_arguments(0.0))

    def turn_on(self) -> ProfilerMemory:
        """Ready at once, at the first step."""
        return ProfilerMemory()

    def sense(self, scope: Scope) -> Measurement | None:
        """A ping; None while the last one is not over."""
        if not self.begins(scope.t):
            return None
        s, m, R = self.settings, self.memory, np.empty((3, 3))
        angle, m.index, m.sense = step_on(s.step, s.sector_center, s.sector_width, m.index, m.sense)
        axes(IDENTITY, angle, R)
        sent = self.send(scope, R)
        values = [*sent.values, angle]
        if sent.instant is None:
            return Measurement([*values, None, None, 0.0], False, delay_ns=sent.delay_ns)
        echo = self._echo(self._sounding(sent.instant))
        return Measurement([*values, *echo], echo[0] is not None, delay_ns=sent.delay_ns)

    def _sounding(self, instant: Instant) -> Soundings:
        config = self._config
        sound = listen(instant.energy(self._echoes), instant.ranges, instant.noise, self._directivity, None)
        blanked(sound, config.min_range_m, self.settings.range / config.bins)
        threshold = config.threshold_db - self.settings.gain
        return sound_out(
            sound, config.bins, instant.ranges, self._directivity, instant.water.alpha, threshold, config.detection == "first"
        )  # fmt: skip

    def _echo(self, found: Soundings) -> tuple[Value, Value, Value]:
        """Range, level and quality."""
        if not found.hits[0]:
            return None, None, 0.0
        distance = float(found.place[0]) * (self.settings.range / self._config.bins)
        return distance, 10.0 * math.log10(max(float(found.level[0]), 1e-30)), float(found.quality[0])
