"""Forward-looking multibeam imaging sonar: one ping lights the whole field, and an array makes beams of what comes back."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET, Meta, UnsetType, structs

from uwserver.modifiers.base import Measurement
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Argument, Buffer, FanView, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.cross_talk import believed_speed
from uwserver.sensors.acoustic.imaging import columns
from uwserver.sensors.acoustic.imaging.array import Taper
from uwserver.sensors.acoustic.imaging.swath import Plane, Swath, check_size, check_together, columns_of, cost
from uwserver.sensors.acoustic.pinging import (
    Head,
    Instant,
    Lighting,
    PingingSonar,
    PingMemory,
    PingSettings,
    PingTable,
    check_range,
)
from uwserver.sensors.acoustic.receiver import Echoes, Paths, gain_over_range, hear
from uwserver.sensors.base import Pose, Scope, Settings, Traits, out_of_range
from uwserver.sensors.job import Job
from uwserver.table import Name, NonNegative, Positive, Table
from uwserver.units import rad

_FULL_SCALE = 255.0
_MOST_MODES = 8
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


class MultibeamConfig(PingTable, tag="multibeam", kw_only=True, frozen=True):
    """A forward-looking multibeam sonar; x ahead, azimuth from x towards y. `rate_hz` at most: a ping waits until the last one is over.

    Attributes:
        ideal: mean level without speckle, noise, gain errors and wrong sound speed.
        output: 8-bit counts on a logarithmic scale; the sound pressure (amplitude, Pa); or the same as real and imaginary part.
        beams: of the picture, equal angles apart.
        bins: rows of the picture, equal ranges apart.
        field_deg: angle that the beams cover.
        beam_width_horizontal_deg: between half-power points of a beam ahead; at an angle it is wider, as of any array.
        beam_width_vertical_deg: between half-power points, of transmitter and receiver each.
        taper: of the array: side lobes of -13.3 dB (none), -23 dB (cosine) or -42.7 dB (hamming).
        gain_sigma_db: standard deviation of the beams' gains, which stay as they are in a run.
        rays_vertical: of each column of rays; six for each degree of the beam's height are enough.
        mode: of `modes`, at the start; "" for none.
        modes: by name, as "low" and "high".
        surface_ghosts, bottom_ghosts: echoes by way of the sea surface, and of the bottom, as mirrors.
        second_time_around: echoes of the ping before, from behind the range at which the next one is sent.
        tvg_spreading, tvg_limit_db: k of the time-varied gain k lg r + 2 alpha r, and the most that it gives.
        floor_db: level (dB re 1 uPa after time-varied gain and gain) of count 0.
        dynamic_range_db: of the 255 counts.
        gain_db: at the start.
    """

    message = "SonarImage"
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
    surface_ghosts: bool = False
    bottom_ghosts: bool = False
    second_time_around: bool = False
    tvg_spreading: NonNegative = 30.0
    tvg_limit_db: NonNegative = 80.0
    floor_db: float = 108.0
    dynamic_range_db: Positive = 60.0
    gain_db: Annotated[float, Meta(ge=-60, le=60)] = 0.0
    processing_s: NonNegative = 0.06

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        if len(self.modes) > _MOST_MODES:
            raise ValueError(f"{len(self.modes)} modes are more than {_MOST_MODES}")
        if self.mode not in self.names:
            raise ValueError(f'no mode "{self.mode}", there are: {", ".join(self.modes) or "none"}')
        sizes = []
        for name in self.names:
            table, where = self.in_mode(name), f" in mode {name}" if name else ""
            sizes.append((table.columns, table.rays_vertical, table.beams))
            check_size(*sizes[-1], "wider beams, a smaller field or fewer rays_vertical", where)
        check_together(sizes, "fewer modes, wider beams, smaller fields, fewer beams or fewer rays_vertical")
        now = self.in_mode(self.mode)
        check_range(self.range_m, now.min_range_m, now.max_range_m, f"mode {self.mode}" if self.mode else "the sonar")

    @property
    def names(self) -> tuple[str, ...]:
        """Of the modes; "" alone where there are none."""
        return tuple(self.modes) or ("",)

    @property
    def columns(self) -> int:
        """Of rays."""
        return columns_of(rad(self.field_deg), rad(self.beam_width_horizontal_deg))

    @property
    def computing_s(self) -> float:
        """About the processor time of a picture, as it starts, s."""
        table = self.in_mode(self.mode)
        return cost(table.columns, table.rays_vertical, table.beams, table.bins)

    def in_mode(self, name: str) -> MultibeamConfig:
        """The table with what a mode changes, and without modes."""
        if not name:
            return self
        given = {key: value for key, value in structs.asdict(self.modes[name]).items() if value is not UNSET}
        low, high = (given.get(key, getattr(self, key)) for key in ("min_range_m", "max_range_m"))
        return structs.replace(self, mode="", modes={}, **given, range_m=min(max(self.range_m, low), high))

    def traits(self) -> Traits:
        """The sector that it looks over."""
        half = 0.5 * rad(self.field_deg)
        fan = FanView(
            rad(self.beam_width_horizontal_deg), rad(self.beam_width_vertical_deg), 0.0, (-half, half), self.bins,
            self.min_range_m, self.range_m,
        )  # fmt: skip
        each = {"counts": 1, "pressure": 4, "complex": 8}[self.output]
        return structs.replace(super().traits(), fan=fan, picture_bytes=each * self.bins * self.beams)

    def build(self, mount: Pose) -> Multibeam:
        return Multibeam(mount, self)


class MultibeamSettings(PingSettings, frozen=True):
    """See `MultibeamConfig`."""

    mode: Annotated[str, Meta(max_length=64)] = ""


class _Recording(NamedTuple):
    """What a job knows besides the instant: keys of the mode, rays and beams, the field azimuth, and ways of the sound; gain (beams) of each beam's
    channel, and the level (bins) that is added, dB."""

    table: MultibeamConfig
    swath: Swath
    echoes: Echoes
    azimuth: Buffer
    paths: Paths
    beam_gain: FloatArray
    level: FloatArray


class _Picture(Job):
    """The picture of a ping."""

    def __init__(self, instant: Instant, recording: _Recording) -> None:
        self._instant, self._recording = instant, recording

    def run(self) -> tuple[Value, ...]:
        """Azimuths and picture."""
        instant, (table, swath, echoes, azimuth, paths, gain, level) = self._instant, self._recording
        sound = hear(swath, instant.energy(echoes, paths), instant.ranges, instant.noise)[:, :, : table.bins]
        if instant.noise is None:  # an amplitude of the same intensity, of phase 0
            sound = np.concatenate([np.sqrt(sound), np.zeros_like(sound)])
        if table.output == "complex":
            factor = (_MILLION * np.sqrt(gain)).astype(np.float32)
            picture: Plane = np.ascontiguousarray((sound * factor[None, :, None]).transpose(2, 1, 0))
            return azimuth, Buffer.of(picture)
        intensity = np.empty((table.bins, table.beams), np.float32)
        columns.intensities(sound, gain.astype(np.float32), intensity)
        if table.output == "pressure":
            return azimuth, Buffer.of(np.float32(_MILLION) * np.sqrt(intensity))
        image = np.empty(intensity.shape, np.uint8)
        columns.counts(intensity, level, _FULL_SCALE / table.dynamic_range_db, columns.LOGARITHMS, image)
        return azimuth, Buffer.of(image)


class Multibeam(PingingSonar):
    """One picture a ping."""

    doc = "Imaging sonar: echoes over range and azimuth of one ping, from the pose at its start, delivered when the device has its beams."
    takes_time = True
    settings: MultibeamSettings

    def __init__(self, mount: Pose, config: MultibeamConfig) -> None:
        self._config = config
        self._tables = {name: config.in_mode(name) for name in config.names}
        self._swaths = {name: _swath(table) for name, table in self._tables.items()}
        self._azimuths = {name: Buffer.of(swath.azimuth.astype(np.float32)) for name, swath in self._swaths.items()}
        self._echoes = {name: Echoes(swath, config.bins) for name, swath in self._swaths.items()}
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
        heads = {name: Head.of(table, _lighting(table, self._swaths[name])) for name, table in self._tables.items()}
        super().__init__(mount, config, heads, MultibeamSettings(config.range_m, config.gain_db, config.mode))
        self.arguments = self._arguments(config)

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

    @property
    def head(self) -> Head:
        """Of its mode."""
        return self.heads[self.settings.mode]

    def turn_on(self) -> PingMemory:
        """Ready at once; draws the gains of the beams."""
        sigma = 0.0 if self._config.ideal else self._config.gain_sigma_db
        self._beam_gain: FloatArray = 10.0 ** (0.1 * sigma * self.rng.standard_normal(self._config.beams))
        return PingMemory()

    def check(self, settings: Settings) -> None:
        """The range is one of the mode."""
        assert isinstance(settings, MultibeamSettings)
        if settings.mode not in self._tables:
            raise out_of_range("mode", f'no mode "{settings.mode}", there are: {", ".join(self._tables) or "none"}')
        table = self._tables[settings.mode]
        if not table.min_range_m <= settings.range <= table.max_range_m:
            text = (
                f"the range of this mode is {table.min_range_m:g} to {table.max_range_m:g} m, not {settings.range:g} m"
            )
            raise out_of_range("range", text)

    def sense(self, scope: Scope) -> Measurement | None:
        """A ping; None while the last one is not over."""
        begun = self.ping(scope, 2, self._picture)
        if begun is not None:
            begun.values.insert(0, 0.0)
        return begun

    def _picture(self, instant: Instant) -> Job:
        mode, reach = self.settings.mode, self.settings.range
        table, swath = self._tables[mode], self._swaths[mode]
        level = gain_over_range(
            reach, table.bins, table.tvg_spreading, instant.water.alpha, table.tvg_limit_db
        ) + (self.settings.gain - table.floor_db)  # fmt: skip
        c = instant.scope.water.sound_speed(instant.p[2])
        interval = max(self.dt, 2.0 * reach / believed_speed(table, c) + table.overhead_s)
        again = 0.5 * c * interval if table.second_time_around else 0.0
        paths = Paths(table.surface_ghosts, table.bottom_ghosts, again)
        azimuth = self._azimuths[mode]
        return _Picture(instant, _Recording(table, swath, self._echoes[mode], azimuth, paths, self._beam_gain, level))


def _swath(table: MultibeamConfig) -> Swath:
    width, height = rad(table.beam_width_horizontal_deg), rad(table.beam_width_vertical_deg)
    return Swath(rad(table.field_deg), width, height, table.beams, table.rays_vertical, table.taper)


def _lighting(table: MultibeamConfig, swath: Swath) -> Lighting:
    width = rad(table.beam_width_horizontal_deg)
    return Lighting(swath, np.eye(3), width, (0.5 * swath.aperture * 1500.0 / table.frequency_hz, 0.8 * width))
