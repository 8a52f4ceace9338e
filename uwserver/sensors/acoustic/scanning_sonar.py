"""Mechanically scanned imaging sonar: a fan of rays that steps about the sensor's z, one ping a step, each from its own pose."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.frames import Vec3, matrix
from uwserver.modifiers.base import Measurement, Memory, Time
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Argument, Buffer, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.cross_talk import Sonar, Voice, add_bursts, believed_speed
from uwserver.sensors.acoustic.echo import MU_SURFACE, Absorption, cast, kernels, load_kernels
from uwserver.sensors.acoustic.head import (
    Index,
    SectorCenter,
    SectorWidth,
    Sense,
    Step,
    head_arguments,
    step_on,
    turned,
)
from uwserver.sensors.acoustic.imaging import echoes, speckle
from uwserver.sensors.acoustic.imaging.fan import Fan, directivity, dot_products
from uwserver.sensors.acoustic.imaging.kernels import load as load_pictures
from uwserver.sensors.acoustic.imaging.silhouettes import Silhouettes
from uwserver.sensors.base import Distance, Gain, Pose, Scope, SensorTable, Settings, blank
from uwserver.table import NonNegative, Positive
from uwserver.units import NANOSECONDS, rad

_FLANKS = 2.0
"""The rays fill so many beam widths: at their edge the two-way pattern is 36 dB down."""
_BEYOND = 1.3
"""Rays look so much farther than the last bin: what they hit behind it may reach into it."""
_FULL_SCALE = 255.0


class ScanningSonarConfig(SensorTable, tag="scanning_sonar", kw_only=True, frozen=True):
    """A scanning sonar. The head turns about the sensor's z, from x towards y. `rate_hz` at most: a ping waits until the last one is over.

    Attributes:
        model: the sonar equation; or the paper's plain dot product of each ray with what it hits, without errors.
        ideal: mean level without speckle, noise and wrong sound speed.
        output: 8-bit counts on a logarithmic scale; the sound pressure (amplitude, Pa) before compression; or, of the sonar equation, the same as
            real and imaginary part: that of the strongest sample in each bin.
        frequency_hz, bandwidth_hz: of the sound; the bandwidth gives the resolution in range.
        pulse_s: its length; a swept pulse longer than 1 / bandwidth is compressed, which lifts the echo by bandwidth times length.
        beam_width_horizontal_deg, beam_width_vertical_deg: between half-power points.
        rays_horizontal, rays_vertical: of the fan.
        bins: of a ping.
        range_m: at the start; changed by the service `set`.
        min_range_m, max_range_m: limits of the range.
        step_deg: of the head.
        sector_center_deg, sector_width_deg: the sector that the head covers, to and fro; without a width it rotates continuously.
        source_level_db: dB re 1 uPa at 1 m.
        noise_level_db: spectral level of the noise around, dB re 1 uPa^2/Hz.
        cross_talk_db: direct sound of other sonars of the vehicle whose bands overlap, beside that on their axis: -40 for two side lobes of -20 dB
            (a model); without it they are not heard.
        tvg_spreading, tvg_limit_db: k of the time-varied gain k lg r + 2 alpha r, and the most that it gives.
        floor_db: level (dB re 1 uPa after time-varied gain and gain) of count 0.
        dynamic_range_db: of the 255 counts.
        gain_db: at the start.
        assumed_sound_speed_mps: what the device believes; default: the truth.
        sees_own_vehicle: whether what its own vehicle consists of stands in its field; else it looks through it, wherever it is mounted.
        overhead_s: between the end of a ping and the next one.
    """

    model: Literal["sonar_equation", "paper"] = "sonar_equation"
    ideal: bool = False
    output: Literal["counts", "pressure", "complex"] = "counts"
    frequency_hz: Positive = 7e5
    bandwidth_hz: Positive = 1e5
    pulse_s: Positive = 4e-4
    beam_width_horizontal_deg: Annotated[float, Meta(gt=0, le=60)] = 3.0
    beam_width_vertical_deg: Annotated[float, Meta(gt=0, le=80)] = 30.0
    rays_horizontal: Annotated[int, Meta(ge=1, le=200)] = 13
    rays_vertical: Annotated[int, Meta(ge=1, le=1000)] = 71
    bins: Annotated[int, Meta(ge=8, le=4096)] = 400
    range_m: Positive = 30.0
    min_range_m: Positive = 1.0
    max_range_m: Positive = 75.0
    step_deg: Annotated[float, Meta(gt=0, le=30)] = 1.8
    sector_center_deg: float = 0.0
    sector_width_deg: Positive | UnsetType = UNSET
    source_level_db: float = 200.0
    noise_level_db: float = 42.0
    cross_talk_db: Annotated[float, Meta(ge=-200, le=0)] | UnsetType = UNSET
    tvg_spreading: NonNegative = 30.0
    tvg_limit_db: NonNegative = 60.0
    floor_db: float = 120.0
    dynamic_range_db: Positive = 80.0
    gain_db: Annotated[float, Meta(ge=-60, le=60)] = 0.0
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    sees_own_vehicle: bool = False
    overhead_s: NonNegative = 0.01

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        if not self.min_range_m <= self.range_m <= self.max_range_m:
            raise ValueError(
                f"range_m is {self.range_m:g}, the sonar takes {self.min_range_m:g} to {self.max_range_m:g}"
            )
        if self.model == "paper" and self.output == "complex":
            raise ValueError('model "paper" knows no phase: output "complex" needs model "sonar_equation"')
        if self.sector_width_deg is not UNSET and rad(self.sector_width_deg) > 2.0 * math.pi:
            raise ValueError("sector_width_deg is more than a full turn: leave it out for continuous rotation")

    def build(self, mount: Pose) -> ScanningSonar:
        return ScanningSonar(mount, self)


class SonarSettings(Settings, frozen=True):
    """See `ScanningSonarConfig`; angles in rad."""

    range: Distance
    gain: Gain
    step: Step
    sector_center: SectorCenter
    sector_width: SectorWidth


class SonarMemory(Memory):
    """Attributes:
    ready: time of the next ping, s.
    index: step of the head, from 0.
    sense: whether it turns back (-1) or on (1)."""

    ready: Time = 0.0
    index: Index = 0
    sense: Sense = 1


class ScanningSonar(Sonar):
    """One row of a sonar picture a ping."""

    doc = "Scanning sonar: the echoes of one ping over range, and where the head pointed; each ping from the pose at its start."
    paces = True
    settings: SonarSettings
    memory: SonarMemory

    def __init__(self, mount: Pose, config: ScanningSonarConfig) -> None:
        self._mount, self._config = mount, config
        width, height = rad(config.beam_width_horizontal_deg), rad(config.beam_width_vertical_deg)
        cover = 1.0 if config.model == "paper" else _FLANKS
        level = 10.0 ** (0.1 * config.source_level_db) * max(1.0, config.bandwidth_hz * config.pulse_s)
        columns, rows, staggered = config.rays_horizontal, config.rays_vertical, config.model != "paper"
        self._fan = Fan(width, height, columns, rows, cover, level, staggered)
        self._silhouettes = Silhouettes(self._fan)
        self._noise = 10.0 ** (0.1 * config.noise_level_db) * config.bandwidth_hz / directivity(width, height)
        self._absorption = Absorption(config.frequency_hz)
        aperture = 0.886 * 1500.0 / (config.frequency_hz * width)
        self._fade_length, self._fade_angle = 0.5 * aperture, 0.8 * width
        bins = Field("bins", "1", "echo level of each bin, 0 to 255", shape=(config.bins,), type="int")
        if config.output == "pressure":
            bins = Field("bins", "Pa", "amplitude of the echo in each bin", shape=(config.bins,))
        elif config.output == "complex":
            layout = Layout("float32", (config.bins, 2))
            bins = Field("bins", "Pa", "real and imaginary part of the echo in each bin", type="buffer", buffer=layout)
        self.fields = (
            Field("head_angle", "rad", "where the beam points, from x towards y of the sensor"),
            Field("range", "m", "distance at the end of the last bin"),
            Field("gain", "dB", "gain of this ping"),
            bins,
        )
        self.arguments = _arguments(config)
        step, middle = rad(config.step_deg), rad(config.sector_center_deg)
        sector = 2.0 * math.pi if config.sector_width_deg is UNSET else rad(config.sector_width_deg)
        super().__init__(SonarSettings(config.range_m, config.gain_db, step, middle, sector))

    def load_kernels(self) -> None:
        load_kernels()
        load_pictures()

    def turn_on(self) -> SonarMemory:
        """Ready at once, at the first step."""
        return SonarMemory()

    def voice(self, c: float) -> Voice:
        """As others hear it, where the sound speed is c (m/s)."""
        config = self._config
        busy = 2.0 * self.settings.range / believed_speed(self._config, c) + config.overhead_s
        level, ready = config.source_level_db, self.memory.ready
        return Voice(
            self._mount.p, config.frequency_hz, config.bandwidth_hz, level, config.pulse_s, ready, busy, self.dt
        )  # fmt: skip

    def sense(self, scope: Scope) -> Measurement | None:
        """A ping; None while the last one is not over."""
        now, reach = scope.t, self.settings.range
        if now < self.memory.ready - 1e-6:
            return None
        p_NS = scope.position(self._mount.p)
        c = scope.water.sound_speed(p_NS[2])
        believed = believed_speed(self._config, c)
        angle = step_on(self.settings, self.memory)
        reading = Measurement([angle, reach, self.settings.gain, blank(self.fields)[3]], False)
        if scope.submergence(p_NS) > 0.0:
            reading.valid = True
            seen = scope if self._config.sees_own_vehicle else scope.without_own_body()
            reading.values[3] = self._picture(seen, p_NS, angle, believed / c)
        duration = 2.0 * reach / believed
        self.memory.ready = now + duration + self._config.overhead_s
        reading.delay_ns = round(duration * NANOSECONDS)
        return reading

    def _picture(self, scope: Scope, p_NS: Vec3, angle: float, stretch: float) -> Value:
        """The bins of a ping."""
        config, reach = self._config, self.settings.range
        R = np.array(matrix(scope.attitude(self._mount.q))) @ turned(angle)
        direction, farthest = self._fan.direction @ R.T, _BEYOND * reach / min(stretch, 1.0)
        hits = cast(scope, p_NS, direction, farthest)
        if config.model == "paper":
            picture = dot_products(self._fan, hits, R, reach, config.bins)
            shown = picture if config.output == "pressure" else np.rint(_FULL_SCALE * picture).astype(int)
            return tuple(shown.tolist())
        c, alpha = scope.water.sound_speed(p_NS[2]), self._absorption.at(scope, p_NS[2])
        gates = echoes.gates(reach, config.bins, c / (2.0 * config.bandwidth_hz), stretch)
        ground = kernels()[0].Ground(scope.lambert, MU_SURFACE)
        second = np.zeros(gates.total + 3)
        finer = self._silhouettes.refine(hits, direction)
        echoes.deposit(self._fan.cells, direction, R, *hits, ground, gates.per_metre, second)
        if finer is not None:
            direction = finer.direction @ R.T
            hits = cast(scope, p_NS, direction, farthest)
            echoes.deposit(finer.cells, direction, R, *hits, ground, gates.per_metre, second)
        energy = np.empty(gates.total)
        echoes.energies(second, gates.per_metre, alpha, energy)
        sound = self._receive(scope, energy, gates, p_NS, R[:, 0])
        if config.output == "complex":
            return Buffer.of((1e-6 * sound).astype(np.float32))
        intensity = sound[:, 0] * sound[:, 0] + sound[:, 1] * sound[:, 1]
        if config.output == "pressure":
            return tuple((1e-6 * np.sqrt(intensity)).tolist())
        counts = np.empty(config.bins, np.int64)
        speckle.compress(
            intensity, reach / config.bins, config.tvg_spreading, alpha, config.tvg_limit_db,
            self.settings.gain - config.floor_db, _FULL_SCALE / config.dynamic_range_db, _FULL_SCALE, counts,
        )  # fmt: skip
        return tuple(counts.tolist())

    def _receive(
        self, scope: Scope, energy: FloatArray, gates: echoes.Gates, p_NS: Vec3, axis: FloatArray
    ) -> FloatArray:
        """(bins, 2) real and imaginary part, uPa: the peak of what the pulse leaves of the echoes (gates) in each bin; the mean has the phase 0.

        Args:
            scope: of the ping.
            energy: mean intensity of the echoes of each gate.
            gates: of this ping.
            p_NS: of the transducer.
            axis: (3) of the beam, in N.
        """
        out: FloatArray = np.zeros((self._config.bins, 2))
        if self._config.ideal:
            mean = np.empty(self._config.bins)
            speckle.detect_mean(energy, gates.window, gates.per_bin, mean)
            out[:, 0] = np.sqrt(mean)
            return out
        field = np.empty((gates.total, 2))
        number = int(self.rng.integers(1 << 63))
        faded, share = speckle.fading(p_NS, axis, self._fade_length, self._fade_angle)
        key = np.uint64(self.draws.key)
        speckle.scatter(energy, key, number, self._noise / gates.window, faded, share, speckle.PHASORS, field)
        heard = self.overhear(scope, gates, scope.water.sound_speed(p_NS[2]), self._config.cross_talk_db)
        add_bursts(heard, self.draws.key, number, gates.window, field.T)
        speckle.detect(field, gates.window, gates.per_bin, out)
        return out


def _arguments(config: ScanningSonarConfig) -> tuple[Argument, ...]:
    low, high = config.min_range_m, config.max_range_m
    return (
        Argument("range", "float", "distance at the end of the last bin", "m", False, minimum=low, maximum=high),
        Argument("gain", "float", "added to the level before compression", "dB", False, minimum=-60, maximum=60),
        *head_arguments(1e-3),
    )
