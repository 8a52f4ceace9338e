"""Doppler velocity log: beams as rays, bottom and water track, and least squares over the beams in lock."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.environment.column import SOUND_SPEED
from uwserver.frames import matrix
from uwserver.modifiers.base import Memory, Number, Time
from uwserver.modifiers.operations import rounded_ns
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals, uniforms
from uwserver.physics.rays.raycast import SURFACE
from uwserver.ports import Argument, Field
from uwserver.sensors.acoustic.doppler.janus import (
    ALTITUDE,
    BEAMS,
    MOST_BEAMS,
    along,
    directions_of,
    slanted,
    solve_bottom,
    track_water,
)
from uwserver.sensors.acoustic.echo import MU_SEDIMENT, SOUND_SPEED_ARGUMENT, fill_row, lay_ray, or_truth, pings
from uwserver.sensors.base import Distance, Pose, SensorTable, Settings, SoundSpeed, Traits, out_of_range
from uwserver.sensors.compiled import (
    MISSING,
    CompiledSensor,
    SensorKernel,
    aim_loop,
    conjugate,
    echo_of,
    meet_surface,
    p_NS,
    q_NB,
    q_NS,
    q_SB,
    ray_loop,
    record,
    rotate,
    sound_absorption,
    submergence,
    velocity_of,
    water_property,
    water_velocity,
)
from uwserver.table import NonNegative, Positive, Probability, Vector3
from uwserver.units import rad

MOST_MODES = 8
_MISTAKES = 32
"""First lane of random numbers for wrong echoes. The lanes of each beam's noise begin at 0, and those of water track at `janus.WATER`."""
THRESHOLD = 4.0
"""Signal over noise (ratio of intensities) at which a beam has lock: 6 dB."""
_CLEAR = 0.8
"""Water track reaches at most this part of the distance to the bottom, whose echo through the side lobes would spoil it (TRDI Pathfinder guide)."""


class DvlConfig(SensorTable, tag="dvl", kw_only=True, frozen=True):
    """A Doppler velocity log. The sensor frame's z points along the axis of the beams.

    `rate_hz` is an upper limit; with `range_modes` it pings as often as the mode for its altitude allows.

    Attributes:
        ideal: exact values, and lock wherever a beam hits something.
        frequency_hz: frequency of the sound; absorption depends on it.
        beam_angle_deg: angle of each beam from the axis.
        beam_azimuth_deg: azimuth of each beam about the axis, from x to y.
        min_altitude_m, max_altitude_m: along the axis; at the largest altitude, sediment below a level device is just detected.
        max_speed_mps: along a beam.
        beam_sigma_mps, range_sigma_m: white error of a beam's velocity and range per ping, at a strong echo.
        scale_error, scale_sigma: scale error of the velocity: a constant, and the standard deviation of a part drawn once a run.
        assumed_sound_speed_mps: sound speed that the device believes; default: the true one.
        misalignment_rpy_deg: true attitude of the device relative to the sensor frame that is assumed.
        false_echo_probability: probability that a beam takes something else for the bottom.
        false_echo_sigma_mps: error of its velocity then.
        processing_s: time from the last echo to the delivery.
        range_modes: rows of least altitude (m), largest altitude (m) and pings a second.
        range_mode: number of the row to keep, or -1 to follow the altitude.
        tracking: what it measures its velocity against.
        water_near_m, water_far_m: limits of the layer of water track, along the axis.
        water_sigma_mps: white error of a beam's velocity against the water.
    """

    message = "Dvl"
    ideal: bool = False
    frequency_hz: Positive = 1e6
    beam_angle_deg: Annotated[float, Meta(gt=0, lt=60)] = 22.5
    beam_azimuth_deg: Annotated[tuple[float, ...], Meta(min_length=3, max_length=MOST_BEAMS)] = (
        45.0,
        135.0,
        225.0,
        315.0,
    )
    min_altitude_m: NonNegative = 0.05
    max_altitude_m: Positive = 50.0
    max_speed_mps: Positive = 10.0
    beam_sigma_mps: NonNegative = 0.005
    range_sigma_m: NonNegative = 0.01
    scale_error: float = 0.0
    scale_sigma: NonNegative = 0.0
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    misalignment_rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    false_echo_probability: Probability = 0.0
    false_echo_sigma_mps: NonNegative = 0.5
    processing_s: NonNegative = 0.0
    range_modes: Annotated[tuple[tuple[NonNegative, Positive, Positive], ...], Meta(max_length=MOST_MODES)] = ()
    range_mode: Annotated[int, Meta(ge=-1)] = -1
    tracking: Literal["bottom", "water", "both"] = "both"
    water_near_m: NonNegative = 1.5
    water_far_m: Positive = 4.5
    water_sigma_mps: NonNegative = 0.015

    def __post_init__(self) -> None:
        """Raise ValueError if keys contradict each other."""
        if not self.min_altitude_m < self.max_altitude_m:
            raise ValueError("min_altitude_m must be less than max_altitude_m")
        if not self.water_near_m < self.water_far_m:
            raise ValueError("water_near_m must be less than water_far_m")
        if self.range_mode >= len(self.range_modes):
            raise ValueError(f"range_mode {self.range_mode} is none of the {len(self.range_modes)} range_modes")
        if any(low >= high for low, high, _ in self.range_modes):
            raise ValueError("each of range_modes needs a least altitude less than its largest")

    def traits(self) -> Traits:
        """Return its stages of compiled code and its beams."""
        tilt = rad(self.beam_angle_deg)
        far = self.max_altitude_m / math.cos(tilt)
        return Traits(("soundings",), beams=slanted(tilt, self.beam_azimuth_deg, self.min_altitude_m, far))

    def build(self, mount: Pose) -> Dvl:
        return Dvl(mount, self)


class DvlSettings(Settings, frozen=True):
    """See `DvlConfig`; `sound_speed` 0 stands for the true one."""

    max_altitude: Distance
    range_mode: Annotated[int, Meta(ge=-1)]
    tracking: Literal["bottom", "water", "both"]
    sound_speed: SoundSpeed


class DvlMemory(Memory):
    """Attributes:
    ready: time of the next ping, s.
    scale: error of the scale in this run (0.01 shows 1 % too much).
    mode: number of the range mode."""

    ready: Time = 0.0
    scale: Number = 0.0
    mode: Annotated[int, Meta(ge=0)] = 0


_RECORD = record(
    [
        ("beams", "i8"), ("believed", "f8", (MOST_BEAMS, 3)), ("real", "f8", (MOST_BEAMS, 3)), ("cosine", "f8"), ("frequency", "f8"),
        ("low", "f8"), ("high", "f8"), ("reach", "f8"), ("speed", "f8"), ("beam_sigma", "f8"), ("range_sigma", "f8"), ("mistakes", "f8"),
        ("mistake_sigma", "f8"), ("processing", "f8"), ("modes", "i8"), ("mode", "f8", (MOST_MODES, 3)), ("wanted", "i8"), ("bottom", "i8"),
        ("water", "i8"), ("far", "f8"), ("water_sigma", "f8"), ("sound_speed", "f8"),
    ],
    [("ready", "f8"), ("scale", "f8"), ("mode", "i8")],
)  # fmt: skip


@compiled
def _limits(row: Any) -> tuple[float, float, float]:
    """Return least altitude (m), largest altitude (m) and period (s) of this ping."""
    if row.modes == 0:
        return row.low, row.high, 0.0
    mode = row.mode[row.m.mode if row.wanted < 0 else row.wanted]
    return max(row.low, mode[0]), min(row.high, mode[1]), 1.0 / mode[2]


@compiled
def aim(
    head: Any, row: Any, surroundings: Array, t: float, origin: Array, direction: Array, count: int
) -> tuple[int, float]:  # fmt: skip
    """Lay the beams if the device pings."""
    if not pings(head, row, surroundings, t):
        return count, 0.0
    p, q = p_NS(head, surroundings), q_NS(head, surroundings)
    for i in range(row.beams):
        beam = row.believed[i] if head.exact != 0 else row.real[i]
        lay_ray(p, rotate(q, (beam[0], beam[1], beam[2])), count, origin, direction)
        count += 1
    return count, 1.05 * _limits(row)[1] / row.cosine


@compiled
def _follow(row: Any, locked: bool, altitude: float) -> None:
    """Choose the mode of the next ping: the present one while the altitude is well within it, else the closest one that fits.

    Without lock the modes are tried one after the other.
    """
    if row.modes == 0:
        return
    mode = row.m.mode
    if not locked:
        row.m.mode = (mode + 1) % row.modes
        return
    best = -1
    for k in range(row.modes):
        fits = row.mode[k, 0] * 1.05 <= altitude <= row.mode[k, 1] * 0.95
        if fits and (best < 0 or abs(k - mode) < abs(best - mode)):
            best = k
    row.m.mode = mode if best < 0 else best


@compiled
def _snr(head: Any, row: Any, surroundings: Array, decay: float, direction: Array, k: int, hits: Any) -> float:
    """Return signal over noise (a ratio) of ray k; `decay`: of intensity by absorption both ways, 1/m (exponent).

    The echo of an extended bottom loses 20 lg r + 2 alpha r. At the largest altitude sediment is just detected.
    """
    if head.exact != 0:
        return math.inf
    r = hits.distance[k]
    if r == math.inf:
        return 0.0
    reach = row.reach / row.cosine
    scale = THRESHOLD / (MU_SEDIMENT * row.cosine**2) * reach * reach
    back = echo_of(surroundings, direction[k], hits.normal[k], hits.body[k], hits.material[k])
    return float(scale * back / (r * r + 1e-6) * math.exp(decay * (reach - r)))


@compiled
def _hear(
    head: Any, row: Any, surroundings: Array, t: float, out: Array, direction: Array, first: int, hits: Any
) -> float:
    """Write a reading. Returns the longest range of a beam that hits something, m."""
    p, exact = p_NS(head, surroundings), head.exact != 0
    low, high, _ = _limits(row)
    limit, height = 1.05 * high / row.cosine, submergence(surroundings, p, t)
    c = water_property(surroundings, SOUND_SPEED, p[2])
    v_S = rotate(q_SB(head), velocity_of(head, surroundings))
    flow = rotate(q_SB(head), rotate(conjugate(q_NB(head, surroundings)), water_velocity(surroundings, p, t)))
    v_water = (v_S[0] - flow[0], v_S[1] - flow[1], v_S[2] - flow[2])
    stretch = row.sound_speed / c if row.sound_speed > 0.0 and not exact else 1.0
    gain = stretch * (1.0 if exact else 1.0 + row.m.scale)
    decay = 0.2 * math.log(10.0) * sound_absorption(surroundings, row.frequency, p[2])
    n = row.beams
    nearest, longest = math.inf, 0.0
    for i in range(n):
        k = first + i
        meet_surface(height, direction, limit, k, hits)
        r = hits.distance[k]
        nearest, longest = min(nearest, r), max(longest, r) if r < math.inf else longest
        if row.bottom == 0:
            continue
        speed = along(head, row, i, v_water if hits.body[k] == SURFACE else v_S)
        snr = _snr(head, row, surroundings, decay, direction, k, hits)
        lock = low <= r * row.cosine <= high and abs(speed) <= row.speed and snr >= THRESHOLD
        out[BEAMS + 2 * n + i] = 1.0 if lock else 0.0
        if not lock:
            continue
        e, f = 0.0, 0.0
        if not exact:
            e, f = normals(head.key, head.number, SAMPLE, i)
        # An echo near the noise is measured less precisely.
        speed = gain * speed + row.beam_sigma * (1.0 + 1.0 / max(snr, THRESHOLD)) * e
        seen = stretch * r + row.range_sigma * f
        if row.mistakes > 0.0 and not exact:
            chance, where = uniforms(head.key, head.number, SAMPLE, _MISTAKES + 2 * i)
            if chance < row.mistakes:
                wrong, _ = normals(head.key, head.number, SAMPLE, _MISTAKES + 2 * i + 1)
                seen = low / row.cosine + where * max(0.0, seen - low / row.cosine)
                speed += row.mistake_sigma * wrong
        out[BEAMS + i], out[BEAMS + n + i] = speed, seen
    if row.bottom != 0:
        head.valid = 1 if solve_bottom(head, row, out) else 0
    if row.water != 0 and row.far <= _CLEAR * nearest * row.cosine:
        track_water(head, row, out, gain, v_water)
    return longest


@compiled
def measure(
    head: Any, row: Any, surroundings: Array, t: float, out: Array, direction: Array, begin: int, end: int, hits: Any
) -> None:  # fmt: skip
    """Read the velocity from what the beams hear."""
    z = p_NS(head, surroundings)[2]
    c, (_, high, period) = water_property(surroundings, SOUND_SPEED, z), _limits(row)
    out[:], head.valid = MISSING, 0
    delay = 2.0 * high / row.cosine / c
    if end > begin:
        longest = _hear(head, row, surroundings, t, out, direction, begin, hits)
        delay = 2.0 * longest / c if head.valid != 0 else delay
    row.m.ready = t + period
    _follow(row, head.valid != 0, out[ALTITUDE])
    head.delay_ns = rounded_ns(delay + row.processing)


class Dvl(CompiledSensor):
    """Gives velocity over ground and through the water, altitude, and what each beam measured."""

    doc = (
        "Doppler velocity log: velocity of the mount over ground (valid with at least three beams in lock) and relative to a layer of water, "
        "altitude along the axis, and what each beam measured."
    )
    kernel = SensorKernel(_RECORD, ray_loop(measure), (aim_loop(aim),))
    random = ("beam_sigma", "range_sigma", "mistake_sigma", "water_sigma")
    memory_type = DvlMemory
    settings: DvlSettings

    def __init__(self, mount: Pose, config: DvlConfig) -> None:
        self._config, self.exact, self.rays = config, config.ideal, len(config.beam_azimuth_deg)
        n, low, high = len(config.beam_azimuth_deg), config.min_altitude_m, config.max_altitude_m
        self.fields = (
            Field("v_S", "m/s", "velocity of the mount over ground", "S", (3,)),
            Field("altitude", "m", "distance of the bottom along the axis of the beams"),
            Field("figure_of_merit", "m/s", "standard deviation of v_S that the device expects"),
            Field("covariance_S", "m^2/s^2", "covariance of v_S that the device expects", "S", (3, 3)),
            Field("beam_velocities", "m/s", "velocity along each beam; none without lock", shape=(n,)),
            Field("beam_ranges", "m", "range along each beam; none without lock", shape=(n,)),
            Field("beam_locks", "1", "whether each beam has lock", shape=(n,), type="bool"),
            Field("v_water_S", "m/s", "velocity relative to a layer of water; none when not measured", "S", (3,)),
        )
        self.arguments = (
            Argument("max_altitude", "float", "largest altitude", "m", False, minimum=low, maximum=high),
            Argument("range_mode", "int", "number of the range mode to keep; -1 follows the altitude", required=False, minimum=-1),
            Argument("tracking", "str", "what it measures against", required=False, choices=("bottom", "water", "both")),
            SOUND_SPEED_ARGUMENT,
        )  # fmt: skip
        speed = or_truth(config.assumed_sound_speed_mps)
        super().__init__(mount, DvlSettings(high, config.range_mode, config.tracking, speed))

    def fill(self, row: Any) -> None:
        c, s, n = self._config, self.settings, len(self._config.beam_azimuth_deg)
        angle, askew = rad(c.beam_angle_deg), Pose.from_degrees(c.misalignment_rpy_deg)
        believed = directions_of(angle, c.beam_azimuth_deg)
        row["believed"][:n], row["real"][:n] = believed, believed @ np.array(matrix(askew.q)).T
        row["mode"][: len(c.range_modes)] = np.reshape(c.range_modes, (-1, 3))
        fill_row(
            row, beams=n, cosine=math.cos(angle), frequency=c.frequency_hz, low=c.min_altitude_m, high=s.max_altitude,
            reach=c.max_altitude_m, speed=c.max_speed_mps, beam_sigma=c.beam_sigma_mps, range_sigma=c.range_sigma_m,
            mistakes=c.false_echo_probability, mistake_sigma=c.false_echo_sigma_mps, processing=c.processing_s,
            modes=len(c.range_modes), wanted=s.range_mode, bottom=s.tracking != "water", water=s.tracking != "bottom",
            far=c.water_far_m, water_sigma=c.water_sigma_mps, sound_speed=s.sound_speed,
        )  # fmt: skip

    def turn_on_row(self, memory: Any) -> None:
        """Make the device ready at once, in the first mode or the one to keep, and draw its scale error."""
        c = self._config
        memory["scale"] = c.scale_error + c.scale_sigma * self.drawn(1)[0]
        memory["mode"] = max(c.range_mode, 0)

    def check(self, settings: Settings) -> None:
        """Raise Refused if the device has no such range mode."""
        assert isinstance(settings, DvlSettings)
        if settings.range_mode >= len(self._config.range_modes):
            raise out_of_range("range_mode", f"the device has {len(self._config.range_modes)} range modes, from 0 on")

    def valid(self, record: Memory | Settings) -> None:
        """Check also that the device has the range mode of a memory."""
        super().valid(record)
        if isinstance(record, DvlMemory) and record.mode >= max(1, len(self._config.range_modes)):
            raise ValueError(f'"mode" is {record.mode}, the device has {len(self._config.range_modes)} range modes')
