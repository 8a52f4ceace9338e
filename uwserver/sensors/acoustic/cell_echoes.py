"""What the beams of a current profiler hear: of the water in their cells, of bottom and surface through their side lobes, and of the bottom that
they meet. In compiled code; rows are records of `adcp`."""

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
from uwserver.sensors.acoustic.current_profile import point_of, weigh, wrap
from uwserver.sensors.acoustic.echo import MU_SEDIMENT
from uwserver.sensors.acoustic.janus import altitude_of, spread_of, told_by, vector_of
from uwserver.sensors.bank import (
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
"""Eight slanted ones, and that along the axis."""
_PINGS = 16
"""First lane of random numbers for cells: one for each two pings of each beam and cell. Those of bottom track begin at 0, one for each beam."""

DISTANCES, VELOCITIES_S, VELOCITIES_N, ERRORS, BEAM_VELOCITIES, ECHOES, CORRELATIONS, V_S, ALTITUDE, BEAM_RANGES = (
    range(10)
)
"""Numbers of the fields of a reading; `place` of a record says where each begins."""


class Ensemble(NamedTuple):
    """What all beams of an ensemble have in common. Vectors in N.

    Attributes:
        p, q, v: place (m), attitude and velocity (m/s) of the device.
        t: s.
        stretch: what the device takes for a metre, by the speed of sound that it believes in.
        gain: what it tells of a velocity, as a part of it.
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
def _stretch(head: Any, row: Any, now: Array) -> float:
    """What the device takes for a metre."""
    if row.sound_speed <= 0.0 or head.exact != 0:
        return 1.0
    return float(row.sound_speed / water_property(now, SOUND_SPEED, p_NS(head, now)[2]))


@compiled
def ensemble_of(head: Any, row: Any, now: Array, t: float) -> Ensemble:
    """The ensemble of this instant."""
    p = p_NS(head, now)
    stretch = _stretch(head, row, now)
    gain = stretch * (1.0 if head.exact != 0 else 1.0 + row.m.scale)
    v = rotate(q_NB(head, now), velocity_of(head, now))
    # It changes so little that a device asks once a metre of depth.
    decay = sound_absorption(now, row.frequency, float(np.rint(p[2])))
    return Ensemble(p, q_NS(head, now), v, t, stretch, gain, decay)


@compiled
def _beam(q: Quat, row: Any, i: int) -> Vec3:
    """Direction of beam i in N."""
    direction: Vec3 = rotate(q, (row.direction[i, 0], row.direction[i, 1], row.direction[i, 2]))
    return direction


@compiled
def reach_of_cells(head: Any, row: Any, now: Array) -> float:
    """Range (m) of the last point of the last cell along a slanted beam."""
    return float(point_of(row.blanking, row.cell, 2 * row.cells) / row.cosine / _stretch(head, row, now))


@compiled
def reach_of_beams(head: Any, row: Any, now: Array) -> float:
    """How far (m) beams look: to the end of its cells and of bottom track."""
    return float(max(reach_of_cells(head, row, now), 1.1 * row.bottom_high / row.cosine))


@compiled
def point_beams(head: Any, row: Any, now: Array, origin: Array, direction: Array, first: int) -> None:
    """Lay one ray along each beam, from this number on."""
    p, q = p_NS(head, now), q_NS(head, now)
    for i in range(row.beams):
        k = first + i
        origin[k, 0], origin[k, 1], origin[k, 2] = p
        direction[k, 0], direction[k, 1], direction[k, 2] = _beam(q, row, i)


@compiled
def note_hits(head: Any, row: Any, now: Array, t: float, direction: Array, first: int, hits: Any) -> None:
    """Keep what the beams meet."""
    height, limit = submergence(now, p_NS(head, now), t), reach_of_beams(head, row, now)
    for i in range(row.beams):
        k = first + i
        meet_surface(height, direction, limit, k, hits)
        row.distance[i], row.surface[i] = hits.distance[k], 1 if hits.body[k] == SURFACE else 0
        for j in range(3):
            row.normal[i, j] = hits.normal[k, j]
        row.back[i] = echo_of(now, direction[k], hits.normal[k], hits.body[k], hits.material[k])


@compiled
def _lay_forward(origin: Array, direction: Array, k: int, p: Vec3, way: Vec3, axis: Vec3) -> int:
    """Lay ray k from p along a way that leads before the device; returns how many these are, 1 or 0."""
    if way[0] * axis[0] + way[1] * axis[1] + way[2] * axis[2] <= 1e-6:
        return 0
    origin[k, 0], origin[k, 1], origin[k, 2] = p
    direction[k, 0], direction[k, 1], direction[k, 2] = way
    return 1


@compiled
def point_to_boundaries(head: Any, row: Any, now: Array, origin: Array, direction: Array, first: int) -> int:
    """Lay rays where the nearest point of bottom or surface before the device can be, from this number on; returns how many.

    They go along the vertical and square to what the beams meet, which is exact where that is plane.
    """
    p, axis, k = p_NS(head, now), rotate(q_NS(head, now), (0.0, 0.0, 1.0)), first
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
    head: Any, row: Any, now: Array, ensemble: Ensemble, direction: Array, begin: int, end: int, hits: Any
) -> tuple[float, float]:
    """Shortest distance (m) to bottom or surface by these rays, inf for none, and the speed at which it goes away, m/s."""
    height, limit = submergence(now, ensemble.p, ensemble.t), reach_of_cells(head, row, now)
    nearest, speed = math.inf, 0.0
    for k in range(begin, end):
        meet_surface(height, direction, limit, k, hits)
        if hits.distance[k] < nearest:
            v, way = ensemble.v, direction[k]
            nearest, speed = hits.distance[k], -(v[0] * way[0] + v[1] * way[1] + v[2] * way[2])
    return nearest, speed


@compiled
def _along(now: Array, ensemble: Ensemble, beam: Vec3, r: float) -> float:
    """Velocity of the water relative to the device along a beam, m/s, at a range of r, m."""
    p, v, t = ensemble.p, ensemble.v, ensemble.t
    u = water_velocity(now, (p[0] + r * beam[0], p[1] + r * beam[1], p[2] + r * beam[2]), t)
    return float((u[0] - v[0]) * beam[0] + (u[1] - v[1]) * beam[1] + (u[2] - v[2]) * beam[2])


@compiled
def _strength(row: Any, ensemble: Ensemble, slant: float, r: float) -> float:
    """Signal over noise of water at a range of r, m: it is 1 at the device's range with cells of `sigma_cell`."""
    reach = row.range / slant
    spread = (reach / max(r, 1e-3)) ** 2 * 10.0 ** (0.2 * ensemble.decay * (reach - r))
    return float(spread * row.cell / row.sigma_cell)


@compiled
def _mean_of_pings(head: Any, row: Any, velocity: float, correlation: float, number: int) -> float:
    """Mean of the pings' velocities, each with its noise and on its side of the ambiguity; `number`: of the cell of a beam."""
    # Variance of a pulse pair's phase: (1 / rho^2 - 1) / 2M, so that a weak echo is told worse.
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
def _tell_cell(
    head: Any, row: Any, ensemble: Ensemble, velocity: float, strength: float, number: int, out: Array
) -> None:
    """What the device makes of the velocity along a beam (m/s; NaN where there is no water) and of its echo in a cell."""
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
    head: Any, row: Any, now: Array, ensemble: Ensemble, i: int, boundary: tuple[float, float], out: Array
) -> None:
    """As `hear_cells`, of beam i: point by point."""
    beam, slant, still = _beam(ensemble.q, row, i), row.direction[i, 2], place_of(now).moves == 0
    near, speed = boundary
    flow = _along(now, ensemble, beam, 0.0) if still else 0.0
    front = middle = back = 0.0
    front_weight = middle_weight = back_weight = 1.0
    for j in range(2 * row.cells + 1):
        r = point_of(row.blanking, row.cell, j) / slant / ensemble.stretch
        front, middle, front_weight, middle_weight = middle, back, middle_weight, back_weight
        back = math.nan
        if r < row.distance[i]:
            back = flow if still else _along(now, ensemble, beam, r)
        # Beyond the shortest way to bottom or surface, their echo through the side lobes arrives together with that of the water.
        leak = row.side_lobe if r > near else 0.0
        back, back_weight = back + leak * speed, 1.0 + leak
        if j >= 2 and j % 2 == 0:
            total = weigh(front_weight, middle_weight, back_weight)
            velocity = weigh(front, middle, back) / total
            strength = math.nan
            if not math.isnan(velocity):
                at = point_of(row.blanking, row.cell, j - 1) / slant / ensemble.stretch
                strength = math.inf if head.exact != 0 else _strength(row, ensemble, slant, at) * total
            _tell_cell(head, row, ensemble, velocity, strength, (j // 2 - 1) * row.beams + i, out)


@compiled
def hear_cells(head: Any, row: Any, now: Array, ensemble: Ensemble, boundary: tuple[float, float], out: Array) -> None:
    """Fill in velocities, echoes and correlations of each cell and beam; nothing behind what a beam meets.

    Args:
        head, row: of the sensor.
        now: what it sees.
        ensemble: this one.
        boundary: of `boundary_of`.
        out: the reading.
    """
    for i in range(row.beams):
        _hear_beam(head, row, now, ensemble, i, boundary, out)


@compiled
def _has_lock(head: Any, row: Any, ensemble: Ensemble, i: int, speed: float) -> bool:
    """Whether bottom track hears what beam i meets."""
    r, cosine = row.distance[i], row.direction[i, 2]
    if row.surface[i] != 0 or not row.bottom_low <= r * cosine <= row.bottom_high or abs(speed) > row.bottom_speed:
        return False
    if head.exact != 0:
        return True
    # Sediment below a level device is just heard at the largest altitude.
    reach = row.bottom_high / cosine
    back = row.back[i] / (MU_SEDIMENT * cosine**2)
    return bool(back * (reach / max(r, 1e-3)) ** 2 * 10.0 ** (0.2 * ensemble.decay * (reach - r)) >= 1.0)


@compiled
def track_bottom(head: Any, row: Any, ensemble: Ensemble, out: Array) -> bool:
    """Fill in the values of bottom track; whether three beams have lock, and with them velocity over ground and altitude."""
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
    if told_by(ranges) < 3:
        return False
    spread = spread_of(row.direction, ranges)
    altitude = altitude_of(row.direction, spread, ranges)
    if math.isnan(altitude):
        return False
    first = place[V_S]
    out[first], out[first + 1], out[first + 2] = vector_of(row.direction, spread, speeds)
    out[place[ALTITUDE]] = altitude
    return True
