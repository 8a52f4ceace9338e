"""Forward-looking multibeam imaging sonar: one ping lights the whole field, and an array forms beams of its echoes."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
from msgspec import UNSET, Meta, UnsetType, structs

from uwserver.modifiers.base import Measurement
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports import Argument, Buffer, FanView, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.cross_talk import believed_speed
from uwserver.sensors.acoustic.echo import check_range
from uwserver.sensors.acoustic.imaging.array import Taper
from uwserver.sensors.acoustic.imaging.fan import Swath, check_size, check_together, columns_of, cost
from uwserver.sensors.acoustic.pinging import (
    Head,
    ImagingTable,
    Instant,
    Lighting,
    PingingSonar,
    PingMemory,
    PingSettings,
)
from uwserver.sensors.acoustic.receiver import Echoes, Paths, hear, picture_of
from uwserver.sensors.base import Pose, Scope, Settings, Traits, out_of_range
from uwserver.table import Name, NonNegative, Positive, Table
from uwserver.units import rad

_FULL_SCALE = 255.0
_MOST_MODES = 8


class MultibeamMode(Table, kw_only=True, frozen=True):
    """The keys that a mode of a multibeam sonar changes. All other keys stay as in its table.

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


class MultibeamConfig(ImagingTable, tag="multibeam", kw_only=True, frozen=True):
    """A forward-looking multibeam sonar; x ahead, azimuth from x towards y.

    Attributes:
        ideal: mean level without speckle, noise and gain errors, at the true sound speed.
        beams: number of beams in the picture, at equal angles.
        field_deg: angle that the beams cover.
        beam_width_horizontal_deg: width of a beam ahead, between half-power points; to the side it is wider, as with any array.
        beam_width_vertical_deg: between half-power points, of transmitter and receiver each.
        taper: taper of the array: side lobes of -13.3 dB (none), -23 dB (cosine) or -42.7 dB (hamming).
        gain_sigma_db: standard deviation of the beams' gains, which are drawn once a run.
        rays_vertical: rays in each column; six for each degree of the beam's height are enough.
        mode: name of the mode at the start, one of `modes`; "" without modes.
        modes: by name, such as "low" and "high".
        surface_ghosts, bottom_ghosts: echoes by way of the sea surface, and of the bottom, which act as mirrors.
        second_time_around: echoes of the ping before, from behind the range at which the next one is sent.
    """

    message = "SonarImage"
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
    floor_db: float = 108.0
    processing_s: NonNegative = 0.06

    def __post_init__(self) -> None:
        """Raise ValueError if keys contradict each other."""
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
        """Return the names of the modes; "" alone without modes."""
        return tuple(self.modes) or ("",)

    @property
    def columns(self) -> int:
        """Return the number of columns of rays."""
        return columns_of(rad(self.field_deg), rad(self.beam_width_horizontal_deg))

    @property
    def computing_s(self) -> float:
        """Return about the processor time of a picture in the initial mode, s."""
        table = self.in_mode(self.mode)
        return cost(table.columns, table.rays_vertical, table.beams, table.bins)

    def in_mode(self, name: str) -> MultibeamConfig:
        """Return the table of a mode, with what the mode changes, and without modes of its own."""
        if not name:
            return self
        given = {key: value for key, value in structs.asdict(self.modes[name]).items() if value is not UNSET}
        low, high = (given.get(key, getattr(self, key)) for key in ("min_range_m", "max_range_m"))
        return structs.replace(self, mode="", modes={}, **given, range_m=min(max(self.range_m, low), high))

    def traits(self) -> Traits:
        """Return what all pinging sonars declare, the sector of the field of view, and the size of a picture."""
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


class Multibeam(PingingSonar):
    """Gives one picture a ping."""

    doc = "Imaging sonar: echoes over range and azimuth of one ping, from the pose at its start, delivered when the device has its beams."
    takes_time = True
    settings: MultibeamSettings

    def __init__(self, mount: Pose, config: MultibeamConfig) -> None:
        self._config = config
        heads = {name: _head(config.in_mode(name)) for name in config.names}
        self._echoes = {name: Echoes(head.lighting.swath, config.bins) for name, head in heads.items()}
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
            Field("sound_speed", "m/s", "with which the device converts times to ranges"),
            Field("azimuth", "rad", "of each beam, from x towards y of the sensor", type="buffer", buffer=Layout("float32", (beams,))),
            Field("image", unit, what, type="buffer", buffer=layout),
        )  # fmt: skip
        low = min(head.table.min_range_m for head in heads.values())
        high = max(head.table.max_range_m for head in heads.values())
        arguments: tuple[Argument, ...] = (
            Argument("range", "float", "distance at the end of the last row", "m", False, minimum=low, maximum=high),
            Argument("gain", "float", "added to the level before compression", "dB", False, minimum=-60, maximum=60),
        )
        if config.modes:
            arguments += (Argument("mode", "str", "of the device", required=False, choices=tuple(config.modes)),)
        super().__init__(mount, heads, arguments, MultibeamSettings(config.range_m, config.gain_db, config.mode))

    @property
    def head(self) -> Head:
        """Return the head of the present mode."""
        return self.heads[self.settings.mode]

    def turn_on(self) -> PingMemory:
        """Draw the gains of the beams, and return the memory of a sonar that may ping at once."""
        sigma = 0.0 if self._config.ideal else self._config.gain_sigma_db
        self._beam_gain: FloatArray = 10.0 ** (0.1 * sigma * self.rng.standard_normal(self._config.beams))
        return PingMemory()

    def check(self, settings: Settings) -> None:
        """Raise Refused if there is no such mode, or if it does not allow the range."""
        assert isinstance(settings, MultibeamSettings)
        if settings.mode not in self.heads:
            raise out_of_range("mode", f'no mode "{settings.mode}", there are: {", ".join(self.heads) or "none"}')
        low, high = self.heads[settings.mode].table.min_range_m, self.heads[settings.mode].table.max_range_m
        if not low <= settings.range <= high:
            raise out_of_range("range", f"the range of this mode is {low:g} to {high:g} m, not {settings.range:g} m")

    def sense(self, scope: Scope) -> Measurement | None:
        """Return a ping; None while the last one is not over."""
        begun = self.ping(scope, 2, self._picture, self.settings, self._beam_gain, self.dt)
        if begun is not None:
            begun.values.insert(0, 0.0)
        return begun

    def _picture(self, instant: Instant, settings: MultibeamSettings, gain: FloatArray, dt: float) -> tuple[Value, ...]:
        """Return azimuths and picture. Runs in another thread, so it uses only constants of self.

        Args:
            instant: instant of the ping.
            settings: settings of the ping.
            gain: (beams) gain of each beam's channel, by intensity.
            dt: time between readings, s.
        """
        mode = settings.mode
        table, swath = self._config.in_mode(mode), self.heads[mode].lighting.swath
        c = instant.scope.water.sound_speed(instant.p[2])
        interval = max(dt, 2.0 * settings.range / believed_speed(table, c) + table.overhead_s)
        again = 0.5 * c * interval if table.second_time_around else 0.0
        energy = instant.energy(self._echoes[mode], Paths(table.surface_ghosts, table.bottom_ghosts, again))
        sound, level = hear(swath, energy, instant.ranges, instant.noise), table.level(settings, instant.water.alpha)
        steps = _FULL_SCALE / table.dynamic_range_db
        azimuth = Buffer.of(swath.azimuth.astype(np.float32))
        return azimuth, Buffer.of(picture_of(sound, gain, level, steps, table.output))


def _head(table: MultibeamConfig) -> Head:
    """Return the head of a mode with this table."""
    width, height = rad(table.beam_width_horizontal_deg), rad(table.beam_width_vertical_deg)
    swath = Swath(rad(table.field_deg), width, height, table.beams, table.rays_vertical, table.taper)
    fade = 0.5 * swath.aperture * 1500.0 / table.frequency_hz, 0.8 * width
    return Head(table, Lighting(swath, np.eye(3), width, fade))
