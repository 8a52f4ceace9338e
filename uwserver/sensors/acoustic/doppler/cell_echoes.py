"""What the beams of a current profiler hear (compiled): the water in their cells, bottom and surface through their side lobes, and the bottom ahead.

In all functions `head` is the row of the sensor in `compiled.HEAD`, `row` its record (see `adcp`), and `surroundings` what it sees.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uwserver.environment.column import SOUND_SPEED
from uwserver.frames import Quat, Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.physics.kernel.random import SAMPLE, normals
from uwserver.physics.rays.raycast import SURFACE
from uwserver.sensors.acoustic.doppler.janus import altitude_of, count_values, inverse_of, vector_of
from uwserver.sensors.acoustic.echo import MU_SEDIMENT, lay_ray
from uwserver.sensors.compiled import (
    echo_of,
    meet_surface,
    p_NS,
    place_of,
    q_NB,
    q_NS,
    rotate,
    sound_absorption,
    submergence,
    velocity_of,
    water_property,
    water_velocity,
)

MOST_BEAMS = 9
"""Eight slanted beams and the axial one."""
_PINGS = 16
"""First lane of random numbers for cells: one lane for each two pings of each beam and cell. The lanes of bottom track begin at 0, one a beam."""

DISTANCES, VELOCITIES_S, VELOCITIES_N, ERRORS, BEAM_VELOCITIES, ECHOES, CORRELATIONS, V_S, ALTITUDE, BEAM_RANGES = (
    range(10)
)
"""Numbers of the fields of a reading. `place` of a record says where each begins among the numbers of a reading."""


@compiled
def point_of(blanking: float, cell: float, j: int) -> float:
    """Return the distance (m) of point j, at which the water is sampled.

    Points 1, 3, ... are the middles of the cells. The others lie halfway between them, the first one at the front of the first cell.

    Args:
        blanking: distance before the first cell, m; its middle is one cell farther.
        cell: size of a cell, m.
        j: from 0 to twice the number of cells.
    """
    return float((blanking + cell) - 0.5 * cell + 0.5 * cell * j)


@compiled
def weigh(front: float, middle: float, back: float) -> float:
    """Return the mean over a cell from its three points.

    Gating a pulse as long as the cell weighs the water with a triangle two cells long. Equal weights of the middle and of the points half a cell away
    have the same second moment, so the mean is exact for cubics. A cell with a missing point (NaN) is missing.
    """
    return (front + middle + back) / 3.0


@compiled
def wrap(velocity: float, ambiguity: float) -> float:
    """Return a velocity as its phase shows it, between -ambiguity and +ambiguity, m/s."""
    return float((velocity + ambiguity) % (2.0 * ambiguity) - ambiguity)


class Ensemble(NamedTuple):
    """What all beams of an ensemble have in common. Vectors in N.

    Attributes:
        p, q, v: position (m), attitude and velocity (m/s) of the device.
        t: s.
        stretch: believed over true sound speed; the device takes so many metres for one.
        gain: measured over true velocity.
        decay: absorption, dB/m.
    """

    p: Vec3
    q: Quat
    v: Vec3
    t: float
    stretch: float
    gain: float
    decay: float


@compiled
def _stretch(head: Any, row: Any, surroundings: Array) -> float:
    """Return believed over true sound speed."""
    if row.sound_speed <= 0.0 or head.exact != 0:
        return 1.0
    return float(row.sound_speed / water_property(surroundings, SOUND_SPEED, p_NS(head, surroundings)[2]))


@compiled
def ensemble_of(head: Any, row: Any, surroundings: Array, t: float) -> Ensemble:
    """Return the ensemble of the present instant."""
    p = p_NS(head, surroundings)
    stretch = _stretch(head, row, surroundings)
    gain = stretch * (1.0 if head.exact != 0 else 1.0 + row.m.scale)
    v = rotate(q_NB(head, surroundings), velocity_of(head, surroundings))
    # Absorption changes so little that an instrument asks for it once a metre.
    decay = sound_absorption(surroundings, row.frequency, float(np.rint(p[2])))
    return Ensemble(p, q_NS(head, surroundings), v, t, stretch, gain, decay)


@compiled
def _beam(q: Quat, row: Any, i: int) -> Vec3:
    """Return the direction of beam i in N."""
    direction: Vec3 = rotate(q, (row.direction[i, 0], row.direction[i, 1], row.direction[i, 2]))
    return direction


@compiled
def reach_of_cells(head: Any, row: Any, surroundings: Array) -> float:
    """Return the range (m) of the last point of the last cell along a slanted beam."""
    return float(point_of(row.blanking, row.cell, 2 * row.cells) / row.cosine / _stretch(head, row, surroundings))


@compiled
def reach_of_beams(head: Any, row: Any, surroundings: Array) -> float:
    """Return how far rays along the beams reach, m: to the end of the cells and of bottom track."""
    return float(max(reach_of_cells(head, row, surroundings), 1.1 * row.bottom_high / row.cosine))


@compiled
def point_beams(head: Any, row: Any, surroundings: Array, origin: Array, direction: Array, first: int) -> None:
    """Lay one ray along each beam, from ray number `first` on."""
    p, q = p_NS(head, surroundings), q_NS(head, surroundings)
    for i in range(row.beams):
        lay_ray(p, _beam(q, row, i), first + i, origin, direction)


@compiled
def keep_hits(head: Any, row: Any, surroundings: Array, t: float, direction: Array, first: int, hits: Any) -> None:
    """Keep in the record what the beams hit: distance, normal, whether it is the surface, and how strongly it scatters back."""
    height, limit = submergence(surroundings, p_NS(head, surroundings), t), reach_of_beams(head, row, surroundings)
    for i in range(row.beams):
        k = first + i
        meet_surface(height, direction, limit, k, hits)
        row.distance[i], row.surface[i] = hits.distance[k], 1 if hits.body[k] == SURFACE else 0
        for j in range(3):
            row.normal[i, j] = hits.normal[k, j]
        row.back[i] = echo_of(surroundings, direction[k], hits.normal[k], hits.body[k], hits.material[k])


@compiled
def _lay_forward(origin: Array, direction: Array, k: int, p: Vec3, way: Vec3, axis: Vec3) -> int:
    """Lay ray k from p along `way` if that points ahead of the device. Returns the number of rays, 1 or 0."""
    if way[0] * axis[0] + way[1] * axis[1] + way[2] * axis[2] <= 1e-6:
        return 0
    lay_ray(p, way, k, origin, direction)
    return 1


@compiled
def point_to_boundaries(head: Any, row: Any, surroundings: Array, origin: Array, direction: Array, first: int) -> int:
    """Lay rays to where the nearest point of bottom or surface ahead may be, from ray number `first` on. Returns their number.

    They go along the vertical, along the axis, and along the normals of what the beams hit. This is exact for planes.
    """
    p, axis, k = p_NS(head, surroundings), rotate(q_NS(head, surroundings), (0.0, 0.0, 1.0)), first
    k += _lay_forward(origin, direction, k, p, (0.0, 0.0, 1.0), axis)
    k += _lay_forward(origin, direction, k, p, (0.0, 0.0, -1.0), axis)
    k += _lay_forward(origin, direction, k, p, axis, axis)
    for i in range(row.beams):
        if row.distance[i] < math.inf:
            inward = (-row.normal[i, 0], -row.normal[i, 1], -row.normal[i, 2])
            k += _lay_forward(origin, direction, k, p, inward, axis)
    return int(k - first)


@compiled
def boundary_of(
    head: Any, row: Any, surroundings: Array, ensemble: Ensemble, direction: Array, begin: int, end: int, hits: Any
) -> tuple[float, float]:
    """Return the shortest distance to bottom or surface along the rays from `begin` to `end`, m (inf for none), and its rate of change, m/s."""
    height, limit = submergence(surroundings, ensemble.p, ensemble.t), reach_of_cells(head, row, surroundings)
    nearest, speed = math.inf, 0.0
    for k in range(begin, end):
        meet_surface(height, direction, limit, k, hits)
        if hits.distance[k] < nearest:
            v, way = ensemble.v, direction[k]
            nearest, speed = hits.distance[k], -(v[0] * way[0] + v[1] * way[1] + v[2] * way[2])
    return nearest, speed


@compiled
def _along(surroundings: Array, ensemble: Ensemble, beam: Vec3, r: float) -> float:
    """Return the velocity of the water relative to the device along a beam, m/s, at a range r, m."""
    p, v, t = ensemble.p, ensemble.v, ensemble.t
    u = water_velocity(surroundings, (p[0] + r * beam[0], p[1] + r * beam[1], p[2] + r * beam[2]), t)
    return float((u[0] - v[0]) * beam[0] + (u[1] - v[1]) * beam[1] + (u[2] - v[2]) * beam[2])


@compiled
def _strength(row: Any, ensemble: Ensemble, slant: float, r: float) -> float:
    """Return signal over noise of the water at a range r, m; it is 1 at the device's largest range with cells of `sigma_cell`. `slant`: cosine."""
    reach = row.range / slant
    spread = (reach / max(r, 1e-3)) ** 2 * 10.0 ** (0.2 * ensemble.decay * (reach - r))
    return float(spread * row.cell / row.sigma_cell)


@compiled
def _mean_of_pings(head: Any, row: Any, velocity: float, correlation: float, number: int) -> float:
    """Return the mean velocity of the pings, each with its noise and wrapped by the ambiguity; `number`: of beam and cell."""
    # The phase of a pulse pair has the variance (1 / rho^2 - 1) / 2M, so a weak echo is noisier.
    worse = math.sqrt((1.0 / correlation**2 - 1.0) / (1.0 / row.nominal**2 - 1.0))
    sigma = row.sigma * row.sigma_cell / row.cell * worse
    total = 0.0
    for k in range(0, row.pings, 2):
        a, b = normals(head.key, head.number, SAMPLE, _PINGS + (k // 2) * row.cells * row.beams + number)
        total += wrap(velocity + sigma * a, row.ambiguity)
        if k + 1 < row.pings:
            total += wrap(velocity + sigma * b, row.ambiguity)
    return float(total / row.pings)


@compiled
def _write_cell(
    head: Any, row: Any, ensemble: Ensemble, velocity: float, strength: float, number: int, out: Array
) -> None:
    """Write velocity, correlation and echo of one cell of a beam.

    Args:
        head, row, ensemble, out: as of `hear_cells`.
        velocity: true velocity along the beam, m/s; NaN without water.
        strength: signal over noise, as a ratio.
        number: number of the beam's cell.
    """
    exact, place = head.exact != 0, row.place
    correlation = row.nominal / (1.0 + 1.0 / strength)
    if not exact:
        heard = correlation >= row.least_correlation
        velocity = _mean_of_pings(head, row, velocity, correlation, number) if heard else math.nan
    out[place[BEAM_VELOCITIES] + number] = ensemble.gain * velocity
    out[place[CORRELATIONS] + number] = correlation
    if 0.0 < strength < math.inf:
        out[place[ECHOES] + number] = 10.0 * math.log10(strength)


@compiled
def _hear_beam(
    head: Any, row: Any, surroundings: Array, ensemble: Ensemble, i: int, boundary: tuple[float, float], out: Array
) -> None:
    """Do what `hear_cells` does for beam i, point by point; `boundary` as of `boundary_of`."""
    beam, slant, still = _beam(ensemble.q, row, i), row.direction[i, 2], place_of(surroundings).moves == 0
    near, speed = boundary
    flow = _along(surroundings, ensemble, beam, 0.0) if still else 0.0
    front = middle = back = 0.0
    front_weight = middle_weight = back_weight = 1.0
    for j in range(2 * row.cells + 1):
        r = point_of(row.blanking, row.cell, j) / slant / ensemble.stretch
        front, middle, front_weight, middle_weight = middle, back, middle_weight, back_weight
        back = math.nan
        if r < row.distance[i]:
            back = flow if still else _along(surroundings, ensemble, beam, r)
        # Beyond the shortest distance to bottom or surface, their echo through the side lobes arrives together with that of the water.
        leak = row.side_lobe if r > near else 0.0
        back, back_weight = back + leak * speed, 1.0 + leak
        if j >= 2 and j % 2 == 0:
            total = weigh(front_weight, middle_weight, back_weight)
            velocity = weigh(front, middle, back) / total
            strength = math.nan
            if not math.isnan(velocity):
                at = point_of(row.blanking, row.cell, j - 1) / slant / ensemble.stretch
                strength = math.inf if head.exact != 0 else _strength(row, ensemble, slant, at) * total
            _write_cell(head, row, ensemble, velocity, strength, (j // 2 - 1) * row.beams + i, out)


@compiled
def hear_cells(
    head: Any, row: Any, surroundings: Array, ensemble: Ensemble, boundary: tuple[float, float], out: Array
) -> None:
    """Write velocity, echo and correlation of each cell and beam; nothing behind what a beam hits.

    Args:
        head, row, surroundings: those of the sensor.
        ensemble: ensemble of this reading.
        boundary: as `boundary_of` returns it.
        out: the reading.
    """
    for i in range(row.beams):
        _hear_beam(head, row, surroundings, ensemble, i, boundary, out)


@compiled
def _has_lock(head: Any, row: Any, ensemble: Ensemble, i: int, speed: float) -> bool:
    """Return whether bottom track detects what beam i hits; `speed`: along the beam, m/s."""
    r, cosine = row.distance[i], row.direction[i, 2]
    if row.surface[i] != 0 or not row.bottom_low <= r * cosine <= row.bottom_high or abs(speed) > row.bottom_speed:
        return False
    if head.exact != 0:
        return True
    # At the largest altitude, sediment below a level device is just detected.
    reach = row.bottom_high / cosine
    back = row.back[i] / (MU_SEDIMENT * cosine**2)
    return bool(back * (reach / max(r, 1e-3)) ** 2 * 10.0 ** (0.2 * ensemble.decay * (reach - r)) >= 1.0)


@compiled
def track_bottom(head: Any, row: Any, ensemble: Ensemble, out: Array) -> bool:
    """Write ranges, velocity over ground and altitude of bottom track. Returns whether three beams have lock, which velocity and altitude need."""
    n, v, place = row.slanted, ensemble.v, row.place
    ranges, speeds = out[place[BEAM_RANGES] : place[BEAM_RANGES] + n], np.full(n, np.nan)
    for i in range(n):
        beam = _beam(ensemble.q, row, i)
        speed = beam[0] * v[0] + beam[1] * v[1] + beam[2] * v[2]
        if not _has_lock(head, row, ensemble, i, speed):
            continue
        speeds[i], ranges[i] = speed, row.distance[i]
        if head.exact == 0:
            e, f = normals(head.key, head.number, SAMPLE, i)
            speeds[i] = ensemble.gain * speed + row.bottom_sigma * e
            ranges[i] = max(ensemble.stretch * row.distance[i] + row.bottom_range_sigma * f, 1e-3)
    if count_values(ranges) < 3:
        return False
    spread = inverse_of(row.direction, ranges)
    altitude = altitude_of(row.direction, spread, ranges)
    if math.isnan(altitude):
        return False
    first = place[V_S]
    out[first], out[first + 1], out[first + 2] = vector_of(row.direction, spread, speeds)
    out[place[ALTITUDE]] = altitude
    return True
