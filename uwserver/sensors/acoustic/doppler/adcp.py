"""Acoustic Doppler current profiler: velocity of the water in cells along slanted beams, with bottom track."""

from __future__ import annotations

import math
from typing import Annotated, Any, get_args

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from uwserver.environment.column import SOUND_SPEED
from uwserver.frames import Quat
from uwserver.modifiers.base import Memory, Number, Time
from uwserver.modifiers.columns import columns_of
from uwserver.modifiers.operations import rounded_ns
from uwserver.physics.kernel.arrays import Array, FloatArray
from uwserver.physics.kernel.deferred import compiled, entry
from uwserver.ports import Argument, BeamView, Field
from uwserver.sensors.acoustic.doppler.cell_echoes import (
    BEAM_VELOCITIES,
    DISTANCES,
    ERRORS,
    MOST_BEAMS,
    V_S,
    VELOCITIES_N,
    VELOCITIES_S,
    boundary_of,
    ensemble_of,
    hear_cells,
    keep_hits,
    point_beams,
    point_to_boundaries,
    reach_of_beams,
    reach_of_cells,
    track_bottom,
)
from uwserver.sensors.acoustic.doppler.janus import Mapping, directions_of, slanted, solve_levels
from uwserver.sensors.acoustic.echo import SOUND_SPEED_ARGUMENT, fill_row, or_truth, pings
from uwserver.sensors.base import Distance, Pose, SensorTable, Settings, SoundSpeed, Traits
from uwserver.sensors.compiled import (
    MISSING,
    CompiledSensor,
    SensorKernel,
    aim_loop,
    multiply,
    p_NS,
    quat_from_rpy,
    ray_loop,
    record,
    rotate,
    water_property,
)
from uwserver.table import NonNegative, Positive
from uwserver.units import rad

MOST_PINGS = 256


class AdcpConfig(SensorTable, tag="adcp", kw_only=True, frozen=True):
    """A current profiler. The sensor frame's z points along the axis of the beams, down or up.

    `rate_hz` is an upper limit of ensembles a second. Distances are along the axis, as in data sheets.
    The middle of cell k (from 1) lies at `blanking_m` + k `cell_size_m`.

    Attributes:
        ideal: exact means over the cells, as far as each beam is in the water.
        frequency_hz: frequency of the sound; absorption depends on it.
        beam_angle_deg: angle of the slanted beams from the axis.
        beam_azimuth_deg: azimuth of each slanted beam about the axis, from x to y.
        axial_beam: one more beam along the axis; it counts in the values of single beams, not in the vectors.
        cells: number of cells.
        cell_size_m: length of a cell, and of the pulse.
        min_cell_size_m, max_cell_size_m: limits of the setting.
        blanking_m: nearer than this nothing is heard, as the transducer still rings.
        max_range_m: range at which the echo of the water is as weak as the noise, with cells of `sigma_cell_m`.
        pings: averaged in an ensemble.
        beam_sigma_mps: white error of a beam's velocity per ping, at a strong echo and with cells of `sigma_cell_m`; proportional to 1 / cell size.
        sigma_cell_m: cell size to which `beam_sigma_mps` and `max_range_m` belong.
        ambiguity_velocity_mps: a velocity along a beam beyond this limit appears with the other sign.
        nominal_correlation: correlation of a strong echo.
        correlation_threshold: below it the cell of a beam has no velocity.
        side_lobe_db: echo of bottom or surface through the side lobes, relative to the echo of the water.
        scale_sigma: standard deviation of the scale error of the velocities, drawn once a run.
        heading_sigma_deg, tilt_sigma_deg: standard deviations of the errors of the device's own attitude, drawn once a run.
        bin_mapping: how cells of tilted beams are sorted into levels of one depth.
        assumed_sound_speed_mps: sound speed that the device believes; default: the true one.
        bottom_min_altitude_m, bottom_max_altitude_m: limits of bottom track; at the largest, sediment below a level device is just detected; 0: none.
        bottom_max_speed_mps: largest speed of bottom track along a beam.
        bottom_sigma_mps, bottom_range_sigma_m: white error of a beam of bottom track per ensemble.
        processing_s: time from the last echo to the delivery.
    """

    message = "CurrentProfile"
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
        """Raise ValueError if keys contradict each other."""
        if not self.min_cell_size_m <= self.cell_size_m <= self.max_cell_size_m:
            raise ValueError("cell_size_m must lie between min_cell_size_m and max_cell_size_m")
        if not self.correlation_threshold < self.nominal_correlation:
            raise ValueError("correlation_threshold must be less than nominal_correlation, else every cell is lost")
        if 0.0 < self.bottom_max_altitude_m <= self.bottom_min_altitude_m:
            raise ValueError(
                "bottom_max_altitude_m must be more than bottom_min_altitude_m, or 0 to leave out bottom track"
            )
        if np.linalg.matrix_rank(directions_of(rad(self.beam_angle_deg), self.beam_azimuth_deg), tol=1e-3) < 3:
            raise ValueError("beam_azimuth_deg: three beams must point to different sides, else they give no vector")

    def traits(self) -> Traits:
        """Return its stages of compiled code, and its beams up to the largest range."""
        near, far, tilt = self.blanking_m, self.max_range_m, rad(self.beam_angle_deg)
        beams = slanted(tilt, self.beam_azimuth_deg, near / math.cos(tilt), far / math.cos(tilt))
        axial = (BeamView((0.0, 0.0, 1.0), 0.0, near, far),) if self.axial_beam else ()
        return Traits(("soundings",), beams=(*beams, *axial))

    def build(self, mount: Pose) -> Adcp:
        return Adcp(mount, self)


class AdcpSettings(Settings, frozen=True):
    """See `AdcpConfig`; `sound_speed` 0 stands for the true one."""

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


_RECORD = record(
    [
        ("slanted", "i8"), ("beams", "i8"), ("direction", "f8", (MOST_BEAMS, 3)), ("disagreement", "f8", (MOST_BEAMS,)), ("place", "i8", (10,)),
        ("cosine", "f8"), ("frequency", "f8"), ("cells", "i8"), ("cell", "f8"), ("blanking", "f8"), ("range", "f8"), ("pings", "i8"),
        ("sigma", "f8"), ("sigma_cell", "f8"), ("ambiguity", "f8"), ("nominal", "f8"), ("least_correlation", "f8"), ("side_lobe", "f8"),
        ("mapping", "i8"), ("sound_speed", "f8"), ("bottom_low", "f8"), ("bottom_high", "f8"), ("bottom_speed", "f8"), ("bottom_sigma", "f8"),
        ("bottom_range_sigma", "f8"), ("processing", "f8"),
        # Of this ensemble: whether it pings; and of each beam what it hits: distance, normal, whether it is the surface, how strongly it scatters.
        ("pings_now", "i8"), ("distance", "f8", (MOST_BEAMS,)), ("normal", "f8", (MOST_BEAMS, 3)), ("surface", "i8", (MOST_BEAMS,)),
        ("back", "f8", (MOST_BEAMS,)),
    ],
    [("ready", "f8"), ("scale", "f8"), ("tilt", "f8", (3,))],
)  # fmt: skip


@compiled
def aim(
    head: Any, row: Any, surroundings: Array, t: float, origin: Array, direction: Array, count: int
) -> tuple[int, float]:  # fmt: skip
    """Lay the beams if the device pings."""
    row.pings_now = 1 if pings(head, row, surroundings, t) else 0
    if row.pings_now == 0:
        return count, 0.0
    point_beams(head, row, surroundings, origin, direction, count)
    return count + row.beams, reach_of_beams(head, row, surroundings)


@entry
def aim_at_boundaries(
    heads: Array, rows: Array, numbers: Array, due: Array, surroundings: Array, t: float, origin: Array, direction: Array, first: Array, hits: Any
) -> float:  # fmt: skip
    """Lay rays to the nearest bottom or surface, whose echo comes in through the side lobes. An ideal device has no side lobes."""
    for n, k in enumerate(due):
        if rows[heads[k].row].pings_now != 0:
            keep_hits(heads[k], rows[heads[k].row], surroundings, t, direction, first[n], hits)
    count, reach = 0, 0.0
    for n, k in enumerate(due):
        head, row = heads[k], rows[heads[k].row]
        first[n] = count
        if row.pings_now != 0 and head.exact == 0:
            count += point_to_boundaries(head, row, surroundings, origin, direction, count)
            reach = max(reach, reach_of_cells(head, row, surroundings))
    first[len(due)] = count
    return reach


@compiled
def _believed(head: Any, row: Any, q: Quat) -> Quat:
    """Return the attitude that the device's own compass and tilt sensors measure."""
    if head.exact != 0:
        return q
    tilt = row.m.tilt
    seen: Quat = multiply(quat_from_rpy(0.0, 0.0, tilt[2]), multiply(q, quat_from_rpy(tilt[0], tilt[1], 0.0)))
    return seen


@compiled
def _turn_to_ground(row: Any, q: Quat, out: Array) -> None:
    """Write velocities over ground in N: velocities relative to the device plus its own velocity by bottom track."""
    v, first, over_ground = row.place[V_S], row.place[VELOCITIES_S], row.place[VELOCITIES_N]
    for k in range(0, 3 * row.cells, 3):
        x, y, z = out[first + k] + out[v], out[first + k + 1] + out[v + 1], out[first + k + 2] + out[v + 2]
        out[over_ground + k], out[over_ground + k + 1], out[over_ground + k + 2] = rotate(q, (x, y, z))


@compiled
def _profile(
    head: Any, row: Any, surroundings: Array, t: float, direction: Array, begin: int, end: int, hits: Any, out: Array
) -> bool:
    """Write the values of an ensemble. Returns whether a cell has a velocity."""
    ensemble, place = ensemble_of(head, row, surroundings, t), row.place
    boundary = boundary_of(head, row, surroundings, ensemble, direction, begin, end, hits)
    hear_cells(head, row, surroundings, ensemble, boundary, out)
    q, down = _believed(head, row, ensemble.q), np.empty(row.slanted)
    for i in range(row.slanted):
        beam = row.direction[i]
        down[i] = rotate(q, (beam[0], beam[1], beam[2]))[2] / beam[2]
    along = out[place[BEAM_VELOCITIES] : place[BEAM_VELOCITIES] + row.cells * row.beams]
    velocities = out[place[VELOCITIES_S] : place[VELOCITIES_S] + 3 * row.cells]
    found = solve_levels(row, along, down, velocities, out[place[ERRORS] : place[ERRORS] + row.cells])
    if track_bottom(head, row, ensemble, out):
        _turn_to_ground(row, q, out)
    return bool(found)


@compiled
def measure(
    head: Any, row: Any, surroundings: Array, t: float, out: Array, direction: Array, begin: int, end: int, hits: Any
) -> None:  # fmt: skip
    """Read the profile if the device pings."""
    out[:], head.valid = MISSING, 0
    for cell in range(row.cells):
        out[row.place[DISTANCES] + cell] = row.blanking + row.cell * (cell + 1)
    farthest = max(row.blanking + row.cell * row.cells + 0.5 * row.cell, row.bottom_high) / row.cosine
    travel = 2.0 * farthest / water_property(surroundings, SOUND_SPEED, p_NS(head, surroundings)[2])
    row.m.ready = t + row.pings * travel
    head.delay_ns = rounded_ns(row.pings * travel + row.processing)
    if row.pings_now != 0:
        head.valid = 1 if _profile(head, row, surroundings, t, direction, begin, end, hits, out) else 0


class Adcp(CompiledSensor):
    """Gives a profile of the water's velocity, relative to the device and over ground, and what each beam measured."""

    doc = (
        "Current profiler: velocity of the water in cells along its beams, relative to the mount and, with bottom track, over ground; velocity "
        "of the mount over ground and altitude; velocity, echo and correlation of each beam. Valid with at least one cell."
    )
    kernel = SensorKernel(_RECORD, ray_loop(measure), (aim_loop(aim), aim_at_boundaries))
    random = ("sigma", "bottom_sigma", "bottom_range_sigma")
    memory_type = AdcpMemory
    settings: AdcpSettings

    def __init__(self, mount: Pose, config: AdcpConfig) -> None:
        slanted = directions_of(rad(config.beam_angle_deg), config.beam_azimuth_deg)
        self._config, self.exact = config, config.ideal
        self._beams: FloatArray = np.vstack([slanted, [[0.0, 0.0, 1.0]]]) if config.axial_beam else slanted
        self._disagreement = _disagreement(slanted)
        self.rays = len(self._beams) + 3  # along the normal of what each beam hits, up, down, and along the axis
        self.fields = _fields(config.cells, len(slanted), len(self._beams))
        low, high = config.min_cell_size_m, config.max_cell_size_m
        self.arguments = (
            Argument("cell_size", "float", "size of a cell along the axis", "m", False, minimum=low, maximum=high),
            Argument("blanking", "float", "nothing is heard nearer", "m", False, minimum=0, maximum=100),
            Argument("pings", "int", "averaged in an ensemble", required=False, minimum=1, maximum=MOST_PINGS),
            SOUND_SPEED_ARGUMENT,
        )
        speed = or_truth(config.assumed_sound_speed_mps)
        super().__init__(mount, AdcpSettings(config.cell_size_m, config.blanking_m, config.pings, speed))

    def fill(self, row: Any) -> None:
        c, s, n = self._config, self.settings, len(self._beams)
        row["direction"][:n], row["disagreement"][: len(self._disagreement)] = self._beams, self._disagreement
        fill_row(
            row, slanted=len(c.beam_azimuth_deg), beams=n, cells=c.cells, place=columns_of(self.fields).first,
            cosine=math.cos(rad(c.beam_angle_deg)), frequency=c.frequency_hz, range=c.max_range_m,
            mapping=get_args(Mapping).index(c.bin_mapping), cell=s.cell_size, blanking=s.blanking, pings=s.pings,
            sound_speed=s.sound_speed, sigma=c.beam_sigma_mps, sigma_cell=c.sigma_cell_m, ambiguity=c.ambiguity_velocity_mps,
            nominal=c.nominal_correlation, least_correlation=c.correlation_threshold, side_lobe=10.0 ** (0.1 * c.side_lobe_db),
            processing=c.processing_s, bottom_low=c.bottom_min_altitude_m, bottom_high=c.bottom_max_altitude_m,
            bottom_speed=c.bottom_max_speed_mps, bottom_sigma=c.bottom_sigma_mps, bottom_range_sigma=c.bottom_range_sigma_m,
        )  # fmt: skip

    def turn_on_row(self, memory: Any) -> None:
        """Make the device ready at once, and draw its errors of this run."""
        c = self._config
        level, heading = rad(c.tilt_sigma_deg), rad(c.heading_sigma_deg)
        memory["scale"], *tilt = np.array((c.scale_sigma, level, level, heading)) * self.drawn(4)
        memory["tilt"] = tilt


def _disagreement(directions: FloatArray) -> FloatArray:
    """Return (beams) weights of the error velocity of four beams, which make it as noisy as a horizontal component; NaN for other numbers."""
    if len(directions) != 4:
        return np.full(len(directions), np.nan)
    null: FloatArray = np.linalg.svd(directions.T)[2][-1]
    across = np.hypot(directions[0, 0], directions[0, 1])
    weights: FloatArray = null * np.copysign(1.0, null[0]) / (np.sqrt(2.0) * across)
    return weights


def _fields(cells: int, slanted: int, beams: int) -> tuple[Field, ...]:
    return (
        Field("distances", "m", "middle of each cell: vertically from the device where cells are mapped, else along its axis", shape=(cells,)),
        Field("velocities_S", "m/s", "of the water relative to the mount; none without three beams", "S", (cells, 3)),
        Field("velocities_N", "m/s", "of the water over ground, by bottom track and the device's own attitude", "N", (cells, 3)),
        Field("error_velocities", "m/s", "error velocity of four beams; as noisy as a horizontal component", shape=(cells,)),
        Field("beam_velocities", "m/s", "of the water relative to the mount, away along each beam; axial beam last", shape=(cells, beams)),
        Field("echoes", "dB", "of each cell and beam, over the noise", shape=(cells, beams)),
        Field("correlations", "1", "of each cell and beam", shape=(cells, beams)),
        Field("v_S", "m/s", "velocity of the mount over ground by bottom track", "S", (3,)),
        Field("altitude", "m", "distance of the bottom along the axis of the beams"),
        Field("beam_ranges", "m", "range of the bottom along each slanted beam; none without lock", shape=(slanted,)),
    )  # fmt: skip
