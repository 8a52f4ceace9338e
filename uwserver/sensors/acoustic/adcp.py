"""Acoustic Doppler current profiler: velocity of the water in cells along slanted beams, with bottom track."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from msgspec import UNSET, Meta, UnsetType
from numpy.typing import NDArray

from uwserver.frames import Quat, matrix, multiply, quat_from_rpy
from uwserver.modifiers.base import Measurement, Memory, Number, Time
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.physics.rays.raycast import SURFACE, Hits
from uwserver.ports import Argument, Field, Value
from uwserver.sensors.acoustic.current_profile import Mapping, Solver, points_of, to_levels, weigh, wrap
from uwserver.sensors.acoustic.echo import MU_SEDIMENT, Absorption, cast, load_kernels, scattering
from uwserver.sensors.base import Distance, Pose, Scope, Sensor, SensorTable, Settings, SoundSpeed, blank
from uwserver.table import NonNegative, Positive
from uwserver.units import NANOSECONDS, rad

_LOCK = 4.0
"""Signal over noise (ratio of intensities) at which bottom track has lock: 6 dB, as of the velocity log."""
MOST_PINGS = 256


class AdcpConfig(SensorTable, tag="adcp", kw_only=True, frozen=True):
    """A current profiler. The sensor frame's z points along the axis of the beams, down or up. `rate_hz`: ensembles a second at most.

    Distances are along the axis, as makers give them. The middle of cell k (from 1) lies at `blanking_m` + k `cell_size_m`.

    Attributes:
        ideal: exact means over the cells, as far as each beam is in water.
        frequency_hz: of the sound; absorption depends on it.
        beam_angle_deg: of the slanted beams from the axis.
        beam_azimuth_deg: of each slanted beam about the axis, from x to y.
        axial_beam: one more beam, along the axis; it shows in what beams tell, not in the vectors.
        cells: number of them.
        cell_size_m: of each; the pulse is as long.
        min_cell_size_m, max_cell_size_m: limits of the setting.
        blanking_m: nothing is heard nearer, while the transducer rings.
        max_range_m: where the echo of water has sunk to the noise, with cells of `sigma_cell_m`.
        pings: averaged in an ensemble.
        beam_sigma_mps: white error of a beam's velocity a ping, at a strong echo and cells of `sigma_cell_m`; goes with 1 / cell size.
        sigma_cell_m: cell size to which `beam_sigma_mps` and `max_range_m` belong.
        ambiguity_velocity_mps: velocities along a beam beyond it come back on the other side.
        nominal_correlation: of a strong echo.
        correlation_threshold: a beam's cell is lost below it.
        side_lobe_db: echo of bottom or surface through the side lobes over that of the water.
        scale_sigma: of the velocities, drawn once a run.
        heading_sigma_deg, tilt_sigma_deg: of the device's own attitude, drawn once a run.
        bin_mapping: how cells of tilted beams are sorted into levels of one depth.
        assumed_sound_speed_mps: what the device believes; default: the truth.
        bottom_min_altitude_m, bottom_max_altitude_m: of bottom track; sediment below a level device is just seen at the largest. 0 for none.
        bottom_max_speed_mps: along a beam.
        bottom_sigma_mps, bottom_range_sigma_m: white error of a beam of bottom track, an ensemble.
        processing_s: from the last echo to the delivery.
    """

    ideal: bool = False
    frequency_hz: Positive = 6e5
    beam_angle_deg: Annotated[float, Meta(gt=0, lt=60)] = 20.0
    beam_azimuth_deg: Annotated[tuple[float, ...], Meta(min_length=3, max_length=8)] = (45.0, 135.0, 225.0, 315.0)
    axial_beam: bool = False
    cells: Annotated[int, Meta(ge=1, le=256)] = 30
    cell_size_m: Positive = 1.0
    min_cell_size_m: Positive = 0.1
    max_cell_size_m: Positive = 16.0
    blanking_m: NonNegative = 0.5
    max_range_m: Positive = 40.0
    pings: Annotated[int, Meta(ge=1, le=MOST_PINGS)] = 1
    beam_sigma_mps: NonNegative = 0.03
    sigma_cell_m: Positive = 1.0
    ambiguity_velocity_mps: Positive = 5.0
    nominal_correlation: Annotated[float, Meta(gt=0, lt=1)] = 0.5
    correlation_threshold: Annotated[float, Meta(gt=0, lt=1)] = 0.25
    side_lobe_db: float = 10.0
    scale_sigma: NonNegative = 0.0
    heading_sigma_deg: NonNegative = 0.0
    tilt_sigma_deg: NonNegative = 0.0
    bin_mapping: Mapping = "linear"
    assumed_sound_speed_mps: Positive | UnsetType = UNSET
    bottom_min_altitude_m: NonNegative = 0.5
    bottom_max_altitude_m: NonNegative = 80.0
    bottom_max_speed_mps: Positive = 10.0
    bottom_sigma_mps: NonNegative = 0.005
    bottom_range_sigma_m: NonNegative = 0.02
    processing_s: NonNegative = 0.0

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        if not self.min_cell_size_m <= self.cell_size_m <= self.max_cell_size_m:
            raise ValueError("cell_size_m must lie between min_cell_size_m and max_cell_size_m")
        if not self.correlation_threshold < self.nominal_correlation:
            raise ValueError("correlation_threshold must be less than nominal_correlation, else every cell is lost")
        if 0.0 < self.bottom_max_altitude_m <= self.bottom_min_altitude_m:
            raise ValueError(
                "bottom_max_altitude_m must be more than bottom_min_altitude_m, or 0 to leave out bottom track"
            )
        if np.linalg.matrix_rank(_directions(self), tol=1e-3) < 3:
            raise ValueError("beam_azimuth_deg: three beams must point to different sides, else they give no vector")

    def build(self, mount: Pose) -> Adcp:
        return Adcp(mount, self)


class AdcpSettings(Settings, frozen=True):
    """See `AdcpConfig`; `sound_speed` 0 stands for the truth."""

    cell_size: Distance
    blanking: Annotated[float, Meta(ge=0, le=1e6)]
    pings: Annotated[int, Meta(ge=1, le=MOST_PINGS)]
    sound_speed: SoundSpeed


class AdcpMemory(Memory):
    """Attributes:
    ready: time of the next ensemble, s.
    scale: error of the velocities in this run (0.01 shows 1 % too much).
    tilt: error of the attitude in this run: about x and y of S, and about the vertical, rad."""

    ready: Time = 0.0
    scale: Number = 0.0
    tilt: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


class _Instant:
    """One ensemble's view: where the device is, where its beams point, and how sound goes. Vectors in N as rows."""

    def __init__(self, scope: Scope, mount: Pose, beams: FloatArray) -> None:
        self.scope, self.p = scope, scope.position(mount.p)
        self.q: Quat = scope.attitude(mount.q)
        self.beams: FloatArray = beams @ np.array(matrix(self.q)).T
        self.v: FloatArray = np.array(matrix(scope.q_NB)) @ np.array(scope.velocity_of(mount.p))
        self.c = scope.water.sound_speed(self.p[2])


class Adcp(Sensor):
    """A profile of the water's velocity, relative to the device and over ground, and what each beam saw."""

    doc = (
        "Current profiler: velocity of the water in cells along its beams, relative to the mount and, with bottom track, over ground; velocity "
        "of the mount over ground and altitude; velocity, echo and correlation of each beam. Valid with at least one cell."
    )
    settings: AdcpSettings
    memory: AdcpMemory
    paces = True  # an ideal one does not look at the errors that its memory holds besides

    def __init__(self, mount: Pose, config: AdcpConfig) -> None:
        self._mount, self._config = mount, config
        slanted = _directions(config)
        self._slanted, self._cosine = len(slanted), math.cos(rad(config.beam_angle_deg))
        self._beams: FloatArray = np.vstack([slanted, [[0.0, 0.0, 1.0]]]) if config.axial_beam else slanted
        self._solver, self._absorption = Solver(slanted), Absorption(config.frequency_hz)
        self.fields, self.arguments = _fields(config.cells, self._slanted, len(self._beams)), _arguments(config)
        speed = 0.0 if config.assumed_sound_speed_mps is UNSET else config.assumed_sound_speed_mps
        super().__init__(AdcpSettings(config.cell_size_m, config.blanking_m, config.pings, speed))

    def load_kernels(self) -> None:
        load_kernels()

    def turn_on(self) -> AdcpMemory:
        """Ready at once, with the errors of this run."""
        c = self._config
        scale, *tilt = self.rng.standard_normal(4).tolist()
        level, heading = rad(c.tilt_sigma_deg), rad(c.heading_sigma_deg)
        return AdcpMemory(0.0, c.scale_sigma * scale, (level * tilt[0], level * tilt[1], heading * tilt[2]))

    def sense(self, scope: Scope) -> Measurement | None:
        """An ensemble; None while the last one is not over."""
        now, s = scope.t, self.settings
        if now < self.memory.ready - 1e-6:
            return None
        at = _Instant(scope.without_own_body(), self._mount, self._beams)
        distances: FloatArray = s.blanking + s.cell_size * np.arange(1, self._config.cells + 1, dtype=np.float64)
        farthest = (float(distances[-1]) + 0.5 * s.cell_size) / self._cosine
        travel = 2.0 * max(farthest, self._config.bottom_max_altitude_m / self._cosine) / at.c
        self.memory.ready = now + s.pings * travel
        values = blank(self.fields)
        values[0] = tuple(distances.tolist())
        reading = Measurement(values, False, round((s.pings * travel + self._config.processing_s) * NANOSECONDS))
        if scope.submergence(at.p) > 0.0:
            reading.valid = self._profile(at, distances, values)
        return reading

    # -- what is there ------------------------------------------------------------------------------------------------------------------

    def _profile(self, at: _Instant, distances: FloatArray, values: list[Value]) -> bool:
        """Fill in the values; whether a cell has a velocity."""
        config, s, n = self._config, self.settings, self._slanted
        stretch = s.sound_speed / at.c if s.sound_speed > 0.0 and not config.ideal else 1.0
        slant = self._beams[:, 2:3]
        # The device places an echo by the speed of sound that it believes in.
        points = points_of(distances, s.cell_size) / slant / stretch
        reach = max(float(points[:, -1].max()), 1.1 * config.bottom_max_altitude_m / float(slant.min()))
        hits = cast(at.scope, at.p, at.beams, reach)
        decay = self._absorption.at(at.scope, at.p[2])
        beams, strength = self._hear(at, points, hits, decay)
        gain = stretch * (1.0 if config.ideal else 1.0 + self.memory.scale)
        with np.errstate(invalid="ignore"):
            correlation = config.nominal_correlation / (1.0 + 1.0 / strength)
            if not config.ideal:
                beams = np.where(correlation >= config.correlation_threshold, beams, np.nan)
                beams = self._pings(beams, correlation)
        beams = gain * beams
        R = np.array(matrix(self._believed(at.q)))
        down = (self._beams[:n] @ R.T)[:, 2] / self._beams[:n, 2]
        mapped = to_levels(beams[:n], down, s.blanking, s.cell_size, config.bin_mapping)
        velocity = self._solver.solve(mapped)
        values[1] = _numbers(velocity)
        values[3] = _numbers(self._solver.errors(mapped))
        values[4] = _numbers(beams.T)
        with np.errstate(divide="ignore", invalid="ignore"):
            values[5] = _numbers(10.0 * np.log10(strength).T)
        values[6] = _numbers(correlation.T)
        ground = self._track_bottom(at, hits, decay, stretch, gain, values)
        if ground is not None:
            values[2] = _numbers((velocity + ground) @ R.T)
        return bool(np.isfinite(velocity[:, 0]).any())

    def _hear(self, at: _Instant, points: FloatArray, hits: Hits, decay: float) -> tuple[FloatArray, FloatArray]:
        """(beams, cells) velocity of the water along each beam, m/s, and signal over noise; nan behind what a beam meets.

        Args:
            at: the instant.
            points: (beams, 2 cells + 1) ranges, m.
            hits: of the beams.
            decay: dB/m.
        """
        config, before = self._config, points < hits.distance[:, None]
        velocity = np.where(before, self._flow(at, points, before), np.nan)
        if config.ideal:
            return weigh(velocity), weigh(np.where(before, math.inf, np.nan))
        reach = config.max_range_m / self._beams[:, 2:3]
        middle = points[:, 1::2]
        spread = (reach / np.maximum(middle, 1e-3)) ** 2 * 10.0 ** (0.2 * decay * (reach - middle))
        strength = spread * self.settings.cell_size / config.sigma_cell_m
        near, toward = self._nearest(at, hits, float(points.max()))
        # Beyond the shortest way to bottom or surface, their echo through the side lobes arrives together with that of the water.
        leak = np.where(points > near, 10.0 ** (0.1 * config.side_lobe_db), 0.0)
        total = weigh(1.0 + leak)
        boundary = -float(at.v @ toward)
        mixed = weigh(velocity + leak * boundary) / total
        return mixed, np.where(np.isfinite(mixed), strength * total, np.nan)

    def _flow(self, at: _Instant, points: FloatArray, before: NDArray[np.bool_]) -> FloatArray:
        """(beams, points) velocity of the water relative to the device along each beam, m/s; 0 where nobody asks."""
        water, t, out = at.scope.water, at.scope.t, np.zeros(points.shape)
        if water.sea is None:
            out[:] = (at.beams @ (np.array(water.current) - at.v))[:, None]
            return out
        for i, beam in enumerate(at.beams):
            places = np.array(at.p) + points[i, before[i], None] * beam
            flow = np.array([water.velocity((x, y, z), t) for x, y, z in places.tolist()]).reshape(-1, 3)
            out[i, before[i]] = (flow - at.v) @ beam
        return out

    def _nearest(self, at: _Instant, hits: Hits, reach: float) -> tuple[float, FloatArray]:
        """Shortest distance (m) to bottom or surface before the device, and the unit vector (N) towards it; inf and zeros for none.

        Asked along the vertical and square to what the beams meet, which is exact where that is plane.
        """
        axis = np.array(matrix(at.q))[:, 2]
        ways = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), axis, *-hits.normal[np.isfinite(hits.distance)]]
        directions = np.array([way for way in ways if np.dot(way, axis) > 1e-6])
        found = cast(at.scope, at.p, directions, reach)
        k = int(np.argmin(found.distance))
        return float(found.distance[k]), directions[k] if math.isfinite(found.distance[k]) else np.zeros(3)

    # -- what the device makes of it ----------------------------------------------------------------------------------------------------

    def _pings(self, beams: FloatArray, correlation: FloatArray) -> FloatArray:
        """(beams, cells) mean of the pings' velocities, each with its noise and on its side of the ambiguity."""
        c, s = self._config, self.settings
        # Variance of a pulse pair's phase: (1 / rho^2 - 1) / 2M, so that a weak echo is told worse.
        worse = np.sqrt((correlation**-2.0 - 1.0) / (c.nominal_correlation**-2.0 - 1.0))
        sigma = c.beam_sigma_mps * c.sigma_cell_m / s.cell_size * worse
        noise = self.rng.standard_normal((s.pings, *beams.shape))
        mean: FloatArray = wrap(beams + sigma * noise, c.ambiguity_velocity_mps).mean(axis=0)
        return mean

    def _believed(self, q_NS: Quat) -> Quat:
        """Attitude by the device's own compass and tilt sensors."""
        if self._config.ideal:
            return q_NS
        x, y, heading = self.memory.tilt
        return multiply(quat_from_rpy(0.0, 0.0, heading), multiply(q_NS, quat_from_rpy(x, y, 0.0)))

    def _track_bottom(
        self, at: _Instant, hits: Hits, decay: float, stretch: float, gain: float, values: list[Value]
    ) -> FloatArray | None:
        """Fill in the values of bottom track; (3) velocity of the mount over ground, S, or None without lock of three beams."""
        c, n = self._config, self._slanted
        noise = self.rng.standard_normal((2, n))
        r = hits.distance[:n]
        speed, cosine = at.beams[:n] @ at.v, self._beams[:n, 2]
        lock = (r * cosine >= c.bottom_min_altitude_m) & (r * cosine <= c.bottom_max_altitude_m)
        lock &= (np.abs(speed) <= c.bottom_max_speed_mps) & (hits.body[:n] != SURFACE)
        if not c.ideal:
            reach = c.bottom_max_altitude_m / cosine
            back = scattering(at.scope, hits, at.beams)[:n] / (MU_SEDIMENT * cosine**2)
            with np.errstate(invalid="ignore", over="ignore"):
                strength = _LOCK * back * (reach / np.maximum(r, 1e-3)) ** 2 * 10.0 ** (0.2 * decay * (reach - r))
            lock &= strength >= _LOCK
            speed = gain * speed + c.bottom_sigma_mps * noise[0]
            r = np.maximum(stretch * r + c.bottom_range_sigma_m * noise[1], 1e-3)
        ranges = np.where(lock, r, np.nan)
        values[9] = _numbers(ranges)
        altitude = self._solver.altitude(ranges)
        if altitude is None:
            return None
        ground: FloatArray = self._solver.solve(np.where(lock, speed, np.nan)[:, None])[0]
        values[7], values[8] = _numbers(ground), altitude
        return ground


def _directions(config: AdcpConfig) -> FloatArray:
    """(beams, 3) slanted beams in S."""
    angle = rad(config.beam_angle_deg)
    across = math.sin(angle)
    turns = [rad(a) for a in config.beam_azimuth_deg]
    return np.array([(across * math.cos(a), across * math.sin(a), math.cos(angle)) for a in turns])


def _numbers(values: FloatArray) -> tuple[float | None, ...]:
    """Row by row; None for what is not finite."""
    return tuple(v if math.isfinite(v) else None for v in values.ravel().tolist())


def _fields(cells: int, slanted: int, beams: int) -> tuple[Field, ...]:
    return (
        Field("distances", "m", "middle of each cell: vertically from the device where cells are mapped, else along its axis", shape=(cells,)),
        Field("velocities_S", "m/s", "of the water relative to the mount; none without three beams", "S", (cells, 3)),
        Field("velocities_N", "m/s", "of the water over ground, by bottom track and the device's own attitude", "N", (cells, 3)),
        Field("error_velocities", "m/s", "what four beams disagree by; as noisy as a horizontal component", shape=(cells,)),
        Field("beam_velocities", "m/s", "of the water relative to the mount, away along each beam; axial beam last", shape=(cells, beams)),
        Field("echoes", "dB", "of each cell and beam, over the noise", shape=(cells, beams)),
        Field("correlations", "1", "of each cell and beam", shape=(cells, beams)),
        Field("v_S", "m/s", "velocity of the mount over ground by bottom track", "S", (3,)),
        Field("altitude", "m", "distance of the bottom along the axis of the beams"),
        Field("beam_ranges", "m", "range of the bottom along each slanted beam; none without lock", shape=(slanted,)),
    )  # fmt: skip


def _arguments(config: AdcpConfig) -> tuple[Argument, ...]:
    low, high = config.min_cell_size_m, config.max_cell_size_m
    return (
        Argument("cell_size", "float", "size of a cell along the axis", "m", False, minimum=low, maximum=high),
        Argument("blanking", "float", "nothing is heard nearer", "m", False, minimum=0, maximum=100),
        Argument("pings", "int", "averaged in an ensemble", required=False, minimum=1, maximum=MOST_PINGS),
        Argument("sound_speed", "float", "what the device believes; 0 for the truth", "m/s", False, minimum=0, maximum=2000),
    )  # fmt: skip
