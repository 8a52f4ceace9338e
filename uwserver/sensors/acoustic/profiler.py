"""Profiling sonar: a pencil beam, fixed or on a head that turns in steps, and one range from the echo of each ping."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import UNSET, Meta, structs

from uwserver.modifiers.operations import rounded_ns
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Argument, FanView, Field
from uwserver.sensors.acoustic import receiver
from uwserver.sensors.acoustic.cross_talk import (
    CompiledSonar,
    assumed_speed,
    overheard,
    ping_arguments,
    sound_speed,
    tell_pace,
)
from uwserver.sensors.acoustic.echo import fill_row, is_busy
from uwserver.sensors.acoustic.head import HeadMemory, HeadSettings, axes, head_arguments, step_on
from uwserver.sensors.acoustic.imaging import columns, soundings, speckle
from uwserver.sensors.acoustic.imaging.blocks import Block, block_of, cast_fan, hit_surface, part_of
from uwserver.sensors.acoustic.imaging.echoes import deposit
from uwserver.sensors.acoustic.imaging.fan import Pencil
from uwserver.sensors.acoustic.pinging import STILL, PingTable, fade_of
from uwserver.sensors.acoustic.receiver import BEYOND, Pulse
from uwserver.sensors.base import Pose, Traits
from uwserver.sensors.compiled import (
    MISSING,
    SensorKernel,
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
from uwserver.table import NonNegative, Positive
from uwserver.units import rad

MAX_RANGE, GAIN, FREQUENCY, SPEED, ANGLE, RANGE, LEVEL, QUALITY = range(8)
"""Places of the fields of a reading."""


class ProfilerConfig(PingTable, tag="profiler", kw_only=True, frozen=True):
    """A profiling sonar. The head turns around the sensor's z, from x towards y.

    With `rpy_deg = [0, -90, 0]` it scans across the track, from down to starboard.

    Attributes:
        beam_width_deg: width of the cone, between half-power points of transmitter and receiver each.
        rays: number of rays along each side of a square of rays.
        step_deg: angle of the head from ping to ping.
        sector_center_deg, sector_width_deg: the sector that the head covers, to and fro; with a width of 0 it stands still, with 360 it rotates.
        detection: which echo of a ping counts, the strongest or the first one.
        threshold_db: level above the noise from which on an echo counts.
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
        """Raise ValueError if keys contradict each other."""
        super().__post_init__()
        if rad(self.sector_width_deg) > 2.0 * math.pi + 1e-9:
            raise ValueError("sector_width_deg is more than a full turn")

    def traits(self) -> Traits:
        """Return its stages of compiled code, and the sector over which its head turns."""
        centre, half = rad(self.sector_center_deg), 0.5 * rad(self.sector_width_deg)
        width, sector = rad(self.beam_width_deg), (centre - half, centre + half)
        fan = FanView(width, width, rad(self.step_deg), sector, 1, self.min_range_m, self.range_m)
        return structs.replace(super().traits(), stages=("sonars",), fan=fan)

    def build(self, mount: Pose) -> Profiler:
        return Profiler(mount, self)


_RECORD = record(
    [
        ("block", "i8"), ("bins", "i8"), ("first", "i8"), ("reach", "f8"), ("gain", "f8"), ("step", "f8"), ("center", "f8"), ("width", "f8"),
        ("frequency", "f8"), ("bandwidth", "f8"), ("length", "f8"), ("level", "f8"), ("speed", "f8"), ("overhead", "f8"), ("processing", "f8"),
        ("noise", "f8"), ("hears", "i8"), ("relative", "f8"), ("volume", "f8"), ("beam", "f8"), ("directivity", "f8"), ("threshold", "f8"),
        ("least", "f8"), ("fade_length", "f8"), ("fade_angle", "f8"),
        # Of this ping: angle of the head, and number of attitudes from which rays are cast, 0 in the air.
        ("angle", "f8"), ("poses", "i8"),
    ],
    [("ready", "f8"), ("index", "i8"), ("sense", "i8")],
)  # fmt: skip

_ranges, _thresholds = compiled(receiver.ranges), compiled(receiver.thresholds)
# The entries for Python, as kernels that compiled code can call.
_energies, _volume, _fade, _scatter, _receive, _find = (
    compiled(kernel.py_func)
    for kernel in (columns.energies, columns.volume, speckle.fade, columns.scatter, columns.receive, soundings.find)
)


@compiled
def _sound(head: Any, row: Any, surroundings: Array) -> tuple[float, float]:
    """Return the sound speed at the transducer, m/s, and believed over true sound speed."""
    c, believed = sound_speed(head, row, surroundings, p_NS(head, surroundings)[2])
    return c, believed / c


@compiled
def _divide(row: Any, c: float, stretch: float) -> Any:
    """Return the `Ranges` of a ping; arguments as `_sound` returns them."""
    pulse = Pulse(row.level, row.length, row.bandwidth, 20.0 * math.log10(row.noise))
    return _ranges(row.reach, row.bins, c, stretch, pulse)


@compiled
def _farthest(gates: Any) -> float:
    """Return how far rays reach, m."""
    return float(BEYOND * gates.total / gates.per_metre)


@compiled
def _duration(row: Any, c: float, stretch: float) -> float:
    """Return the duration of a ping, s; arguments as `_sound` returns them."""
    return float(2.0 * row.reach / (stretch * c))


@compiled
def _turn_to(head: Any, row: Any, surroundings: Array, later: float, R: Array) -> None:
    """Write the axes of the beam in N into the columns of R (3, 3), as they are `later` s from now if the vehicle goes on turning as it does."""
    q = q_NS(head, surroundings)
    if later > 0.0:
        q = multiply(multiply(q_NB(head, surroundings), spin(w_NB_B(head, surroundings), later)), q_BS(head))
    axes(q, row.angle, R)


@compiled
def aim(
    head: Any, row: Any, surroundings: Array, t: float, origin: Array, direction: Array, count: int
) -> tuple[int, float]:  # fmt: skip
    """Turn the head, and lay the rays of the beam if the sonar is under water; nothing while the last ping is not over.

    If the sonar turns too far during the ping to count as still, the rays are cast from the attitude at its end too.
    """
    if is_busy(head, row, t):
        return count, 0.0
    row.angle, row.m.index, row.m.sense = step_on(row.step, row.center, row.width, row.m.index, row.m.sense)
    p, row.poses = p_NS(head, surroundings), 0
    if submergence(surroundings, p, t) <= 0.0:
        return count, 0.0
    c, stretch = _sound(head, row, surroundings)
    duration, w, R = _duration(row, c, stretch), w_NB_B(head, surroundings), np.empty((3, 3))
    rate = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    row.poses = 2 if rate * duration > STILL * row.beam else 1
    for pose in range(row.poses):
        _turn_to(head, row, surroundings, pose * duration, R)
        count = cast_fan(block_of(row).direction, R, p, count, origin, direction)
    return count, _farthest(_divide(row, c, stretch).gates)


@compiled
def _energy(
    head: Any,
    row: Any,
    surroundings: Array,
    t: float,
    divided: Any,
    alpha: float,
    later: float,
    direction: Array,
    hits: Any,
) -> Array:
    """Return the mean intensity of the echoes in each gate (1, gates), uPa^2, at one attitude.

    Args:
        head, row, surroundings, t: those of the sonar; t in s.
        divided: `Ranges` of the ping.
        alpha: absorption, dB/m.
        later: time from now to that attitude, s.
        direction, hits: directions (n, 3) of the rays from there, and what they hit.
    """
    gates, cells, R = divided.gates, block_of(row).cells, np.empty((3, 3))
    _turn_to(head, row, surroundings, later, R)
    hit_surface(submergence(surroundings, p_NS(head, surroundings), t), direction, _farthest(gates), hits)
    second, out, column = np.zeros((1, gates.total + 3)), np.zeros((1, gates.total)), np.zeros(len(cells), np.int64)
    deposit(
        cells, direction, R, hits.distance, hits.normal, hits.body, hits.material, ground_of(surroundings), gates.per_metre, column, 0.0,
        divided.level, second,
    )  # fmt: skip
    _energies(second, 0.0, gates.per_metre, alpha, out)
    if row.volume > 0.0:
        strength = row.volume * divided.level
        _volume(cells.emitted, hits.distance, hits.body, strength, 0.0, gates.per_metre, alpha, out)
    return out


@compiled
def _blended(
    head: Any,
    row: Any,
    surroundings: Array,
    t: float,
    divided: Any,
    alpha: float,
    duration: float,
    direction: Array,
    hits: Any,
) -> Array:
    """Return the mean intensity of a ping, as `_energy`. If the sonar turns, both attitudes are blended by the time at which each gate is heard."""
    n = len(direction) // row.poses
    energy = _energy(head, row, surroundings, t, divided, alpha, 0.0, direction[:n], part_of(hits, 0, n))
    if row.poses == 2:
        last = _energy(head, row, surroundings, t, divided, alpha, duration, direction[n:], part_of(hits, n, 2 * n))
        for k in range(energy.shape[1]):
            passed = (k + 0.5) / energy.shape[1]
            energy[0, k] = (1.0 - passed) * energy[0, k] + passed * last[0, k]
    return energy


@compiled
def _listen(head: Any, row: Any, surroundings: Array, t: float, c: float, divided: Any, energy: Array) -> Array:
    """Return what the beam hears: real and imaginary part (2, 1, gates), uPa; without errors mean intensity (1, 1, gates), uPa^2.

    It is 0 nearer than the least range of the device. Arguments as of `_energy`; `c`: sound speed, m/s; `energy`: (1, gates).
    """
    block, gates, is_mean, R = block_of(row), divided.gates, head.exact != 0, np.empty((3, 3))
    sound, bursts = np.empty((1 if is_mean else 2, 1, gates.total), np.float32), np.empty((0, 4))
    if is_mean:
        sound[0, 0, :] = energy[0]
    else:
        _turn_to(head, row, surroundings, 0.0, R)
        faded, share = np.empty(speckle.DIRECTIONS, np.int64), np.empty(speckle.DIRECTIONS)
        axis = (R[0, 0], R[1, 0], R[2, 0])
        _fade(p_NS(head, surroundings), axis, row.fade_length, row.fade_angle, block.ways, faded, share)
        _scatter(energy, head.key, faded, share, block.phasors, sound)
        if row.hears != 0:
            bursts = overheard(head, surroundings, t, c, row.relative, gates)
    _receive(divided.noise / row.directivity, bursts, head.key, head.number, gates.window, block.phasors, sound)
    silent = min(math.ceil(row.least / (row.reach / row.bins) - 0.5), gates.total)
    sound[:, :, :silent] = np.float32(0.0)
    return sound


@compiled
def _measure(head: Any, row: Any, surroundings: Array, t: float, direction: Array, hits: Any, out: Array) -> None:
    """Write range, level and quality of the echo of a ping under water, if there is one."""
    c, stretch = _sound(head, row, surroundings)
    # Absorption changes so little that an instrument asks for it once a metre.
    alpha = sound_absorption(surroundings, row.frequency, np.rint(p_NS(head, surroundings)[2]))
    divided = _divide(row, c, stretch)
    energy = _blended(head, row, surroundings, t, divided, alpha, _duration(row, c, stretch), direction, hits)
    sound = _listen(head, row, surroundings, t, c, divided, energy)
    around, least, loss = _thresholds(divided, row.directivity, alpha, row.threshold - row.gain)
    place, level, gates, half = np.empty(1), np.empty(1), np.empty(1, np.int64), np.empty(1)
    _find(sound, row.bins, least, loss, row.first != 0, place, level, gates, half)
    if gates[0] > 0:
        head.valid = 1
        out[RANGE], out[LEVEL] = place[0] * (row.reach / row.bins), 10.0 * math.log10(max(level[0], 1e-30))
        out[QUALITY] = level[0] / (level[0] + around)


@compiled
def measure(
    head: Any, row: Any, surroundings: Array, t: float, out: Array, direction: Array, begin: int, end: int, hits: Any
) -> None:  # fmt: skip
    """Read the echo of a ping."""
    c, stretch = _sound(head, row, surroundings)
    out[MAX_RANGE], out[GAIN], out[FREQUENCY], out[SPEED] = row.reach, row.gain, row.frequency, stretch * c
    out[ANGLE], out[RANGE], out[LEVEL], out[QUALITY], head.valid = row.angle, MISSING, MISSING, 0.0, 0
    if row.poses > 0:
        _measure(head, row, surroundings, t, direction[begin:end], part_of(hits, begin, end), out)
    duration = _duration(row, c, stretch)
    row.m.ready = t + duration + row.overhead
    tell_pace(head, surroundings, row.m.ready)
    head.delay_ns = rounded_ns(duration + row.processing)


class Profiler(CompiledSonar):
    """Gives one range a ping."""

    doc = "Profiling sonar: where its pencil beam pointed and how far the echo came from; each ping from the pose at its start."
    kernel = SensorKernel(_RECORD, ray_loop(measure), (aim_loop(aim),), acts=True)
    random = ("noise",)
    memory_type = HeadMemory
    settings: HeadSettings

    def __init__(self, mount: Pose, config: ProfilerConfig) -> None:
        self._config = self.table = config
        self._pencil = pencil = Pencil(rad(config.beam_width_deg), config.rays)
        self._block = Block(cells=pencil.grid.cells, direction=pencil.grid.direction)
        self.exact, self.sees_own, self.rays = config.ideal, config.sees_own_vehicle, 2 * config.rays**2
        self.fields = (
            Field("max_range", "m", "range at which the device stops listening"),
            Field("gain", "dB", "gain of this ping"),
            Field("frequency", "Hz", "of this ping"),
            Field("sound_speed", "m/s", "with which the device converts times to ranges"),
            Field("head_angle", "rad", "where the beam points, from x towards y of the sensor"),
            Field("range", "m", "of the echo, along the beam; missing without one"),
            Field("level", "dB", "of the echo, re 1 uPa; missing without one"),
            Field("quality", "1", "of the range: 1 for an echo without noise, 0 for none"),
        )
        settings = HeadSettings(
            config.range_m, 0.0, rad(config.step_deg), rad(config.sector_center_deg), rad(config.sector_width_deg)
        )
        self.arguments: tuple[Argument, ...] = (*ping_arguments(config), *head_arguments(0.0))
        super().__init__(mount, settings)

    def fill(self, row: Any) -> None:
        c, s, width = self._config, self.settings, rad(self._config.beam_width_deg)
        row["fade_length"], row["fade_angle"] = fade_of(width, c.frequency_hz)
        fill_row(
            row, block=self._block.address, bins=c.bins, first=c.detection == "first", reach=s.range, gain=s.gain, step=s.step,
            center=s.sector_center, width=s.sector_width, frequency=c.frequency_hz, bandwidth=c.bandwidth_hz, length=c.pulse_s,
            level=c.source_level_db, noise=10.0 ** (0.05 * c.noise_level_db), speed=assumed_speed(c), overhead=c.overhead_s,
            processing=c.processing_s, hears=c.cross_talk_db is not UNSET,
            relative=0.0 if c.cross_talk_db is UNSET else c.cross_talk_db,
            volume=0.0 if c.volume_backscatter_db is UNSET else 10.0 ** (0.1 * c.volume_backscatter_db), beam=width,
            directivity=self._pencil.directivity, threshold=c.threshold_db, least=c.min_range_m,
        )  # fmt: skip

    def turn_on_row(self, memory: Any) -> None:
        """Make the sonar ready at once, with its head at the first step."""
        memory["sense"] = 1
