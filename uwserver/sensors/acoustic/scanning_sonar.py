"""Mechanically scanned imaging sonar: a fan of rays that turns in steps around the sensor's z. Each step is one ping, from its own pose.

In compiled functions `head` is the row of the sonar in `compiled.HEAD`, `row` its record, and `surroundings` what it sees.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, get_args

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.frames import Vec3
from uwserver.modifiers.columns import NO_INT
from uwserver.modifiers.operations import rounded_ns
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.physics.rays.raycast import no_hits
from uwserver.ports import Buffer, FanView, Field, Value
from uwserver.ports.buffer import Layout
from uwserver.sensors.acoustic.cross_talk import (
    CompiledSonar,
    SonarTable,
    assumed_speed,
    overheard,
    ping_arguments,
    sound_speed,
    tell_pace,
)
from uwserver.sensors.acoustic.echo import fill_row, is_busy
from uwserver.sensors.acoustic.head import HeadMemory, HeadSettings, axes, head_arguments, step_on
from uwserver.sensors.acoustic.imaging.blocks import Block, block_of, cast_fan, hit_surface, keep, kept, part_of, turn
from uwserver.sensors.acoustic.imaging.echoes import deposit, energies, gates
from uwserver.sensors.acoustic.imaging.fan import CELL, FLANKS, Fan, directivity
from uwserver.sensors.acoustic.imaging.silhouettes import CUT, room_for, sharpen
from uwserver.sensors.acoustic.imaging.speckle import DIRECTIONS, compress, detect, detect_mean, fade, scatter
from uwserver.sensors.acoustic.pinging import fade_of
from uwserver.sensors.acoustic.receiver import BEYOND, Output
from uwserver.sensors.base import BYTES_OF_BIN, Pose, Traits
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
    aim_loop,
    ground_of,
    p_NS,
    q_NS,
    ray_loop,
    record,
    sound_absorption,
    submergence,
)
from uwserver.sensors.voices import add_burst
from uwserver.table import NonNegative, Positive
from uwserver.units import rad

COUNTS, PRESSURE, COMPLEX = range(3)
"""Values of `output` in a record: what the bins are."""
FULL_SCALE = 255.0

_gates, _fade = compiled(gates), compiled(fade.py_func)
ANGLE, RANGE, GAIN, BINS = range(4)
"""Places where the fields of a reading begin."""


@compiled
def farthest(row: Any, stretch: float) -> float:
    """Return how far rays reach, m; `stretch`: believed over true sound speed."""
    return float(BEYOND * row.reach / min(stretch, 1.0))


@compiled
def _energy(
    row: Any, surroundings: Array, R: Array, alpha: float, divided: Any, finer: Array, hits: Any, out: Array
) -> None:
    """Find the mean intensity of the echoes in each gate, uPa^2.

    Args:
        row, surroundings: those of the sonar.
        R: (3, 3) whose columns are the axes of its head in N.
        alpha: absorption, dB/m.
        divided: gates of the ping.
        finer, hits: directions (n, 3) of the finer rays, and what they hit; what the rays of the fan hit is kept in the block.
        out: (gates) receives the intensities.
    """
    block, ground, second = block_of(row), ground_of(surroundings), np.zeros((1, divided.total + 3))
    met, column = kept(block), np.zeros(max(len(block.cells), len(finer)), np.int64)
    deposit(
        block.cells, block.towards, R, met.distance, met.normal, met.body, met.material, ground, divided.per_metre, column, 0.0, 1.0, second
    )  # fmt: skip
    if len(finer) > 0:
        cells = block.finer[: len(finer)]
        deposit(
            cells, finer, R, hits.distance, hits.normal, hits.body, hits.material, ground, divided.per_metre, column, 0.0, 1.0, second
        )  # fmt: skip
    energies(second[0], divided.per_metre, alpha, out)


@compiled
def _receive(
    head: Any, row: Any, surroundings: Array, t: float, p: Vec3, R: Array, c: float, divided: Any, energy: Array, sound: Array
) -> None:  # fmt: skip
    """Find the strongest sample of the matched filter in each bin; without errors its mean, with phase 0.

    Args:
        head, row, surroundings, t: those of the sonar; t in s.
        p, R: position of its head in N, m, and (3, 3) whose columns are its axes.
        c: sound speed, m/s.
        divided: gates of the ping.
        energy: (gates) mean intensity of the echoes, uPa^2.
        sound: (bins, 2) receives real and imaginary part, uPa.
    """
    if head.exact != 0:
        mean = np.empty(row.bins)
        detect_mean(energy, divided.window, divided.per_bin, mean)
        for k in range(row.bins):
            sound[k, 0], sound[k, 1] = math.sqrt(mean[k]), 0.0
        return
    block, field, axis = block_of(row), np.empty((divided.total, 2)), (R[0, 0], R[1, 0], R[2, 0])
    faded, share = np.empty(DIRECTIONS, np.int64), np.empty(DIRECTIONS)
    _fade(p, axis, row.fade_length, row.fade_angle, block.ways, faded, share)
    noise = row.noise * row.noise / divided.window
    scatter(energy, head.key, head.number, noise, faded, share, block.phasors, field)
    if row.hears != 0:
        bursts = overheard(head, surroundings, t, c, row.relative, divided)
        for k in range(len(bursts)):
            add_burst(bursts[k], 0, head.key, head.number, divided.window, field[:, 0], field[:, 1])
    detect(field, divided.window, divided.per_bin, sound)


@compiled
def _write_bins(row: Any, alpha: float, sound: Array, out: Array) -> None:
    """Write the bins of a reading (bins) as counts or pressure. Complex bins are a buffer, which Python makes."""
    if row.output == COMPLEX:
        return
    intensity = sound[:, 0] * sound[:, 0] + sound[:, 1] * sound[:, 1]
    if row.output == PRESSURE:
        out[:] = 1e-6 * np.sqrt(intensity)
        return
    counts = out.view(np.int64)
    compress(
        intensity, row.reach / row.bins, row.spreading, alpha, row.most_gain, row.gain - row.floor, row.steps, FULL_SCALE, counts
    )  # fmt: skip


@compiled
def _write_paper_bins(row: Any, out: Array) -> None:
    """Write the bins of the model in the paper (UW-MORSE, section IV-B): the sum of the cosines of incidence of the rays that hit within each bin.

    It is divided by the number of rays, so it is 1 if all of them hit at right angles.
    """
    block = block_of(row)
    hits, picture, per_metre = kept(block), np.zeros(row.bins), row.bins / row.reach
    for i in range(len(hits.distance)):
        if hits.distance[i] <= row.reach:
            cosine = 0.0
            for j in range(3):
                cosine += hits.normal[i, j] * block.towards[i, j]
            picture[min(int(hits.distance[i] * per_metre), row.bins - 1)] += abs(cosine)
    counts = out.view(np.int64)
    for k in range(row.bins):
        share = picture[k] / len(hits.distance)
        if row.output == COUNTS:
            counts[k] = int(np.rint(FULL_SCALE * share))
        else:
            out[k] = share


@compiled
def hear(
    head: Any, row: Any, surroundings: Array, t: float, direction: Array, hits: Any, sound: Array, out: Array
) -> None:
    """Make the bins of a ping under water.

    Args:
        head, row, surroundings, t: those of the sonar; t in s.
        direction, hits: directions (n, 3) of the finer rays, and what they hit; what the rays of the fan hit is kept in the block.
        sound: (bins, 2) receives real and imaginary part of each bin, uPa; not used by the model of the paper.
        out: (bins) receives counts or pressure.
    """
    if row.paper != 0:
        _write_paper_bins(row, out)
        return
    p, R = p_NS(head, surroundings), np.empty((3, 3))
    c, believed = sound_speed(head, row, surroundings, p[2])
    # Absorption changes so little that an instrument asks for it once a metre.
    alpha, stretch = sound_absorption(surroundings, row.frequency, np.rint(p[2])), believed / c
    divided = _gates(row.reach, row.bins, c / (2.0 * row.bandwidth), stretch)
    hit_surface(submergence(surroundings, p, t), direction, farthest(row, stretch), hits)
    axes(q_NS(head, surroundings), row.angle, R)
    energy = np.empty(divided.total)
    _energy(row, surroundings, R, alpha, divided, direction, hits, energy)
    _receive(head, row, surroundings, t, p, R, c, divided, energy, sound)
    _write_bins(row, alpha, sound, out)


class ScanningSonarConfig(SonarTable, tag="scanning_sonar", kw_only=True, frozen=True):
    """A scanning sonar. The head turns around the sensor's z, from x towards y.

    Attributes:
        model: the sonar equation; or the model of the paper, the plain dot product of each ray with the normal of what it hits, without errors.
        output: 8-bit counts on a logarithmic scale; the sound pressure (amplitude, Pa) before compression; or, with the sonar equation, real and
            imaginary part of the strongest sample in each bin.
        beam_width_horizontal_deg, beam_width_vertical_deg: between half-power points.
        rays_horizontal, rays_vertical: number of rays of the fan.
        step_deg: angle of the head from ping to ping.
        sector_center_deg, sector_width_deg: the sector that the head covers, to and fro; without a width it rotates continuously.
        tvg_spreading, tvg_limit_db: k of the time-varied gain k lg r + 2 alpha r, and its upper limit.
        floor_db: level (dB re 1 uPa after time-varied gain and gain) of count 0.
        dynamic_range_db: range of the 255 counts.
        gain_db: gain at the start.
    """

    message = "SonarPing"
    model: Literal["sonar_equation", "paper"] = "sonar_equation"
    output: Output = "counts"
    frequency_hz: Positive = 7e5
    bandwidth_hz: Positive = 1e5
    beam_width_horizontal_deg: Annotated[float, Meta(gt=0, le=60)] = 3.0
    beam_width_vertical_deg: Annotated[float, Meta(gt=0, le=80)] = 30.0
    rays_horizontal: Annotated[int, Meta(ge=1, le=200)] = 13
    rays_vertical: Annotated[int, Meta(ge=1, le=1000)] = 71
    bins: Annotated[int, Meta(ge=8, le=4096)] = 400
    range_m: Positive = 30.0
    max_range_m: Positive = 75.0
    step_deg: Annotated[float, Meta(gt=0, le=30)] = 1.8
    sector_center_deg: float = 0.0
    sector_width_deg: Positive | UnsetType = UNSET
    source_level_db: float = 200.0
    tvg_spreading: NonNegative = 30.0
    tvg_limit_db: NonNegative = 60.0
    floor_db: float = 120.0
    dynamic_range_db: Positive = 80.0
    gain_db: Annotated[float, Meta(ge=-60, le=60)] = 0.0
    overhead_s: NonNegative = 0.01

    def __post_init__(self) -> None:
        """Raise ValueError if keys contradict each other."""
        super().__post_init__()
        if self.model == "paper" and self.output == "complex":
            raise ValueError('model "paper" knows no phase: output "complex" needs model "sonar_equation"')
        if self.sector_width_deg is not UNSET and rad(self.sector_width_deg) > 2.0 * math.pi:
            raise ValueError("sector_width_deg is more than a full turn: leave it out for continuous rotation")

    def traits(self) -> Traits:
        """Return its stages of compiled code, the sector over which its head turns, and the size of a ping."""
        centre = rad(self.sector_center_deg)
        half = math.pi if isinstance(self.sector_width_deg, UnsetType) else 0.5 * rad(self.sector_width_deg)
        fan = FanView(
            rad(self.beam_width_horizontal_deg), rad(self.beam_width_vertical_deg), rad(self.step_deg),
            (centre - half, centre + half), self.bins, self.min_range_m, self.range_m,
        )  # fmt: skip
        return Traits(("sonars",), fan=fan, picture_bytes=BYTES_OF_BIN * self.bins)

    def build(self, mount: Pose) -> ScanningSonar:
        return ScanningSonar(mount, self)


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
    head: Any, row: Any, surroundings: Array, t: float, origin: Array, direction: Array, count: int
) -> tuple[int, float]:  # fmt: skip
    """Turn the head, and lay the rays of the fan if the sonar is under water; nothing while the last ping is not over."""
    if is_busy(head, row, t):
        return count, 0.0
    row.angle, row.m.index, row.m.sense = step_on(row.step, row.center, row.width, row.m.index, row.m.sense)
    p, row.wet = p_NS(head, surroundings), 0
    if submergence(surroundings, p, t) <= 0.0:
        return count, 0.0
    row.wet, begin, block, R = 1, count, block_of(row), np.empty((3, 3))
    axes(q_NS(head, surroundings), row.angle, R)
    count = cast_fan(block.direction, R, p, count, origin, direction)
    block.towards[:] = direction[begin:count]
    c, believed = sound_speed(head, row, surroundings, p[2])
    return count, farthest(row, believed / c)


@entry
def refine(
    heads: Array, rows: Array, numbers: Array, due: Array, surroundings: Array, t: float, origin: Array, direction: Array, first: Array, hits: Any
) -> float:  # fmt: skip
    """Lay finer rays where those of a fan have hit something thin. What the fan has hit is kept in the block of its sonar."""
    count, begin, reach, R = 0, first[0], 0.0, np.empty((3, 3))
    for n, k in enumerate(due):
        end, head = first[n + 1], heads[k]
        first[n] = count
        if end > begin:
            row, p = rows[head.row], p_NS(head, surroundings)
            block, mine, (c, believed) = (
                block_of(row),
                part_of(hits, begin, end),
                sound_speed(head, row, surroundings, p[2]),
            )
            limit = farthest(row, believed / c)
            hit_surface(submergence(surroundings, p, t), block.towards, limit, mine)
            met = keep(mine, block)
            if row.paper == 0:
                axes(q_NS(head, surroundings), row.angle, R)
                # This overwrites directions of fans whose sonars come later. Their blocks have copies.
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
    """Write the bins of a ping in the air: missing values."""
    sound[:] = MISSING
    if row.output == COUNTS:
        bins.view(np.int64)[:] = NO_INT
    else:
        bins[:] = MISSING


@compiled
def measure(
    head: Any, row: Any, surroundings: Array, t: float, out: Array, direction: Array, begin: int, end: int, hits: Any
) -> None:  # fmt: skip
    """Read the echoes of a ping; without values in the air."""
    out[ANGLE], out[RANGE], out[GAIN] = row.angle, row.reach, row.gain
    place = head.shadow * row.bins
    sound, bins, head.valid = block_of(row).sound[place : place + row.bins], out[BINS:], row.wet
    if row.wet != 0:
        hear(head, row, surroundings, t, direction[begin:end], part_of(hits, begin, end), sound, bins)
    else:
        _hear_nothing(row, sound, bins)
    _, believed = sound_speed(head, row, surroundings, p_NS(head, surroundings)[2])
    duration = 2.0 * row.reach / believed
    row.m.ready = t + duration + row.overhead
    tell_pace(head, surroundings, row.m.ready)
    head.delay_ns = rounded_ns(duration)


class ScanningSonar(CompiledSonar):
    """Gives one row of a sonar picture a ping."""

    doc = "Scanning sonar: the echoes of one ping over range, and where the head pointed; each ping from the pose at its start."
    kernel = SensorKernel(_RECORD, ray_loop(measure), (aim_loop(aim), refine), acts=True)
    random = ("noise",)
    memory_type = HeadMemory
    settings: HeadSettings

    def __init__(self, mount: Pose, config: ScanningSonarConfig) -> None:
        self._config = self.table = config
        self._width, self._height = rad(config.beam_width_horizontal_deg), rad(config.beam_width_vertical_deg)
        self._noise = (
            10.0 ** (0.1 * config.noise_level_db) * config.bandwidth_hz / directivity(self._width, self._height)
        )
        self._block, n = self._lay_out(), config.rays_horizontal * config.rays_vertical
        self.rays = n if config.model == "paper" else max(n, room_for(n))
        self.exact, self.sees_own = config.ideal, config.sees_own_vehicle
        self.fields, self.arguments = _fields(config), (*ping_arguments(config), *head_arguments(1e-3))
        step, middle = rad(config.step_deg), rad(config.sector_center_deg)
        sector = 2.0 * math.pi if config.sector_width_deg is UNSET else rad(config.sector_width_deg)
        super().__init__(mount, HeadSettings(config.range_m, config.gain_db, step, middle, sector))

    def _lay_out(self) -> Block:
        """Return the block of arrays that its rays need."""
        config, is_paper = self._config, self._config.model == "paper"
        level = 10.0 ** (0.1 * config.source_level_db) * max(1.0, config.bandwidth_hz * config.pulse_s)
        columns, rows, cover = config.rays_horizontal, config.rays_vertical, 1.0 if is_paper else FLANKS
        fan, n = Fan(self._width, self._height, columns, rows, cover, level, not is_paper), columns * rows
        return Block(
            cells=fan.cells, direction=fan.direction, towards=np.empty((n, 3)), **no_hits(n)._asdict(), place=fan.place, area=fan.area,
            across_power=fan.across_power, along_power=fan.along_power, cuts=np.zeros(n, CUT), finer=np.zeros(room_for(n), CELL),
            sound=np.empty((2 * config.bins, 2)),
        )  # fmt: skip

    def fill(self, row: Any) -> None:
        c, s = self._config, self.settings
        row["fade_length"], row["fade_angle"] = fade_of(self._width, c.frequency_hz)
        fill_row(
            row, block=self._block.address, bins=c.bins, output=get_args(Output).index(c.output), columns=c.rays_horizontal,
            rows=c.rays_vertical, paper=c.model == "paper", reach=s.range, gain=s.gain, step=s.step, center=s.sector_center,
            width=s.sector_width, frequency=c.frequency_hz, bandwidth=c.bandwidth_hz, overhead=c.overhead_s,
            speed=assumed_speed(c), noise=math.sqrt(self._noise), hears=c.cross_talk_db is not UNSET,
            relative=0.0 if c.cross_talk_db is UNSET else c.cross_talk_db, spreading=c.tvg_spreading,
            most_gain=c.tvg_limit_db, floor=c.floor_db, steps=FULL_SCALE / c.dynamic_range_db,
        )  # fmt: skip

    def turn_on_row(self, memory: Any) -> None:
        """Make the sonar ready at once, with its head at the first step."""
        memory["sense"] = 1

    def loose(self, *, exactly: bool) -> tuple[Value, ...]:
        """Return the bins of complex echoes."""
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
