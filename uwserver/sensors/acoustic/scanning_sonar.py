"""Mechanically scanned imaging sonar: a fan of rays that steps about the sensor's z, one ping a step, each from its own pose."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.modifiers.base import Memory, Time
from uwserver.modifiers.columns import NO_INT
from uwserver.modifiers.operations import rounded_ns
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.rays.raycast import no_hits
from uwserver.ports import Argument, Buffer, FanView, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.cross_talk import BankSonar, assumed_speed, sound_speed, tell_pace
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
from uwserver.sensors.acoustic.imaging.blocks import Block, block_of
from uwserver.sensors.acoustic.imaging.fan import CELL, Fan, directivity
from uwserver.sensors.acoustic.imaging.fan_rays import cast_fan, keep, part_of, see, turn
from uwserver.sensors.acoustic.imaging.silhouettes import CUT, room_for, sharpen
from uwserver.sensors.acoustic.scan import COUNTS, FULL_SCALE, farthest, hear
from uwserver.sensors.bank import MISSING, Bank, aim_loop, p_NS, q_NS, ray_loop, record, submergence
from uwserver.sensors.base import Distance, Gain, Pose, SensorTable, Settings
from uwserver.sensors.traits import BYTES_OF_BIN, Traits
from uwserver.table import NonNegative, Positive
from uwserver.units import rad

_FLANKS = 2.0
"""The rays fill so many beam widths: at their edge the two-way pattern is 36 dB down."""
_OUTPUTS = ("counts", "pressure", "complex")
"""By their numbers in `scan`."""
ANGLE, RANGE, GAIN, BINS = range(4)
"""Where in a reading each field begins."""


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

    message = "SonarPing"
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

    def traits(self) -> Traits:
        """The sector over which its head turns."""
        centre = rad(self.sector_center_deg)
        half = math.pi if isinstance(self.sector_width_deg, UnsetType) else 0.5 * rad(self.sector_width_deg)
        fan = FanView(
            rad(self.beam_width_horizontal_deg), rad(self.beam_width_vertical_deg), rad(self.step_deg),
            (centre - half, centre + half), self.bins, self.min_range_m, self.range_m,
        )  # fmt: skip
        return Traits(("sonars",), fan=fan, picture_bytes=BYTES_OF_BIN * self.bins)

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


_RECORD = record(
    [
        ("block", "i8"), ("columns", "i8"), ("rows", "i8"), ("bins", "i8"), ("paper", "i8"), ("output", "i8"), ("reach", "f8"), ("gain", "f8"),
        ("step", "f8"), ("center", "f8"), ("width", "f8"), ("frequency", "f8"), ("bandwidth", "f8"), ("speed", "f8"), ("overhead", "f8"),
        ("noise", "f8"), ("hears", "i8"), ("relative", "f8"), ("spreading", "f8"), ("most_gain", "f8"), ("floor", "f8"), ("steps", "f8"),
        ("fade_length", "f8"), ("fade_angle", "f8"),
        # Of this ping: where the head points, and whether it is under water.
        ("angle", "f8"), ("wet", "i8"),
    ],
    [("ready", "f8"), ("index", "i8"), ("sense", "i8")],
)  # fmt: skip


@compiled
def aim(
    head: Any, row: Any, now: Array, t: float, origin: Array, direction: Array, count: int
) -> tuple[int, float]:  # fmt: skip
    """The fans; none while the last ping is not over, or in the air."""
    if t < row.m.ready - 1e-6:
        head.ready = 0
        return count, 0.0
    R = np.empty((3, 3))
    row.angle, row.m.index, row.m.sense = step_on(row.step, row.center, row.width, row.m.index, row.m.sense)
    p, row.wet = p_NS(head, now), 0
    if submergence(now, p, t) > 0.0:
        row.wet, begin, block = 1, count, block_of(row)
        axes(q_NS(head, now), row.angle, R)
        count = cast_fan(block.direction, R, p, count, origin, direction)
        block.towards[:] = direction[begin:count]
        c, believed = sound_speed(head, row, now, p[2])
        return count, farthest(row, believed / c)
    return count, 0.0


@entry
def refine(
    heads: Array, rows: Array, numbers: Array, due: Array, now: Array, t: float, origin: Array, direction: Array, first: Array, hits: Any
) -> float:  # fmt: skip
    """More rays where those of a fan have met something thin. What these have met is kept in the block of each."""
    count, begin, reach, R = 0, first[0], 0.0, np.empty((3, 3))
    for n, k in enumerate(due):
        end, head = first[n + 1], heads[k]
        first[n] = count
        if end > begin:
            row, p = rows[head.row], p_NS(head, now)
            block, mine, (c, believed) = block_of(row), part_of(hits, begin, end), sound_speed(head, row, now, p[2])
            limit = farthest(row, believed / c)
            see(submergence(now, p, t), block.towards, limit, mine)
            met = keep(mine, block)
            if row.paper == 0:
                axes(q_NS(head, now), row.angle, R)
                # Directions that lie there are those of other fans, which their blocks keep.
                new = direction[count:]
                made = sharpen(row.columns, row.rows, block, block.towards, met, block.cuts, new, block.finer)
                for i in range(made):
                    turn(R, new[i], new[i])
                    origin[count + i, 0], origin[count + i, 1], origin[count + i, 2] = p
                count += made
                reach = max(reach, limit)
        begin = end
    first[len(due)] = count
    return reach


@compiled
def _hear_nothing(row: Any, sound: Array, bins: Array) -> None:
    """Of a ping in the air."""
    sound[:] = MISSING
    if row.output == COUNTS:
        bins.view(np.int64)[:] = NO_INT
    else:
        bins[:] = MISSING


@compiled
def measure(
    head: Any, row: Any, now: Array, t: float, out: Array, direction: Array, begin: int, end: int, hits: Any
) -> None:  # fmt: skip
    """The echoes of a ping, or noise alone in the air."""
    out[ANGLE], out[RANGE], out[GAIN] = row.angle, row.reach, row.gain
    place = head.shadow * row.bins
    sound, bins, head.valid = block_of(row).sound[place : place + row.bins], out[BINS:], row.wet
    if row.wet != 0:
        hear(head, row, now, t, direction[begin:end], part_of(hits, begin, end), sound, bins)
    else:
        _hear_nothing(row, sound, bins)
    _, believed = sound_speed(head, row, now, p_NS(head, now)[2])
    duration = 2.0 * row.reach / believed
    row.m.ready = t + duration + row.overhead
    tell_pace(head, now, row.m.ready)
    head.delay_ns = rounded_ns(duration)


class ScanningSonar(BankSonar):
    """One row of a sonar picture a ping."""

    doc = "Scanning sonar: the echoes of one ping over range, and where the head pointed; each ping from the pose at its start."
    bank = Bank(_RECORD, ray_loop(measure), (aim_loop(aim), refine), acts=True)
    random = ("noise",)
    memory_type = SonarMemory
    settings: SonarSettings

    def __init__(self, mount: Pose, config: ScanningSonarConfig) -> None:
        self._config = self.table = config
        self._width, self._height = rad(config.beam_width_horizontal_deg), rad(config.beam_width_vertical_deg)
        self._noise = (
            10.0 ** (0.1 * config.noise_level_db) * config.bandwidth_hz / directivity(self._width, self._height)
        )
        self._block, n = self._lay_out(), config.rays_horizontal * config.rays_vertical
        self.rays = n if config.model == "paper" else max(n, room_for(n))
        self.exact, self.sees_own = config.ideal, config.sees_own_vehicle
        self.fields, self.arguments = _fields(config), _arguments(config)
        step, middle = rad(config.step_deg), rad(config.sector_center_deg)
        sector = 2.0 * math.pi if config.sector_width_deg is UNSET else rad(config.sector_width_deg)
        super().__init__(mount, SonarSettings(config.range_m, config.gain_db, step, middle, sector))

    def _lay_out(self) -> Block:
        """What its rays need."""
        config, is_paper = self._config, self._config.model == "paper"
        level = 10.0 ** (0.1 * config.source_level_db) * max(1.0, config.bandwidth_hz * config.pulse_s)
        columns, rows, cover = config.rays_horizontal, config.rays_vertical, 1.0 if is_paper else _FLANKS
        fan, n = Fan(self._width, self._height, columns, rows, cover, level, not is_paper), columns * rows
        return Block(
            cells=fan.cells, direction=fan.direction, towards=np.empty((n, 3)), **no_hits(n)._asdict(), place=fan.place, area=fan.area,
            across_power=fan.across_power, along_power=fan.along_power, cuts=np.zeros(n, CUT), finer=np.zeros(room_for(n), CELL),
            sound=np.empty((2 * config.bins, 2)),
        )  # fmt: skip

    def fill(self, row: Any) -> None:
        c, s = self._config, self.settings
        aperture = 0.886 * 1500.0 / (c.frequency_hz * self._width)
        row["block"], row["bins"], row["output"] = self._block.address, c.bins, _OUTPUTS.index(c.output)
        row["columns"], row["rows"], row["paper"] = c.rays_horizontal, c.rays_vertical, c.model == "paper"
        row["reach"], row["gain"], row["step"] = s.range, s.gain, s.step
        row["center"], row["width"] = s.sector_center, s.sector_width
        row["frequency"], row["bandwidth"], row["overhead"] = c.frequency_hz, c.bandwidth_hz, c.overhead_s
        row["speed"], row["noise"] = assumed_speed(c), math.sqrt(self._noise)
        row["hears"] = c.cross_talk_db is not UNSET
        row["relative"] = 0.0 if c.cross_talk_db is UNSET else c.cross_talk_db
        row["spreading"], row["most_gain"] = c.tvg_spreading, c.tvg_limit_db
        row["floor"], row["steps"] = c.floor_db, FULL_SCALE / c.dynamic_range_db
        row["fade_length"], row["fade_angle"] = 0.5 * aperture, 0.8 * self._width

    def turn_on_row(self, memory: Any) -> None:
        """Ready at once, at the first step."""
        memory["sense"] = 1

    def loose(self, *, exactly: bool) -> tuple[Value, ...]:
        """The bins of complex echoes."""
        if self._config.output != "complex":
            return ()
        sound = self._block.arrays["sound"].reshape(2, self._config.bins, 2)[int(exactly)]
        return (None if np.isnan(sound[0, 0]) else Buffer.of((1e-6 * sound).astype(np.float32)),)


def _fields(config: ScanningSonarConfig) -> tuple[Field, ...]:
    bins = Field("bins", "1", "echo level of each bin, 0 to 255", shape=(config.bins,), type="int")
    if config.output == "pressure":
        bins = Field("bins", "Pa", "amplitude of the echo in each bin", shape=(config.bins,))
    elif config.output == "complex":
        layout = Layout("float32", (config.bins, 2))
        bins = Field("bins", "Pa", "real and imaginary part of the echo in each bin", type="buffer", buffer=layout)
    return (
        Field("head_angle", "rad", "where the beam points, from x towards y of the sensor"),
        Field("range", "m", "distance at the end of the last bin"),
        Field("gain", "dB", "gain of this ping"),
        bins,
    )


def _arguments(config: ScanningSonarConfig) -> tuple[Argument, ...]:
    low, high = config.min_range_m, config.max_range_m
    return (
        Argument("range", "float", "distance at the end of the last bin", "m", False, minimum=low, maximum=high),
        Argument("gain", "float", "added to the level before compression", "dB", False, minimum=-60, maximum=60),
        *head_arguments(1e-3),
    )
