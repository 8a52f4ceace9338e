"""Finds all rays from one depth of a layered sea to another over a given distance. It searches the grazing angle, in intervals within which the
turning points stay in the same layers.

A ray runs to and fro between an upper and a lower vertex, where it turns or is reflected. Let A be its horizontal distance from the upper vertex to
the upper end, D that between the ends, and B that from the lower end to the lower vertex. Then all rays of one angle arrive at
x = (1 + 2 k) D + 2 i A + 2 j B with k = 0, 1, ... and (i, j) = (k, k), (k + 1, k), (k, k + 1), or k + 1 both. So one scan of A, D and B over the
angle finds all of them.

Within an interval the distances through whole layers fall as the ray gets steeper, and those of the turning arcs rise. So the values at the ends of
an interval bound x, and most intervals can be skipped at once. The others wait in a queue, sorted by the earliest time at which a ray of them may
arrive: if only the first ray is wanted, later ones need not be found.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.environment.acoustics.aim import solve, turn
from uwserver.environment.acoustics.fan import Angles, Fan, Nodes, angle_of, angles, delays_of, find_nodes, ways
from uwserver.environment.acoustics.layers import Medium, leg, medium, sine_at, widening
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry, inlined

TIME, UPPER_DIP, LOWER_DIP, AREA, ABSORPTION, SURFACE, BOTTOM, TURNS, SURFACE_GRAZING, BOTTOM_GRAZING, CAUSTIC = range(
    11
)
"""Columns of the rays found: s, rad, rad, m2, dB, three counts, rad and rad; CAUSTIC is 1 if the area was limited."""
COLUMNS = 11
MOST = 64
"""Most rays that are kept if all are wanted; of more the earliest."""
MOST_TURNS = 16
"""Most turning points of a ray, without reflections; in a duct there would be no limit."""

_FLATTEST = 1e-30
_NO_TIME_S = 1e-9
"""Error of the bounds of times."""
_AT_ONCE = 8
"""Number of intervals that are scanned before it is checked whether the rest can hold a wanted ray."""
EARLIEST, PLACE, BOUNCES, KIND, FIRST, SECOND = range(6)
"""Columns of the queue, whose rows are kinds of rays that may lie in an interval: earliest time (s), number of the flatter ray, passes through both
vertices (k), vertices that are passed once more (1: upper, 2: lower), and excess distances of the rays at both ends (m)."""
_NEAR_M = 1e-9
_BESIDE = 0.03
"""Relative distance of the angles from which the change of the widening of a tube is computed."""
_AIRY = 0.7955
"""Value of slope times (frequency / bend^2)^(1/3), with the frequency in rad/s, at which the level of a ray equals that of a wave on a fold caustic:
2 pi / (2 pi Ai(0) 2^(1/3))^2."""


@compiled
def _widening(m: Medium, theta: float, i: int, d: int, j: int) -> tuple[float, int]:
    """Return the derivative of a ray's distance with p, m2/s, and a number that says at which of its vertices it turns."""
    q, p = math.sin(theta) ** 2, math.cos(theta) / m.fastest
    slope, _ = widening(m, p, q, m.upper, m.lower)
    above, up = widening(m, p, q, m.upper, 0)
    below, down = widening(m, p, q, m.lower, len(m.c) - 1)
    return d * slope + i * above + j * below, 2 * (up and i > 0) + (down and j > 0)


@compiled
def _tube(m: Medium, theta: float, i: int, d: int, j: int, omega: float) -> tuple[float, bool]:
    """Return the absolute derivative of a ray's distance with p, m2/s, and whether it was limited: near a caustic it is raised to the value that
    gives the level of a wave there."""
    slope, turns = _widening(m, theta, i, d, j)
    if not turns:
        return abs(slope), False
    bend, sides = 0.0, 0
    for other in (theta * (1.0 - _BESIDE), theta * (1.0 + _BESIDE)):
        beside, same = _widening(m, other, i, d, j)
        if same == turns:
            bend -= (
                (beside - slope) * m.fastest / (2.0 * math.sin(0.5 * (other + theta)) * math.sin(0.5 * (other - theta)))
            )
            sides += 1
    bend /= max(sides, 1)
    least = _AIRY * (bend * bend / omega) ** (1.0 / 3.0)
    if least <= abs(slope):
        return abs(slope), False
    # A caustic exists only where the widening changes its sign; it does not where an end is just beside a turning point.
    versine = max(math.sin(0.5 * theta) ** 2 + slope / bend * m.fastest, 0.0)
    other, same = _widening(m, max(2.0 * math.asin(min(math.sqrt(versine), 1.0)), _FLATTEST), i, d, j)
    return (abs(slope), False) if same != turns or other * slope > 0.0 else (least, True)


@compiled
def _keep(
    m: Medium, theta: float, x: float, i: int, d: int, j: int, downward: bool, rays: Array, out: Array, count: int
) -> int:
    """Insert a ray among those found, sorted by time; `downward` is its direction at the upper end. The width of its tube is left to `_widen`, for
    which the ray is noted in `rays`. Return the number of rays."""
    q, p, last = math.sin(theta) ** 2, math.cos(theta) / m.fastest, len(m.c) - 1
    up, between, down = leg(m, p, q, m.upper, 0), leg(m, p, q, m.upper, m.lower), leg(m, p, q, m.lower, last)
    way = i * up.x + d * between.x + j * down.x
    time = (
        i * up.time + d * between.time + j * down.time + p * (x - way)
    )  # so the error is of second order in that of theta
    place = count
    while place and out[place - 1, TIME] > time:
        place -= 1
    if place == len(out):
        return count
    count = min(count + 1, len(out))
    for row in range(count - 1, place, -1):
        out[row], rays[row] = out[row - 1], rays[row - 1]
    rays[place, 0], rays[place, 1], rays[place, 2], rays[place, 3] = theta, i, d, j
    tube = i * up.tube + d * between.tube + j * down.tube
    ends = sine_at(m, m.upper, q) * sine_at(m, m.lower, q) / (m.c[m.upper] * m.c[m.lower])
    vertices = (i // 2 * (not up.turned), j // 2 * (not down.turned))
    arrives = downward == (i == j)
    row = out[place]
    row[TIME], row[AREA], row[CAUSTIC] = time, tube * ends, False
    row[UPPER_DIP] = _dip(m, m.upper, p, q, downward)
    row[LOWER_DIP] = _dip(m, m.lower, p, q, arrives)
    row[ABSORPTION] = i * up.loss + d * between.loss + j * down.loss
    row[SURFACE], row[BOTTOM] = vertices
    row[TURNS] = (i + j) // 2 - vertices[0] - vertices[1]
    row[SURFACE_GRAZING] = math.atan2(sine_at(m, 0, q), p * m.c[0])
    row[BOTTOM_GRAZING] = math.atan2(sine_at(m, last, q), p * m.c[last])
    return count


@compiled
def _widen(m: Medium, rays: Array, omega: float, out: Array, count: int) -> None:
    """Complete the areas of the rays found. `rays` has theta, i, d and j of each (count, 4); d = 0 means that its area is complete."""
    for place in range(count):
        theta, i, d, j = rays[place, 0], int(rays[place, 1]), int(rays[place, 2]), int(rays[place, 3])
        if d:
            slope, bounded = _tube(m, theta, i, d, j, omega)
            out[place, AREA], out[place, CAUSTIC] = out[place, AREA] * slope, bounded


@compiled
def _dip(m: Medium, node: int, p: float, q: float, downward: bool) -> float:
    """Return the angle of a ray below the horizontal at a node, rad."""
    dip = math.atan2(sine_at(m, node, q), p * m.c[node])
    return dip if downward else -dip


@inlined
def _exists(
    upper: int, lower: int, last: int, closed: bool, i: int, j: int, downward: bool, order: int, up: bool, down: bool
) -> bool:
    """Return whether a ray of this kind is wanted. `up`: its upper vertex is at the surface; `down`: its lower one is at the bottom or at the end of
    the profile.

    At an end that lies on a boundary, the rays before and after the reflection there are the same ray, and are counted once.
    """
    if down and not closed and j:
        return False
    above, below = i // 2, j // 2
    reflections = above * up + below * down
    if reflections > order or above + below - reflections > MOST_TURNS:
        return False
    arrives = downward == (i == j)
    if upper == 0 and not downward:
        return False
    if lower == last and closed and not arrives:
        return False
    if lower == 0 and arrives and i:
        return False
    return not (upper == last and closed and downward and j)


@inlined
def _bounds(
    flatter: float, steeper: float, known: float, late: float, x: float, miss: float, falls: bool
) -> tuple[float, float]:
    """Return bounds (s) for the times of arrival of rays of one kind in an interval. Their distances differ from x by at most `miss`, and fall with
    the angle if `falls`.

    The bounds come from p x + `late` of the ray that turns at the speed `known` (0: of no ray). Its derivative with p is x less the distance of the
    ray, so if that falls, the value is greatest at the ray. No time is less than p x.
    """
    if known == 0.0:
        return x / steeper, math.inf
    time, width = x / known + late, (1.0 / flatter - 1.0 / steeper) * miss + _NO_TIME_S
    return max(time - (_NO_TIME_S if falls else width), x / steeper), time + width


@compiled
def _scan(
    m: Medium, fan: Fan, nodes: Nodes, rays: Angles, begin: int, end: int, at: Array, x: float, order: int, alone: bool,
    latest: float, queue: Array, size: int,
) -> tuple[int, float]:  # fmt: skip
    """Put the kinds of rays that some intervals (begin to end) may hold into a queue, but for those that certainly arrive after `latest` (s). `at`
    has the distances from `ways`. If only the earliest ray is wanted (`alone`), each ray that must exist lowers `latest`.

    Returns:
        The number of rows in the queue, and the new `latest` (s).
    """
    upper, lower, last, closed = m.upper, m.lower, len(m.c) - 1, m.closed
    z, c, sums, g, own, after, before = m.z, m.c, m.k, m.g, nodes.own, nodes.next, nodes.last
    turnings, rows, vertex, table, kept = rays.turning, rays.row, rays.vertex, fan.delay, len(fan.delay) > 0
    for k in range(end - 1, begin - 1, -1):
        has_delays, known, up_s, between_s, down_s = False, 0.0, 0.0, 0.0, 0.0
        up, down, row = k >= rays.to_surface, k >= rays.to_bottom, k - begin
        a0, a1 = at[row, 0, 0] + at[row, 0, 1], at[row, 1, 0] + at[row, 1, 1]
        d0, d1 = at[row, 0, 2], at[row, 1, 2]
        b0, b1 = at[row, 0, 3] + at[row, 0, 4], at[row, 1, 3] + at[row, 1, 4]
        a_least, b_least = at[row, 1, 0] + at[row, 0, 1], at[row, 1, 3] + at[row, 0, 4]
        a_most, b_most = at[row, 0, 0] + at[row, 1, 1], at[row, 0, 3] + at[row, 1, 4]
        for bounces in range(MOST_TURNS // 2 + order + 1):
            if 2 * bounces * (a_least + b_least) + (2 * bounces + 1) * d1 > x or bounces * (up + down) > order:
                break
            for kind in range(4):
                i, j, d = 2 * (bounces + kind % 2), 2 * (bounces + kind // 2), 2 * bounces + 1
                least, most = i * a_least + d * d1 + j * b_least, i * a_most + d * d0 + j * b_most
                if least > x or most < x:
                    continue
                if not _exists(upper, lower, last, closed, i, j, kind % 2 == 0, order, up, down):
                    continue
                first, second = i * a0 + d * d0 + j * b0 - x, i * a1 + d * d1 + j * b1 - x
                crosses = first * second < 0.0 or (first == 0.0 and second < 0.0)
                falls = (up or i == 0) and (down or j == 0)
                if falls and not crosses:
                    continue
                if not has_delays:
                    has_delays, ray = True, k + 1 if rows[k + 1] >= 0 else k
                    if rows[ray] >= 0 and kept:
                        known = turnings[ray]
                        up_s, between_s, down_s = delays_of(
                            z, c, sums, g, table, own, after, before, upper, lower, known, rows[ray], vertex[k, 0], vertex[k, 1]
                        )  # fmt: skip
                late_s = i * up_s + d * between_s + j * down_s
                early, late = _bounds(turnings[k], turnings[k + 1], known, late_s, x, max(x - least, most - x), falls)
                if early > latest:
                    continue
                if crosses and alone:
                    latest = min(latest, late)
                queue[size, EARLIEST], queue[size, PLACE], queue[size, BOUNCES] = early, k, bounces
                queue[size, KIND], queue[size, FIRST], queue[size, SECOND] = kind, first, second
                size += 1
    return size, latest


@compiled
def _solve_interval(m: Medium, rays: Angles, span: Array, x: float, found: Array, out: Array, count: int) -> int:
    """Find the rays of a row of the queue, and keep them. Return the number of rays."""
    k, bounces, kind, first, second = int(span[PLACE]), int(span[BOUNCES]), int(span[KIND]), span[FIRST], span[SECOND]
    i, j, d, downward = 2 * (bounces + kind % 2), 2 * (bounces + kind // 2), 2 * bounces + 1, kind % 2 == 0
    low, high = max(angle_of(m.fastest, rays.turning[k]), _FLATTEST), angle_of(m.fastest, rays.turning[k + 1])
    if first * second < 0.0 or (first == 0.0 and second < 0.0):
        theta = solve(m, low, high, first, second, x, i, d, j)
        kept: int = _keep(m, theta, x, i, d, j, downward, found, out, count)
        return kept
    middle = turn(m, low, high, first, x, i, d, j)
    if not math.isnan(middle):
        for left, right, start in ((low, middle, first), (middle, high, -first)):
            theta = solve(m, left, right, start, -start, x, i, d, j)
            count = _keep(m, theta, x, i, d, j, downward, found, out, count)
    return count


@compiled
def _solve_queue(
    m: Medium, rays: Angles, queue: Array, size: int, x: float, found: Array, out: Array, count: int
) -> int:
    """Find the rays of a queue in the order of their earliest times, until the others are too late to be kept. Return the number of rays."""
    for done in range(size):
        best = done
        for other in range(done + 1, size):
            if queue[other, EARLIEST] < queue[best, EARLIEST]:
                best = other
        for column in range(SECOND + 1):
            queue[done, column], queue[best, column] = queue[best, column], queue[done, column]
        if count == len(out) and queue[done, EARLIEST] > out[count - 1, TIME]:
            break
        count = _solve_interval(m, rays, queue[done], x, found, out, count)
    return count


@compiled
def _vertical(m: Medium, order: int, found: Array, out: Array) -> int:
    """Find the vertical rays; return their number."""
    count = 0
    for k in range(order + 1):
        for kind in range(4):
            i, j, d = 2 * (k + kind % 2), 2 * (k + kind // 2), 2 * k + 1
            if _exists(m.upper, m.lower, len(m.c) - 1, m.closed, i, j, kind % 2 == 0, order, True, True):
                count = _keep(m, 0.5 * math.pi, 0.0, i, d, j, kind % 2 == 0, found, out, count)
    return count


@compiled
def _level(m: Medium, x: float, out: Array) -> int:
    """Find the ray that stays at its depth, in a layer of constant sound speed; return the number of rays, 0 or 1."""
    node = m.upper
    above = node > 0 and m.c[node - 1] == m.c[node]
    if m.lower != node or not (above or (node + 1 < len(m.c) and m.c[node + 1] == m.c[node])):
        return 0
    out[0] = 0.0
    out[0, TIME], out[0, AREA], out[0, ABSORPTION] = x / m.c[node], x * x, m.alpha[node] * x
    return 1


@entry
def find_rays(
    depth: Array, speed: Array, alpha: Array, turning: Array, row: Array, way: Array, delays: Array, x: float, a: float, b: float,
    bottom: float, order: int, omega: float, out: Array
) -> int:  # fmt: skip
    """Find all rays from depth a to depth b, the earliest first.

    Args:
        depth, speed, alpha: (n) of the profile, m ascending from 0, m/s and dB/m; linear between its points, constant below.
        turning, row, way, delays: its fan (`make_fan`).
        x: horizontal distance, m.
        a, b: depths, m, 0 <= a <= b.
        bottom: depth of the flat bottom, m; inf for none: then sound that leaves the profile downwards is lost.
        order: most reflections at surface and bottom.
        omega: angular frequency of the sound, which limits the level at caustics, rad/s.
        out: (n, COLUMNS) receives the rays; the n earliest if there are more.

    Returns:
        The number of rays found.
    """
    m, found = medium(depth, speed, alpha, a, b, bottom), np.zeros((len(out), 4))
    if x < _NEAR_M:
        count: int = _vertical(m, order, found, out)
        _widen(m, found, omega, out, count)
        return count
    fan, nodes = Fan(turning, row, way, delays), find_nodes(m, depth, speed)
    rays = angles(m, fan, nodes)
    count = _level(m, x, out)
    queue, size, last = np.empty((8 * _AT_ONCE * (MOST_TURNS // 2 + order + 1), SECOND + 1)), 0, len(rays.turning) - 1
    at, alone = np.empty((_AT_ONCE, 2, 5)), len(out) == 1
    latest = out[0, TIME] if alone and count else math.inf
    for end in range(last, 0, -_AT_ONCE):
        # No time is less than p x, so all flatter rays are later than the one found.
        if x > latest * rays.turning[end]:
            break
        begin = max(end - _AT_ONCE, 0)
        ways(m, fan, nodes, rays, begin, end, order, at)
        size, latest = _scan(m, fan, nodes, rays, begin, end, at, x, order, alone, latest, queue, size)
        if size > len(queue) // 2:
            count, size = _solve_queue(m, rays, queue, size, x, found, out, count), 0
            latest = out[count - 1, TIME] if count == len(out) else latest
    count = _solve_queue(m, rays, queue, size, x, found, out, count)
    _widen(m, found, omega, out, count)
    return count
