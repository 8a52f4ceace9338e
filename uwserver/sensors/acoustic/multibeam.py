"""Forward-looking multibeam imaging sonar: one ping lights the whole field, and an array makes beams of what comes back."""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET, Meta, UnsetType, structs

from uwserver.frames import Quat, Vec3, matrix, multiply
from uwserver.modifiers.base import Measurement, Memory, Time
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Argument, Buffer, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.cross_talk import Sonar, Voice, believed_speed
from uwserver.sensors.acoustic.echo import Absorption, load_kernels
from uwserver.sensors.acoustic.imaging import columns, speckle
from uwserver.sensors.acoustic.imaging.array import Taper
from uwserver.sensors.acoustic.imaging.kernels import load as load_pictures
from uwserver.sensors.acoustic.imaging.swath import Plane, Swath, check_size, columns_of, cost
from uwserver.sensors.acoustic.receiver import (
    Echoes,
    Noise,
    Paths,
    Pulse,
    Ranges,
    Water,
    gain_over_range,
    hear,
    ranges,
)  # fmt: skip
from uwserver.sensors.base import Distance, Gain, Pose, Scope, SensorTable, Settings, earlier, out_of_range
from uwserver.sensors.job import Begun, Job
from uwserver.table import Name, NonNegative, Positive, Table
from uwserver.units import NANOSECONDS, rad

_FULL_SCALE = 255.0
_MOST_MODES = 8
_STILL = 0.25
"""Beam widths that a sonar may turn in a ping and count as still; beyond, its picture is blended of its first and its last pose."""
_MILLION = 1e-6


class MultibeamMode(Table, kw_only=True, frozen=True):
    """What a mode of a multibeam sonar changes; the rest stays as in its table.

    Attributes:
        frequency_hz, bandwidth_hz, pulse_s, field_deg, beam_width_horizontal_deg, beam_width_vertical_deg, min_range_m, max_range_m, source_level_db,
            noise_level_db: as in `MultibeamConfig`.
    """

    frequency_hz: Positive | UnsetType = UNSET
    bandwidth_hz: Positive | UnsetType = UNSET
    pulse_s: Positive | UnsetType = UNSET
    field_deg: Annotated[float, Meta(gt=0, le=170)] | UnsetType = UNSET
    beam_width_horizontal_deg: Annotated[float, Meta(ge=0.05, le=60)] | UnsetType = UNSET
    beam_width_vertical_deg: Annotated[float, Meta(gt=0, le=80)] | UnsetType = UNSET
    min_range_m: Positive | UnsetType = UNSET
    max_range_m: Positive | UnsetType = UNSET
    source_level_db: float | UnsetType = UNSET
    noise_level_db: float | UnsetType = UNSET


class MultibeamConfig(SensorTable, tag="multibeam", kw_only=True, frozen=True):
    """A forward-looking multibeam sonar; x ahead, azimuth from x towards y. `rate_hz` at most: a ping waits until the last one is over.

    Attributes:
        ideal: mean level without speckle, noise, gain errors and wrong sound speed.
        output: 8-bit counts on a logarithmic scale; the sound pressure (amplitude, Pa); or the same as real and imaginary part.
        beams: of the picture, equal angles apart.
        bins: rows of the picture, equal ranges apart.
        field_deg: angle that the beams cover.
        frequency_hz, bandwidth_hz, pulse_s: as of a scanning sonar; a receiver filters to what its bins resolve.
        beam_width_horizontal_deg: between half-power points of a beam ahead; at an angle it is wider, as of any array.
        beam_width_vertical_deg: between half-power points, of transmitter and receiver each.
        taper: of the array: side lobes of -13.3 dB (none), -23 dB (cosine) or -42.7 dB (hamming).
        gain_sigma_db: standard deviation of the beams' gains, which stay as they are in a run.
        rays_vertical: of each column of rays; six for each degree of the beam's height are enough.
        range_m: at the start; changed by the service `set`.
        min_range_m, max_range_m: limits of the range.
        mode: of `modes`, at the start; "" for none.
        modes: by name, as "low" and "high".
        source_level_db: dB re 1 uPa at 1 m.
        noise_level_db: spectral level of the noise around, dB re 1 uPa^2/Hz.
        volume_backscatter_db: of a cubic metre of water, dB re 1/m; without it the water is clear.
        surface_ghosts, bottom_ghosts: echoes by way of the sea surface, and of the bottom, as mirrors.
        second_time_around: echoes of the ping before, from behind the range at which the next one is sent.
        cross_talk_db: direct sound of other sonars of the vehicle whose bands overlap, beside that on their axis: -40 for two side lobes of -20 dB
            (a model); without it they are not heard.
        tvg_spreading, tvg_limit_db: k of the time-varied gain k lg r + 2 alpha r, and the most that it gives.
        floor_db: level (dB re 1 uPa after time-varied gain and gain) of count 0.
        dynamic_range_db: of the 255 counts.
        gain_db: at the start.
        assumed_sound_speed_mps: what the device believes; default: the truth.
        overhead_s: between the end of a ping and the next one.
        processing_s: from the last echo to the delivery of the picture, as a device needs for its beams; in real time no more is there to compute it.
    """

    ideal: bool = False
    output: Literal["counts", "pressure", "complex"] = "counts"
    beams: Annotated[int, Meta(ge=2, le=1024)] = 256
    bins: Annotated[int, Meta(ge=8, le=2048)] = 512
    field_deg: Annotated[float, Meta(gt=0, le=170)] = 130.0
    frequency_hz: Positive = 750e3
    bandwidth_hz: Positive = 1e5
    pulse_s: Positive = 1e-4
    beam_width_horizontal_deg: Annotated[float, Meta(ge=0.05, le=60)] = 1.0
    beam_width_vertical_deg: Annotated[float, Meta(gt=0, le=80)] = 20.0
    taper: Taper = "hamming"
    gain_sigma_db: Annotated[float, Meta(ge=0, le=20)] = 0.5
    rays_vertical: Annotated[int, Meta(ge=8, le=1024)] = 128
    range_m: Positive = 30.0
    min_range_m: Positive = 0.5
    max_range_m: Positive = 120.0
    mode: str = ""
    modes: dict[Name, MultibeamMode] = msgspec.field(default_factory=dict)
    source_level_db: float = 205.0
    noise_level_db: float = 42.0
    volume_backscatter_db: float | UnsetType = UNSET
    surface_ghosts: bool = False
    bottom_ghosts: bool = False
    second_time_around: bool = False
    cross_talk_db: Annotated[float, Meta(ge=-200, le=0)] | UnsetType = UNSET
    tvg_spreading: NonNegative = 30.0
    tvg_limit_db: NonNegative = 80.0
    floor_db: float = 108.0
    dynamic_range_db: Positive = 60.0
    gain_db: Annotated[float, Meta(ge=-60, le=60)] = 0.0
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    overhead_s: NonNegative = 0.005
    processing_s: NonNegative = 0.06

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        if len(self.modes) > _MOST_MODES:
            raise ValueError(f"{len(self.modes)} modes are more than {_MOST_MODES}")
        if self.mode not in self.names:
            raise ValueError(f'no mode "{self.mode}", there are: {", ".join(self.modes) or "none"}')
        for name in self.names:
            table, where = self.in_mode(name), f" in mode {name}" if name else ""
            keys = "wider beams, a smaller field or fewer rays_vertical"
            check_size(table.columns, table.rays_vertical, table.beams, keys, where)
        now = self.in_mode(self.mode)
        if not now.min_range_m <= self.range_m <= now.max_range_m:
            raise ValueError("range_m must lie between min_range_m and max_range_m, of its mode where there are some")

    @property
    def names(self) -> tuple[str, ...]:
        """Of the modes; "" alone where there are none."""
        return tuple(self.modes) or ("",)

    @property
    def columns(self) -> int:
        """Of rays."""
        return columns_of(rad(self.field_deg), rad(self.beam_width_horizontal_deg))

    @property
    def cores(self) -> float:
        """About the part of one core that its pictures take in real time, as it starts."""
        table = self.in_mode(self.mode)
        pings = min(self.rate_hz, 1.0 / (2.0 * self.range_m / 1500.0 + self.overhead_s))
        return pings * cost(table.columns, table.rays_vertical, table.beams, table.bins)

    def in_mode(self, name: str) -> MultibeamConfig:
        """The table with what a mode changes, and without modes."""
        if not name:
            return self
        given = {key: value for key, value in structs.asdict(self.modes[name]).items() if value is not UNSET}
        low, high = (given.get(key, getattr(self, key)) for key in ("min_range_m", "max_range_m"))
        return structs.replace(self, mode="", modes={}, **given, range_m=min(max(self.range_m, low), high))

    def build(self, mount: Pose) -> Multibeam:
        return Multibeam(mount, self)


class MultibeamSettings(Settings, frozen=True):
    """See `MultibeamConfig`."""

    range: Distance
    gain: Gain
    mode: Annotated[str, Meta(max_length=64)] = ""


class MultibeamMemory(Memory):
    """Attributes:
    ready: time of the next ping, s."""

    ready: Time = 0.0


class _Head(NamedTuple):
    """A mode of the device, made ready.

    Attributes:
        table: keys of the mode.
        swath, echoes: of it.
        pulse: its sound.
        absorption: of its frequency.
        fade: motion (m) and turn (rad) that leave a speckle correlation of 1 / e.
        azimuth: the field of this name.
    """

    table: MultibeamConfig
    swath: Swath
    echoes: Echoes
    pulse: Pulse
    absorption: Absorption
    fade: tuple[float, float]
    azimuth: Buffer

    @classmethod
    def of(cls, table: MultibeamConfig) -> _Head:
        width = rad(table.beam_width_horizontal_deg)
        swath = Swath(
            rad(table.field_deg), width, rad(table.beam_width_vertical_deg), table.beams, table.rays_vertical, table.taper
        )  # fmt: skip
        pulse = Pulse(table.source_level_db, table.pulse_s, table.bandwidth_hz, table.noise_level_db)
        fade = 0.5 * swath.aperture * 1500.0 / table.frequency_hz, 0.8 * width
        azimuth = Buffer.of(swath.azimuth.astype(np.float32))
        return cls(table, swath, Echoes(swath, table.bins), pulse, Absorption(table.frequency_hz), fade, azimuth)


class _Ping(NamedTuple):
    """What a job knows. Poses: rotations in N at the start, and at the end where it differs."""

    head: _Head
    scope: Scope
    p: Vec3
    poses: tuple[FloatArray, ...]
    ranges: Ranges
    water: Water
    paths: Paths
    noise: Noise | None
    beam_gain: FloatArray
    level: FloatArray


class PingJob(Job):
    """The picture of a ping."""

    def __init__(self, ping: _Ping) -> None:
        self._ping = ping

    def run(self) -> tuple[Value, ...]:
        """Azimuths and picture."""
        ping = self._ping
        table = ping.head.table
        sound = hear(ping.head.swath, self._energy(), ping.ranges, ping.noise)[:, :, : table.bins]
        if ping.noise is None:  # an amplitude of the same intensity, of phase 0
            sound = np.concatenate([np.sqrt(sound), np.zeros_like(sound)])
        if table.output == "complex":
            factor = (_MILLION * np.sqrt(ping.beam_gain)).astype(np.float32)
            picture: Plane = np.ascontiguousarray((sound * factor[None, :, None]).transpose(2, 1, 0))
            return ping.head.azimuth, Buffer.of(picture)
        intensity = np.empty((table.bins, table.beams), np.float32)
        columns.intensities(sound, ping.beam_gain.astype(np.float32), intensity)
        if table.output == "pressure":
            return ping.head.azimuth, Buffer.of(np.float32(_MILLION) * np.sqrt(intensity))
        image = np.empty(intensity.shape, np.uint8)
        columns.counts(intensity, ping.level, _FULL_SCALE / table.dynamic_range_db, columns.LOGARITHMS, image)
        return ping.head.azimuth, Buffer.of(image)

    def _energy(self) -> FloatArray:
        ping = self._ping
        each = [
            ping.head.echoes.energy(ping.scope.geometry, ping.water, ping.p, R, ping.ranges, ping.paths)
            for R in ping.poses
        ]
        if len(each) == 1:
            return each[0]
        passed = (np.arange(each[0].shape[1]) + 0.5) / each[0].shape[1]  # of the ping, when each gate is heard
        blended: FloatArray = (1.0 - passed) * each[0] + passed * each[1]
        return blended


class Multibeam(Sonar):
    """One picture a ping."""

    doc = "Imaging sonar: echoes over range and azimuth of one ping, from the pose at its start, delivered when the device has its beams."
    takes_time = True
    paces = True
    settings: MultibeamSettings
    memory: MultibeamMemory

    def __init__(self, mount: Pose, config: MultibeamConfig) -> None:
        self._mount, self._config = mount, config
        self._heads = {name: _Head.of(config.in_mode(name)) for name in config.names}
        bins, beams = config.bins, config.beams
        unit, what, layout = {
            "counts": ("1", "counts of each range (rows, nearest first) and beam", Layout("uint8", (bins, beams))),
            "pressure": ("Pa", "amplitude of the echo by range and beam", Layout("float32", (bins, beams))),
            "complex": ("Pa", "real and imaginary part of it", Layout("float32", (bins, beams, 2))),
        }[config.output]
        self.fields = (
            Field("range_start", "m", "distance at the start of the first row"),
            Field("range", "m", "distance at the end of the last row"),
            Field("gain", "dB", "gain of this ping"),
            Field("frequency", "Hz", "of this ping"),
            Field("sound_speed", "m/s", "by which the device makes ranges of times"),
            Field("azimuth", "rad", "of each beam, from x towards y of the sensor", type="buffer", buffer=Layout("float32", (beams,))),
            Field("image", unit, what, type="buffer", buffer=layout),
        )  # fmt: skip
        self.arguments = self._arguments(config)
        super().__init__(MultibeamSettings(config.range_m, config.gain_db, config.mode))

    @staticmethod
    def _arguments(config: MultibeamConfig) -> tuple[Argument, ...]:
        tables = [config.in_mode(name) for name in config.names]
        low, high = min(table.min_range_m for table in tables), max(table.max_range_m for table in tables)
        arguments = (
            Argument("range", "float", "distance at the end of the last row", "m", False, minimum=low, maximum=high),
            Argument("gain", "float", "added to the level before compression", "dB", False, minimum=-60, maximum=60),
        )
        if not config.modes:
            return arguments
        return *arguments, Argument("mode", "str", "of the device", required=False, choices=tuple(config.modes))

    def load_kernels(self) -> None:
        load_kernels()
        load_pictures()

    def turn_on(self) -> MultibeamMemory:
        """Ready at once; draws the gains of the beams."""
        sigma = 0.0 if self._config.ideal else self._config.gain_sigma_db
        self._beam_gain: FloatArray = 10.0 ** (0.1 * sigma * self.rng.standard_normal(self._config.beams))
        return MultibeamMemory()

    def check(self, settings: Settings) -> None:
        """The range is one of the mode."""
        assert isinstance(settings, MultibeamSettings)
        if settings.mode not in self._heads:
            raise out_of_range("mode", f'no mode "{settings.mode}", there are: {", ".join(self._heads) or "none"}')
        table = self._heads[settings.mode].table
        if not table.min_range_m <= settings.range <= table.max_range_m:
            text = (
                f"the range of this mode is {table.min_range_m:g} to {table.max_range_m:g} m, not {settings.range:g} m"
            )
            raise out_of_range("range", text)

    def voice(self, c: float) -> Voice:
        """As others hear it, where the sound speed is c (m/s)."""
        head, ready = self._heads[self.settings.mode], self.memory.ready
        busy = 2.0 * self.settings.range / believed_speed(self._config, c) + self._config.overhead_s
        frequency, (level, length, bandwidth, _) = head.table.frequency_hz, head.pulse
        return Voice(self._mount.p, frequency, bandwidth, level, length, ready, busy, self.dt)

    def begins(self, t: float) -> bool:
        """Whether the last ping is over."""
        return t >= self.memory.ready - 1e-6

    def sense(self, scope: Scope) -> Measurement | None:
        """A ping; None while the last one is not over."""
        if not self.begins(scope.t):
            return None
        head, reach = self._heads[self.settings.mode], self.settings.range
        p = scope.position(self._mount.p)
        c = scope.water.sound_speed(p[2])
        believed = believed_speed(self._config, c)
        duration = 2.0 * reach / believed
        self.memory.ready = scope.t + duration + self._config.overhead_s
        values: list[Value] = [0.0, reach, self.settings.gain, head.table.frequency_hz, believed, None, None]
        delay = round((duration + self._config.processing_s) * NANOSECONDS)
        height = scope.submergence(p)
        if height <= 0.0:
            return Measurement(values, False, delay_ns=delay)
        alpha = head.absorption.at(scope, p[2])
        level = gain_over_range(
            reach, head.table.bins, head.table.tvg_spreading, alpha, head.table.tvg_limit_db
        ) + (self.settings.gain - head.table.floor_db)  # fmt: skip
        scattering = head.table.volume_backscatter_db
        water = Water(alpha, 0.0 if scattering is UNSET else 10.0 ** (0.1 * scattering), height, scope.lambert)
        interval = max(self.dt, duration + self._config.overhead_s)
        again = 0.5 * c * interval if head.table.second_time_around else 0.0
        paths = Paths(head.table.surface_ghosts, head.table.bottom_ghosts, again)
        poses = self._poses(scope, duration, rad(head.table.beam_width_horizontal_deg))
        divided = ranges(reach, head.table.bins, c, believed / c, head.pulse)
        noise = self._noise(head, p, poses[0][:, 0])
        if noise is not None:
            noise = noise._replace(bursts=self.overhear(scope, divided.gates, c, head.table.cross_talk_db))
        still = scope.still(with_vehicles=False)
        ping = _Ping(head, still, p, poses, divided, water, paths, noise, self._beam_gain, level)
        return Begun(values, True, delay_ns=delay, job=PingJob(ping))

    def _poses(self, scope: Scope, duration: float, width: float) -> tuple[FloatArray, ...]:
        """Attitude at the start, and at the end where the sonar turns meanwhile."""
        attitudes: list[Quat] = [scope.attitude(self._mount.q)]
        if math.hypot(*scope.w_NB_B) * duration > _STILL * width:
            _, q_NB = earlier(scope.p_NB, scope.q_NB, (*scope.v_NB_B, *scope.w_NB_B), -duration)
            attitudes.append(multiply(q_NB, self._mount.q))
        return tuple(np.array(matrix(q)) for q in attitudes)

    def _noise(self, head: _Head, p: Vec3, axis: FloatArray) -> Noise | None:
        number = int(self.rng.integers(1 << 63))
        if self._config.ideal:
            return None
        faded, share = speckle.fading(p, axis, *head.fade)
        return Noise(self.draws.key, number, faded, share)
