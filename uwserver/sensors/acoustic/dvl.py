"""Doppler velocity log: Janus beams as rays, bottom and water track, least squares over the beams that have lock."""

from __future__ import annotations

import math
from operator import mul
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.frames import Vec3, conjugate, matrix, rotate
from uwserver.modifiers.base import Measurement, Memory, Number, Time
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import SURFACE, Hits
from uwserver.ports import Argument, Field, Value
from uwserver.sensors.acoustic.echo import MU_SEDIMENT, Absorption, cast, load_kernels, scattering
from uwserver.sensors.base import Distance, Pose, Scope, Sensor, SensorTable, Settings, SoundSpeed, blank, out_of_range
from uwserver.table import NonNegative, Positive, Probability, Vector3
from uwserver.units import NANOSECONDS, rad

THRESHOLD = 4.0
"""Signal over noise (ratio of intensities) at which a beam has lock: 6 dB."""
_CLEAR = 0.8
"""Water track looks no farther than this part of the distance to the bottom, whose side-lobe echo would spoil it (TRDI Pathfinder guide)."""


class DvlConfig(SensorTable, tag="dvl", kw_only=True, frozen=True):
    """A Doppler velocity log. The sensor frame's z points along the axis of the beams.

    `rate_hz` is how often it is asked at most; with `range_modes` it pings as the mode of its altitude allows.

    Attributes:
        ideal: exact values, lock wherever a beam reaches something.
        frequency_hz: of the sound; absorption depends on it.
        beam_angle_deg: of each beam from the axis.
        beam_azimuth_deg: of each beam about the axis, from x to y.
        min_altitude_m, max_altitude_m: along the axis; the strength of the echo is such that sediment under a level device is just seen there.
        max_speed_mps: along a beam.
        beam_sigma_mps, range_sigma_m: white error of a beam's velocity and range per ping, at a strong echo.
        scale_error, scale_sigma: of the velocity: known, and drawn once a run.
        assumed_sound_speed_mps: what the device believes; default: the truth.
        misalignment_rpy_deg: of the device against the sensor frame that it is thought to have.
        false_echo_probability: a beam takes something else for the bottom.
        false_echo_sigma_mps: of its velocity then.
        processing_s: from the last echo to the delivery.
        range_modes: rows of least altitude, largest altitude (m) and pings a second.
        range_mode: number of the row to keep, or -1 to follow the altitude.
        tracking: what it measures against.
        water_near_m, water_far_m: the layer of the water track, along the axis.
        water_sigma_mps: white error of a beam's velocity against the water.
    """

    ideal: bool = False
    frequency_hz: Positive = 1e6
    beam_angle_deg: Annotated[float, Meta(gt=0, lt=60)] = 22.5
    beam_azimuth_deg: Annotated[tuple[float, ...], Meta(min_length=3)] = (45.0, 135.0, 225.0, 315.0)
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
    range_modes: tuple[tuple[NonNegative, Positive, Positive], ...] = ()
    range_mode: Annotated[int, Meta(ge=-1)] = -1
    tracking: Literal["bottom", "water", "both"] = "both"
    water_near_m: NonNegative = 1.5
    water_far_m: Positive = 4.5
    water_sigma_mps: NonNegative = 0.015

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        if not self.min_altitude_m < self.max_altitude_m:
            raise ValueError("min_altitude_m must be less than max_altitude_m")
        if not self.water_near_m < self.water_far_m:
            raise ValueError("water_near_m must be less than water_far_m")
        if self.range_mode >= len(self.range_modes):
            raise ValueError(f"range_mode {self.range_mode} is none of the {len(self.range_modes)} range_modes")
        if any(low >= high for low, high, _ in self.range_modes):
            raise ValueError("each of range_modes needs a least altitude less than its largest")

    def build(self, mount: Pose) -> Dvl:
        return Dvl(mount, self)


class DvlSettings(Settings, frozen=True):
    """See `DvlConfig`; `sound_speed` 0 stands for the truth."""

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


class Dvl(Sensor):
    """Velocity over ground and through the water, altitude, and what each beam saw."""

    doc = (
        "Doppler velocity log: velocity of the mount over ground (valid with at least three beams in lock) and relative to a layer of water, "
        "altitude along the axis, and what each beam saw."
    )
    paces = True
    settings: DvlSettings
    memory: DvlMemory

    def __init__(self, mount: Pose, config: DvlConfig) -> None:
        self._mount, self._config = mount, config
        n = len(config.beam_azimuth_deg)
        angle = rad(config.beam_angle_deg)
        azimuths = [rad(a) for a in config.beam_azimuth_deg]
        self._cosine = math.cos(angle)
        self._believed = np.array(
            [(math.sin(angle) * math.cos(a), math.sin(angle) * math.sin(a), self._cosine) for a in azimuths]
        )
        askew = Pose() if config.ideal else Pose.from_degrees(config.misalignment_rpy_deg)
        self._beams: FloatArray = self._believed @ np.array(matrix(askew.q)).T
        self._listed: list[list[float]] = self._beams.tolist()
        self._all = tuple(range(n))
        self._to_S = conjugate(mount.q)
        self._solutions: dict[tuple[int, ...], _Solution] = {}
        self._absorption = Absorption(config.frequency_hz)
        self.fields = _fields(n)
        self._blank = blank(self.fields)
        self.arguments = _arguments(config)
        speed = 0.0 if config.assumed_sound_speed_mps is UNSET else config.assumed_sound_speed_mps
        super().__init__(DvlSettings(config.max_altitude_m, config.range_mode, config.tracking, speed))

    def load_kernels(self) -> None:
        load_kernels()

    def turn_on(self) -> DvlMemory:
        """Ready at once, in the first mode, with the scale error of this run."""
        c = self._config
        scale = c.scale_error + c.scale_sigma * self.rng.standard_normal()
        return DvlMemory(scale=scale, mode=max(c.range_mode, 0))

    def check(self, settings: Settings) -> None:
        """The range mode must be one of the device's."""
        assert isinstance(settings, DvlSettings)
        if settings.range_mode >= len(self._config.range_modes):
            raise out_of_range("range_mode", f"the device has {len(self._config.range_modes)} range modes, from 0 on")

    def valid(self, record: Memory | Settings) -> None:
        """The range mode must be one of the device's."""
        super().valid(record)
        if isinstance(record, DvlMemory) and record.mode >= max(1, len(self._config.range_modes)):
            raise ValueError(f'"mode" is {record.mode}, the device has {len(self._config.range_modes)} range modes')

    def sense(self, scope: Scope) -> Measurement | None:
        """A ping; None while the last one is not over."""
        now = scope.t
        if now < self.memory.ready - 1e-6:
            return None
        low, high, period = self._mode()
        p_NS = scope.position(self._mount.p)
        c = scope.water.sound_speed(p_NS[2])
        delay = 2.0 * high / self._cosine / c
        reading = Measurement(self._blank.copy(), False)
        if scope.submergence(p_NS) > 0.0:
            echo = self._ping(scope, p_NS, c, low, high, reading)
            delay = 2.0 * echo / c if reading.valid else delay
        self.memory.ready = now + period
        self._follow(reading.values[1] if reading.valid else None)
        reading.delay_ns = round((delay + self._config.processing_s) * NANOSECONDS)
        return reading

    def _mode(self) -> tuple[float, float, float]:
        """Least and largest altitude (m) and period (s) of this ping."""
        c, modes = self._config, self._config.range_modes
        low, high, period = c.min_altitude_m, self.settings.max_altitude, 0.0
        if modes:
            wanted = self.settings.range_mode
            first, last, rate_hz = modes[self.memory.mode if wanted < 0 else wanted]
            low, high, period = max(low, first), min(high, last), 1.0 / rate_hz
        return low, high, period

    def _follow(self, altitude: Value) -> None:
        """Keep to the mode while the altitude is well within it; without lock try one after the other."""
        modes = self._config.range_modes
        if not modes:
            return
        mode = self.memory.mode
        if not isinstance(altitude, float):
            mode = (mode + 1) % len(modes)
        elif not modes[mode][0] * 1.05 <= altitude <= modes[mode][1] * 0.95:
            fitting = [k for k, (low, high, _) in enumerate(modes) if low * 1.05 <= altitude <= high * 0.95]
            mode = min(fitting, key=lambda k: abs(k - mode)) if fitting else mode
        self.memory.mode = mode

    def _ping(self, scope: Scope, p_NS: Vec3, c: float, low: float, high: float, reading: Measurement) -> float:
        """Fill in a reading; returns the longest range (m) of a beam in lock."""
        config, ideal, cosine = self._config, self._config.ideal, self._cosine
        direction = self._beams @ np.array(matrix(scope.attitude(self._mount.q))).T
        hits = cast(scope, p_NS, direction, 1.05 * high / cosine)
        ranges: list[float] = hits.distance.tolist()
        v_S, v_water_S = self._velocities(scope, p_NS)
        n = len(ranges)
        noise = [[0.0] * n] * 3 if ideal else self.rng.standard_normal((3, n)).tolist()
        stretch = self.settings.sound_speed / c if self.settings.sound_speed and not ideal else 1.0
        gain = stretch * (1.0 if ideal else 1.0 + self.memory.scale)
        if self.settings.tracking != "water":
            snr = [math.inf] * n if ideal else self._snr(scope, ranges, hits, direction, p_NS[2])
            locks, speeds, seen = [], [], []
            beams = zip(self._listed, ranges, hits.body.tolist(), snr, noise[0], noise[1], strict=True)
            for (ux, uy, uz), r, body, s, e, f in beams:
                vx, vy, vz = v_water_S if body == SURFACE else v_S
                speed = ux * vx + uy * vy + uz * vz
                locks.append(low <= r * cosine <= high and abs(speed) <= config.max_speed_mps and s >= THRESHOLD)
                # An echo near the noise counts for less.
                speeds.append(gain * speed + config.beam_sigma_mps * (1.0 + 1.0 / max(s, THRESHOLD)) * e)
                seen.append(stretch * r + config.range_sigma_m * f)
            if config.false_echo_probability > 0.0 and not ideal:
                self._mistake(locks, speeds, seen, low / cosine)
            self._bottom(reading, locks, speeds, seen)
        if self.settings.tracking != "bottom" and config.water_far_m <= _CLEAR * min(ranges) * cosine:
            sigma, (vx, vy, vz) = config.water_sigma_mps, v_water_S
            beams_and_noise = zip(self._listed, noise[2], strict=True)
            drawn = [gain * (ux * vx + uy * vy + uz * vz) + sigma * e for (ux, uy, uz), e in beams_and_noise]
            reading.values[7] = _times(self._solution(self._all).inverse, drawn)
        heard = [r for r in ranges if r < math.inf]
        return max(heard) if heard else 0.0

    def _velocities(self, scope: Scope, p_NS: Vec3) -> tuple[Vec3, Vec3]:
        """Of the mount over ground and relative to the water, in S."""
        v_S = rotate(self._to_S, scope.velocity_of(self._mount.p))
        current_S = rotate(self._to_S, rotate(conjugate(scope.q_NB), scope.water.velocity(p_NS, scope.t)))
        return v_S, (v_S[0] - current_S[0], v_S[1] - current_S[1], v_S[2] - current_S[2])

    def _snr(self, scope: Scope, ranges: list[float], hits: Hits, direction: FloatArray, z: float) -> list[float]:
        """Signal over noise of each beam: an extended bottom loses 20 lg r + 2 alpha r; at the largest altitude sediment is just seen."""
        reach = self._config.max_altitude_m / self._cosine
        decay = 0.2 * math.log(10.0) * self._absorption.at(scope, z)
        scale = THRESHOLD / (MU_SEDIMENT * self._cosine**2) * reach * reach
        return [
            scale * back / (r * r + 1e-6) * math.exp(decay * (reach - r)) if r < math.inf else 0.0
            for r, back in zip(ranges, scattering(scope, hits, direction).tolist(), strict=True)
        ]

    def _mistake(self, locks: list[bool], speeds: list[float], seen: list[float], nearest: float) -> None:
        drawn = self.rng.random((2, len(locks))).tolist()
        wrong = self.rng.normal(0.0, self._config.false_echo_sigma_mps, len(locks)).tolist()
        for i, lock in enumerate(locks):
            if lock and drawn[0][i] < self._config.false_echo_probability:
                seen[i] = nearest + drawn[1][i] * max(0.0, seen[i] - nearest)
                speeds[i] += wrong[i]

    def _bottom(self, reading: Measurement, locks: list[bool], speeds: list[float], seen: list[float]) -> None:
        used, values = self._all, reading.values
        if all(locks):
            values[4], values[5] = tuple(speeds), tuple(seen)
        else:
            used = tuple([i for i in self._all if locks[i]])
            values[4] = tuple([s if lock else None for s, lock in zip(speeds, locks, strict=True)])
            values[5] = tuple([s if lock else None for s, lock in zip(seen, locks, strict=True)])
            speeds, seen = [speeds[i] for i in used], [seen[i] for i in used]
        values[6] = tuple(locks)
        if len(used) < 3:
            return
        solution = self._solution(used)
        # 1 / r_i = n . u_i on a plane n . x = 1: the same least squares give its distance along the axis.
        normal_z = sum(map(mul, solution.inverse[2], [1.0 / max(r, 1e-9) for r in seen]))
        if normal_z <= 0.0:
            return
        reading.valid = True
        values[0] = _times(solution.inverse, speeds)
        values[1] = 1.0 / normal_z
        values[2], values[3] = solution.merit, solution.covariance

    def _solution(self, used: tuple[int, ...]) -> _Solution:
        """Least squares over some of the beams; kept, as there are few sets of beams."""
        if used not in self._solutions:
            beams = self._believed[list(used)]
            spread = np.linalg.inv(beams.T @ beams)
            sigma = 0.0 if self._config.ideal else self._config.beam_sigma_mps
            covariance, merit = tuple((sigma * sigma * spread).ravel().tolist()), sigma * math.sqrt(spread.trace())
            self._solutions[used] = _Solution((spread @ beams.T).tolist(), covariance, merit)
        return self._solutions[used]


class _Solution(NamedTuple):
    """From beam velocities to v_S: the inverse (3, n); covariance (9) that the device expects, and the root of its trace."""

    inverse: list[list[float]]
    covariance: tuple[float, ...]
    merit: float


def _times(matrix: list[list[float]], vector: list[float]) -> tuple[float, ...]:
    return tuple([sum(map(mul, row, vector)) for row in matrix])


def _fields(n: int) -> tuple[Field, ...]:
    return (
        Field("v_S", "m/s", "velocity of the mount over ground", "S", (3,)),
        Field("altitude", "m", "distance of the bottom along the axis of the beams"),
        Field("figure_of_merit", "m/s", "standard deviation of v_S that the device expects"),
        Field("covariance_S", "m^2/s^2", "covariance of v_S that the device expects", "S", (3, 3)),
        Field("beam_velocities", "m/s", "velocity along each beam; none without lock", shape=(n,)),
        Field("beam_ranges", "m", "range along each beam; none without lock", shape=(n,)),
        Field("beam_locks", "1", "whether each beam has lock", shape=(n,), type="bool"),
        Field("v_water_S", "m/s", "velocity relative to a layer of water; none when not measured", "S", (3,)),
    )


def _arguments(config: DvlConfig) -> tuple[Argument, ...]:
    low, high = config.min_altitude_m, config.max_altitude_m
    return (
        Argument("max_altitude", "float", "largest altitude", "m", False, minimum=low, maximum=high),
        Argument("range_mode", "int", "number of the range mode to keep; -1 follows the altitude", required=False, minimum=-1),
        Argument("tracking", "str", "what it measures against", required=False, choices=("bottom", "water", "both")),
        Argument("sound_speed", "float", "what the device believes; 0 for the truth", "m/s", False, minimum=0, maximum=2000),
    )  # fmt: skip
