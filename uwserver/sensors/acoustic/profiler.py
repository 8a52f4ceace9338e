"""Profiling sonar: a pencil beam, fixed or on a head that steps, and the range of the echo that each ping brings."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import UNSET, Meta, structs

from uwserver.modifiers.operations import rounded_ns
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Argument, FanView, Field
from uwserver.sensors.acoustic import receiver, sounding
from uwserver.sensors.acoustic.cross_talk import BankSonar, assumed_speed, overheard, sound_speed, tell_pace
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
from uwserver.sensors.acoustic.imaging import columns, echoes, soundings, speckle
from uwserver.sensors.acoustic.imaging.blocks import Block, block_of
from uwserver.sensors.acoustic.imaging.fan_rays import cast_fan, part_of, see
from uwserver.sensors.acoustic.imaging.pencil import Pencil
from uwserver.sensors.acoustic.pinging import STILL, PingMemory, PingSettings, PingTable, fade_of, ping_arguments
from uwserver.sensors.acoustic.receiver import BEYOND, Pulse
from uwserver.sensors.bank import (
    MISSING,
    Bank,
    aim_loop,
    ground_of,
    multiply,
    p_NS,
    q_BS,
    q_NB,
    q_NS,
    ray_loop,
    record,
    sound_absorption,
    spin,
    submergence,
    w_NB_B,
)
from uwserver.sensors.base import Pose, Traits
from uwserver.table import NonNegative, Positive
from uwserver.units import rad

MAX_RANGE, GAIN, FREQUENCY, SPEED, ANGLE, RANGE, LEVEL, QUALITY = range(8)
"""Where in a reading each field stands."""


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

    message = "SonarProfile"
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

    def traits(self) -> Traits:
        """The sector over which its head turns."""
        centre, half = rad(self.sector_center_deg), 0.5 * rad(self.sector_width_deg)
        width, sector = rad(self.beam_width_deg), (centre - half, centre + half)
        fan = FanView(width, width, rad(self.step_deg), sector, 1, self.min_range_m, self.range_m)
        return structs.replace(super().traits(), stages=("sonars",), fan=fan)

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


_RECORD = record(
    [
        ("block", "i8"), ("bins", "i8"), ("first", "i8"), ("reach", "f8"), ("gain", "f8"), ("step", "f8"), ("center", "f8"), ("width", "f8"),
        ("frequency", "f8"), ("bandwidth", "f8"), ("length", "f8"), ("level", "f8"), ("speed", "f8"), ("overhead", "f8"), ("processing", "f8"),
        ("noise", "f8"), ("hears", "i8"), ("relative", "f8"), ("volume", "f8"), ("beam", "f8"), ("directivity", "f8"), ("threshold", "f8"),
        ("least", "f8"), ("fade_length", "f8"), ("fade_angle", "f8"),
        # Of this ping: where the head points, and from how many poses it is cast, none in the air.
        ("angle", "f8"), ("poses", "i8"),
    ],
    [("ready", "f8"), ("index", "i8"), ("sense", "i8")],
)  # fmt: skip

_ranges, _thresholds = compiled(receiver.ranges), compiled(sounding.thresholds)
_deposit, _energies, _volume = (
    compiled(kernel.py_func) for kernel in (echoes.deposit_columns, columns.energies, columns.volume)
)
_fade, _scatter, _receive, _find = (
    compiled(kernel.py_func) for kernel in (speckle.fade, columns.scatter, columns.receive, soundings.find)
)


@compiled
def _sound(head: Any, row: Any, now: Array) -> tuple[float, float]:
    """Its speed at the transducer, m/s, and how many times that the device believes."""
    c, believed = sound_speed(head, row, now, p_NS(head, now)[2])
    return c, believed / c


@compiled
def _divide(row: Any, c: float, stretch: float) -> Any:
    """The `Ranges` of a ping."""
    pulse = Pulse(row.level, row.length, row.bandwidth, 20.0 * math.log10(row.noise))
    return _ranges(row.reach, row.bins, c, stretch, pulse)


@compiled
def _farthest(gates: Any) -> float:
    """How far rays look, m."""
    return float(BEYOND * gates.total / gates.per_metre)


@compiled
def _duration(row: Any, c: float, stretch: float) -> float:
    """Of a ping, s."""
    return float(2.0 * row.reach / (stretch * c))


@compiled
def _turn_to(head: Any, row: Any, now: Array, later: float, R: Array) -> None:
    """Axes of the beam in N, some time later (s), as the vehicle turns now."""
    q = q_NS(head, now)
    if later > 0.0:
        q = multiply(multiply(q_NB(head, now), spin(w_NB_B(head, now), later)), q_BS(head))
    axes(q, row.angle, R)


@compiled
def aim(
    head: Any, row: Any, now: Array, t: float, origin: Array, direction: Array, count: int
) -> tuple[int, float]:  # fmt: skip
    """The beams; where a sonar turns in a ping by more than it can count as still, also as it stands at the end."""
    if t < row.m.ready - 1e-6:
        head.ready = 0
        return count, 0.0
    R = np.empty((3, 3))
    row.angle, row.m.index, row.m.sense = step_on(row.step, row.center, row.width, row.m.index, row.m.sense)
    p, row.poses = p_NS(head, now), 0
    if submergence(now, p, t) > 0.0:
        c, stretch = _sound(head, row, now)
        duration, w = _duration(row, c, stretch), w_NB_B(head, now)
        rate = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        row.poses = 2 if rate * duration > STILL * row.beam else 1
        for pose in range(row.poses):
            _turn_to(head, row, now, pose * duration, R)
            count = cast_fan(block_of(row).direction, R, p, count, origin, direction)
        return count, _farthest(_divide(row, c, stretch).gates)
    return count, 0.0


@compiled
def _energy(
    head: Any, row: Any, now: Array, t: float, divided: Any, alpha: float, later: float, direction: Array, hits: Any
) -> Array:
    """Mean intensity of the echoes of each gate (1, gates), uPa^2, of one pose."""
    gates, cells, R = divided.gates, block_of(row).cells, np.empty((3, 3))
    _turn_to(head, row, now, later, R)
    see(submergence(now, p_NS(head, now), t), direction, _farthest(gates), hits)
    second, out, column = np.zeros((1, gates.total + 3)), np.zeros((1, gates.total)), np.zeros(len(cells), np.int64)
    _deposit(
        cells, direction, R, hits.distance, hits.normal, hits.body, hits.material, ground_of(now), gates.per_metre, column, 0.0,
        divided.level, second,
    )  # fmt: skip
    _energies(second, 0.0, gates.per_metre, alpha, out)
    if row.volume > 0.0:
        strength = row.volume * divided.level
        _volume(cells.emitted, hits.distance, hits.body, strength, 0.0, gates.per_metre, alpha, out)
    return out


@compiled
def _blended(
    head: Any, row: Any, now: Array, t: float, divided: Any, alpha: float, duration: float, direction: Array, hits: Any
) -> Array:
    """The same of a ping: where the sonar turns, of its poses by the time at which each gate is heard."""
    n = len(direction) // row.poses
    energy = _energy(head, row, now, t, divided, alpha, 0.0, direction[:n], part_of(hits, 0, n))
    if row.poses == 2:
        last = _energy(head, row, now, t, divided, alpha, duration, direction[n:], part_of(hits, n, 2 * n))
        for k in range(energy.shape[1]):
            passed = (k + 0.5) / energy.shape[1]
            energy[0, k] = (1.0 - passed) * energy[0, k] + passed * last[0, k]
    return energy


@compiled
def _listen(head: Any, row: Any, now: Array, t: float, c: float, divided: Any, energy: Array) -> Array:
    """What the beam hears: real and imaginary part (2, 1, gates), uPa; without errors mean intensity (1, 1, gates), uPa^2. From where the device
    listens."""
    block, gates, is_mean, R = block_of(row), divided.gates, head.exact != 0, np.empty((3, 3))
    sound, bursts = np.empty((1 if is_mean else 2, 1, gates.total), np.float32), np.empty((0, 4))
    if is_mean:
        sound[0, 0, :] = energy[0]
    else:
        _turn_to(head, row, now, 0.0, R)
        faded, share = np.empty(speckle.DIRECTIONS, np.int64), np.empty(speckle.DIRECTIONS)
        axis = (R[0, 0], R[1, 0], R[2, 0])
        _fade(p_NS(head, now), axis, row.fade_length, row.fade_angle, block.ways, faded, share)
        _scatter(energy, head.key, faded, share, block.phasors, sound)
        if row.hears != 0:
            bursts = overheard(head, now, t, c, row.relative, gates)
    _receive(divided.noise / row.directivity, bursts, head.key, head.number, gates.window, block.phasors, sound)
    silent = min(math.ceil(row.least / (row.reach / row.bins) - 0.5), gates.total)
    sound[:, :, :silent] = np.float32(0.0)
    return sound


@compiled
def _measure(head: Any, row: Any, now: Array, t: float, direction: Array, hits: Any, out: Array) -> None:
    """Range, level and quality of the echo of a ping under water, if it hears one."""
    c, stretch = _sound(head, row, now)
    # Absorption changes so little that an instrument asks for it once a metre.
    alpha = sound_absorption(now, row.frequency, np.rint(p_NS(head, now)[2]))
    divided = _divide(row, c, stretch)
    energy = _blended(head, row, now, t, divided, alpha, _duration(row, c, stretch), direction, hits)
    sound = _listen(head, row, now, t, c, divided, energy)
    around, least, loss = _thresholds(divided, row.directivity, alpha, row.threshold - row.gain)
    place, level, gates, half = np.empty(1), np.empty(1), np.empty(1, np.int64), np.empty(1)
    _find(sound, row.bins, least, loss, row.first != 0, place, level, gates, half)
    if gates[0] > 0:
        head.valid = 1
        out[RANGE], out[LEVEL] = place[0] * (row.reach / row.bins), 10.0 * math.log10(max(level[0], 1e-30))
        out[QUALITY] = level[0] / (level[0] + around)


@compiled
def measure(
    head: Any, row: Any, now: Array, t: float, out: Array, direction: Array, begin: int, end: int, hits: Any
) -> None:  # fmt: skip
    """The first echo of a ping."""
    c, stretch = _sound(head, row, now)
    out[MAX_RANGE], out[GAIN], out[FREQUENCY], out[SPEED] = row.reach, row.gain, row.frequency, stretch * c
    out[ANGLE], out[RANGE], out[LEVEL], out[QUALITY], head.valid = row.angle, MISSING, MISSING, 0.0, 0
    if row.poses > 0:
        _measure(head, row, now, t, direction[begin:end], part_of(hits, begin, end), out)
    duration = _duration(row, c, stretch)
    row.m.ready = t + duration + row.overhead
    tell_pace(head, now, row.m.ready)
    head.delay_ns = rounded_ns(duration + row.processing)


class Profiler(BankSonar):
    """One range a ping."""

    doc = "Profiling sonar: where its pencil beam pointed and how far the echo came from; each ping from the pose at its start."
    bank = Bank(_RECORD, ray_loop(measure), (aim_loop(aim),), acts=True)
    random = ("noise",)
    memory_type = ProfilerMemory
    settings: ProfilerSettings

    def __init__(self, mount: Pose, config: ProfilerConfig) -> None:
        self._config = self.table = config
        self._pencil = pencil = Pencil(rad(config.beam_width_deg), config.rays)
        self._block = Block(cells=pencil.grid.cells, direction=pencil.grid.direction)
        self.exact, self.sees_own, self.rays = config.ideal, config.sees_own_vehicle, 2 * config.rays**2
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
        self.arguments: tuple[Argument, ...] = (*ping_arguments(config), *head_arguments(0.0))
        super().__init__(mount, settings)

    def fill(self, row: Any) -> None:
        c, s, width = self._config, self.settings, rad(self._config.beam_width_deg)
        row["block"], row["bins"], row["first"] = self._block.address, c.bins, c.detection == "first"
        row["reach"], row["gain"], row["step"] = s.range, s.gain, s.step
        row["center"], row["width"] = s.sector_center, s.sector_width
        row["frequency"], row["bandwidth"], row["length"] = c.frequency_hz, c.bandwidth_hz, c.pulse_s
        row["level"], row["noise"] = c.source_level_db, 10.0 ** (0.05 * c.noise_level_db)
        row["speed"], row["overhead"], row["processing"] = assumed_speed(c), c.overhead_s, c.processing_s
        row["hears"] = c.cross_talk_db is not UNSET
        row["relative"] = 0.0 if c.cross_talk_db is UNSET else c.cross_talk_db
        row["volume"] = 0.0 if c.volume_backscatter_db is UNSET else 10.0 ** (0.1 * c.volume_backscatter_db)
        row["beam"], row["directivity"] = width, self._pencil.directivity
        row["threshold"], row["least"] = c.threshold_db, c.min_range_m
        row["fade_length"], row["fade_angle"] = fade_of(width, c.frequency_hz)

    def turn_on_row(self, memory: Any) -> None:
        """Ready at once, at the first step."""
        memory["sense"] = 1
