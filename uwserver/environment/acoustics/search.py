"""All rays that lead from one depth of a layered sea to another over a distance: found by their grazing angle, between the angles at which
their turning points pass from one layer into the next.

A ray runs to and fro between an upper and a lower vertex, each where it turns or is reflected. Let A be its way from the upper vertex to the
upper end, D between the ends, B from the lower end to the lower vertex. Then all rays of one angle are at x = (1 + 2 k) D + 2 i A + 2 j B
with k = 0, 1, ... and (i, j) = (k, k), (k + 1, k), (k, k + 1), or k + 1 both: one scan of A, D and B over the angle finds them all.

Within an interval of angles the ways through layers shorten as the ray steepens, and those of the arcs that turn lengthen. So the ends of an
interval bound x, and most are left at once.
"""

from __future__ import annotations

import math

import numpy as np

from uwserver.environment.acoustics.layers import (
    ENDLESS_M,
    Medium,
    advance,
    advance_slope,
    leg,
    medium,
    sine_at,
    widening,
)
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry

TIME, UPPER_DIP, LOWER_DIP, AREA, ABSORPTION, SURFACE, BOTTOM, TURNS, SURFACE_GRAZING, BOTTOM_GRAZING, CAUSTIC = range(
    11
)
"""Columns of what is found: s, rad, rad, m2, dB, counts, rad and rad; CAUSTIC is 1 where the area was bounded."""
COLUMNS = 11
MOST = 64
"""Rays that are kept where all are wanted, the earliest of more."""
MOST_TURNS = 16
"""Of a ray, reflections apart: in a duct there is no end of them."""

_FLATTEST = 1e-30
_ASIDE = 1e-9
"""Relative distance from an angle at which a ray just passes a node."""
_WIDEST = 0.02
"""rad of an interval in which rays turn."""
_EXACT_M = 1e-7
_NEAR_M = 1e-9
_BESIDE = 0.03
"""Relative distance to the angles that tell how the widening of a tube changes."""
_AIRY = 0.7955
"""Slope times (frequency / bend^2)^(1/3), in rad/s, of a ray whose level equals that of a wave on a fold caustic: 2 pi / (2 pi Ai(0) 2^(1/3))^2."""


@compiled
def _critical(m: Medium, begin: int, end: int, theta: Array, nodes: Array) -> int:
    """Angles beyond which a ray passes the nodes of one side that are faster than all before, and these nodes; how many they are."""
    count, fastest, step = 0, m.fastest, (1 if end > begin else -1)
    node = begin
    while node != end:
        node += step
        c = m.c[node]
        if c > fastest:
            fastest = c
            theta[count] = math.atan2(math.sqrt((c - m.fastest) * (c + m.fastest)), m.fastest)
            nodes[count] = node
            count += 1
    return count


@compiled
def _angles(m: Medium) -> tuple[Array, Array]:
    """Ends of the intervals, and for each the nodes above and below that a ray just passes there; -1 where it passes none."""
    last = len(m.c) - 1
    above, below = np.empty(last + 1), np.empty(last + 1)
    upper, lower = np.empty(last + 1, np.int64), np.empty(last + 1, np.int64)
    highs, lows = _critical(m, m.upper, 0, above, upper), _critical(m, m.lower, last, below, lower)
    room = highs + lows + 3 + int(0.5 * math.pi / _WIDEST)
    angles, nodes = np.empty(room), np.full((room, 2), -1)
    angles[0] = _FLATTEST
    size, i, j = 1, 0, 0
    while i < highs or j < lows:
        theta = min(above[i] if i < highs else math.inf, below[j] if j < lows else math.inf)
        parts = int((theta - angles[size - 1]) / _WIDEST) + 1
        start = angles[size - 1]
        for k in range(1, parts):
            angles[size] = start + (theta - start) * k / parts
            size += 1
        angles[size] = theta
        if i < highs and above[i] == theta:
            nodes[size, 0] = upper[i]
            i += 1
        if j < lows and below[j] == theta:
            nodes[size, 1] = lower[j]
            j += 1
        size += 1
    angles[size] = 0.5 * math.pi
    return angles[: size + 1], nodes[: size + 1]


@compiled
def _ways(
    m: Medium, theta: float, passes: Array, wanted: tuple[bool, bool], x: float, before: Array, after: Array
) -> None:
    """Horizontal ways of a ray (m): A, its turning arc, D, B, its turning arc. Those of rays a little flatter, which turn before they pass
    two nodes, above and below (-1: none), and of those a little steeper; what is longer than x is not finished, what is not wanted endless."""
    q, p = math.sin(theta) ** 2, math.cos(theta) / m.fastest
    before[2], _, _, _ = advance(m, p, q, m.upper, m.lower, x)
    after[2] = before[2]
    for side in range(2):
        begin, end, at = (m.upper, 0, 0) if side == 0 else (m.lower, len(m.c) - 1, 3)
        node = passes[side]
        if not wanted[side]:
            before[at] = after[at] = ENDLESS_M
            before[at + 1] = after[at + 1] = 0.0
            continue
        way, arc, last, passed = advance(m, p, q, begin, end, 0.5 * x)
        after[at], after[at + 1] = way, arc
        if node >= 0:
            if passed != node:
                way, _, last, passed = advance(m, p, q, begin, node, 0.5 * x)
            if passed == node:
                way, arc = way - last, last
        before[at], before[at + 1] = way, arc


@compiled
def _reach(m: Medium, theta: float, i: int, d: int, j: int) -> tuple[float, float]:
    """How far a ray goes that runs so often through A, D and B, m, and the derivative with theta."""
    sine = math.sin(theta)
    q, p = sine * sine, math.cos(theta) / m.fastest
    x, slope = advance_slope(m, p, q, m.upper, m.lower)
    x, slope = d * x, d * slope
    if i:
        way, more = advance_slope(m, p, q, m.upper, 0)
        x, slope = x + i * way, slope + i * more
    if j:
        way, more = advance_slope(m, p, q, m.lower, len(m.c) - 1)
        x, slope = x + j * way, slope + j * more
    return x, -slope * sine / m.fastest


@compiled
def _drop(m: Medium, i: int, d: int, j: int) -> float:
    """How far up and down a ray goes altogether that is reflected, m."""
    last = len(m.c) - 1
    drop: float = d * (m.z[m.lower] - m.z[m.upper]) + i * (m.z[m.upper] - m.z[0]) + j * (m.z[last] - m.z[m.lower])
    return drop


@compiled
def _solve(
    m: Medium, low: float, high: float, at_low: float, at_high: float, x: float, i: int, d: int, j: int
) -> float:
    """The angle between two at which a ray goes x far; it goes too far by `at_low` and `at_high` there. Newton's rule, kept between them."""
    theta = math.atan2(_drop(m, i, d, j), x)
    if not low < theta < high:
        theta = low + (high - low) * min(max(at_low / (at_low - at_high), 0.05), 0.95)
    before = math.inf
    for _ in range(100):
        way, slope = _reach(m, theta, i, d, j)
        over = way - x
        if abs(over) < _EXACT_M:
            break
        if (over > 0.0) == (at_low > 0.0):
            low = theta
        else:
            high = theta
        step = theta - over / slope if slope != 0.0 else low
        if not low < step < high or abs(over) > 0.5 * before:
            # An angle near 0 is looked for by its order of magnitude.
            step = math.sqrt(low * high) if high > 4.0 * low else 0.5 * (low + high)
        if step == theta or not low < step < high:
            break
        before, theta = abs(over), step
    return theta


@compiled
def _turn(m: Medium, low: float, high: float, at_low: float, x: float, i: int, d: int, j: int) -> float:
    """Between two angles at which a ray goes too far, or not far enough, one at which it is the other way round; nan when there is none."""
    _, slope = _reach(m, low * (1.0 + _ASIDE), i, d, j)
    _, after = _reach(m, high * (1.0 - _ASIDE), i, d, j)
    if slope * at_low >= 0.0 or after * at_low <= 0.0:
        return math.nan
    for _ in range(60):
        middle = math.sqrt(low * high) if high > 4.0 * low else 0.5 * (low + high)
        way, slope = _reach(m, middle, i, d, j)
        if (way - x) * at_low <= 0.0:
            return middle
        if abs(slope) * (high - low) < _EXACT_M:
            return math.nan
        if slope * at_low < 0.0:
            low = middle
        else:
            high = middle
    return math.nan


@compiled
def _widening(m: Medium, theta: float, i: int, d: int, j: int) -> tuple[float, int]:
    """The derivative of a ray's way with p, m2/s, and a number that tells at which of its vertices it turns."""
    q, p = math.sin(theta) ** 2, math.cos(theta) / m.fastest
    slope, _ = widening(m, p, q, m.upper, m.lower)
    above, up = widening(m, p, q, m.upper, 0)
    below, down = widening(m, p, q, m.lower, len(m.c) - 1)
    return d * slope + i * above + j * below, 2 * (up and i > 0) + (down and j > 0)


@compiled
def _tube(m: Medium, theta: float, i: int, d: int, j: int, omega: float) -> tuple[float, bool]:
    """The size of the derivative of a ray's way with p, m2/s, bounded near caustics by that of which a wave there is as strong; and whether."""
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
    # There is a caustic only where the widening changes its sign, and not where an end lies just beside the turning point.
    versine = max(math.sin(0.5 * theta) ** 2 + slope / bend * m.fastest, 0.0)
    other, same = _widening(m, max(2.0 * math.asin(min(math.sqrt(versine), 1.0)), _FLATTEST), i, d, j)
    return (abs(slope), False) if same != turns or other * slope > 0.0 else (least, True)


@compiled
def _keep(
    m: Medium, theta: float, x: float, i: int, d: int, j: int, downward: bool, omega: float, out: Array, count: int
) -> int:
    """Put a ray among those found, by its time; `downward` where it leaves the upper end. Returns how many there are."""
    q, p, last = math.sin(theta) ** 2, math.cos(theta) / m.fastest, len(m.c) - 1
    up, between, down = leg(m, p, q, m.upper, 0), leg(m, p, q, m.upper, m.lower), leg(m, p, q, m.lower, last)
    way = i * up.x + d * between.x + j * down.x
    time = (
        i * up.time + d * between.time + j * down.time + p * (x - way)
    )  # exact to the second order of what theta lacks
    place = count
    while place and out[place - 1, TIME] > time:
        place -= 1
    if place == len(out):
        return count
    count = min(count + 1, len(out))
    for row in range(count - 1, place, -1):
        out[row] = out[row - 1]
    slope, bounded = _tube(m, theta, i, d, j, omega)
    tube = i * up.tube + d * between.tube + j * down.tube
    ends = sine_at(m, m.upper, q) * sine_at(m, m.lower, q) / (m.c[m.upper] * m.c[m.lower])
    vertices = (i // 2 * (not up.turned), j // 2 * (not down.turned))
    arrives = downward == (i == j)
    row = out[place]
    row[TIME], row[AREA], row[CAUSTIC] = time, tube * slope * ends, bounded
    row[UPPER_DIP] = _dip(m, m.upper, p, q, downward)
    row[LOWER_DIP] = _dip(m, m.lower, p, q, arrives)
    row[ABSORPTION] = i * up.loss + d * between.loss + j * down.loss
    row[SURFACE], row[BOTTOM] = vertices
    row[TURNS] = (i + j) // 2 - vertices[0] - vertices[1]
    row[SURFACE_GRAZING] = math.atan2(sine_at(m, 0, q), p * m.c[0])
    row[BOTTOM_GRAZING] = math.atan2(sine_at(m, last, q), p * m.c[last])
    return count


@compiled
def _dip(m: Medium, node: int, p: float, q: float, downward: bool) -> float:
    dip = math.atan2(sine_at(m, node, q), p * m.c[node])
    return dip if downward else -dip


@compiled
def _exists(m: Medium, i: int, d: int, j: int, downward: bool, order: int, up: bool, down: bool) -> bool:
    """Whether a ray of this kind is wanted, where its vertices lie at the surface (`up`), and at the bottom or the profile's end (`down`).

    At an end that lies on a boundary the ray before and after its reflection there is one.
    """
    last = len(m.c) - 1
    if down and not m.closed and j:
        return False
    above, below = i // 2, j // 2
    reflections = above * up + below * down
    if reflections > order or above + below - reflections > MOST_TURNS:
        return False
    arrives = downward == (i == j)
    if m.upper == 0 and not downward:
        return False
    if m.lower == last and m.closed and not arrives:
        return False
    if m.lower == 0 and arrives and i:
        return False
    return not (m.upper == last and m.closed and downward and j)


@compiled
def _in_interval(
    m: Medium, low: float, high: float, at: Array, x: float, order: int, up: bool, down: bool, omega: float,
    out: Array, count: int,
) -> int:  # fmt: skip
    """Find the rays between two angles; `at` are their ways at both. Where only one is kept, those that are later for sure are left."""
    quickest = m.c.max()
    for k in range(MOST_TURNS + order + 1):
        for kind in range(4):
            i, j, d = 2 * (k + kind % 2), 2 * (k + kind // 2), 2 * k + 1
            least = i * (at[1, 0] + at[0, 1]) + d * at[1, 2] + j * (at[1, 3] + at[0, 4])
            most = i * (at[0, 0] + at[1, 1]) + d * at[0, 2] + j * (at[0, 3] + at[1, 4])
            if kind == 0 and (least > x or k > MOST_TURNS // 2 + order):
                return count
            downward = kind % 2 == 0
            if least > x or most < x or not _exists(m, i, d, j, downward, order, up, down):
                continue
            if count == len(out) and math.hypot(x, _drop(m, i * up, d, j * down)) > quickest * out[count - 1, TIME]:
                continue
            first = i * (at[0, 0] + at[0, 1]) + d * at[0, 2] + j * (at[0, 3] + at[0, 4]) - x
            second = i * (at[1, 0] + at[1, 1]) + d * at[1, 2] + j * (at[1, 3] + at[1, 4]) - x
            if first * second < 0.0 or (first == 0.0 and second < 0.0):
                theta = _solve(m, low, high, first, second, x, i, d, j)
                count = _keep(m, theta, x, i, d, j, downward, omega, out, count)
            elif up and down:  # x only falls
                continue
            else:
                middle = _turn(m, low, high, first, x, i, d, j)
                if not math.isnan(middle):
                    for left, right, start in ((low, middle, first), (middle, high, -first)):
                        theta = _solve(m, left, right, start, -start, x, i, d, j)
                        count = _keep(m, theta, x, i, d, j, downward, omega, out, count)
    return count


@compiled
def _vertical(m: Medium, order: int, omega: float, out: Array) -> int:
    """Rays straight up and down."""
    count = 0
    for k in range(order + 1):
        for kind in range(4):
            i, j, d = 2 * (k + kind % 2), 2 * (k + kind // 2), 2 * k + 1
            if _exists(m, i, d, j, kind % 2 == 0, order, True, True):
                count = _keep(m, 0.5 * math.pi, 0.0, i, d, j, kind % 2 == 0, omega, out, count)
    return count


@compiled
def _level(m: Medium, x: float, out: Array) -> int:
    """The ray that stays at its depth, where the sound speed does."""
    node = m.upper
    above = node > 0 and m.c[node - 1] == m.c[node]
    if m.lower != node or not (above or (node + 1 < len(m.c) and m.c[node + 1] == m.c[node])):
        return 0
    out[0] = 0.0
    out[0, TIME], out[0, AREA], out[0, ABSORPTION] = x / m.c[node], x * x, m.alpha[node] * x
    return 1


@entry
def find_rays(
    depth: Array, speed: Array, alpha: Array, x: float, a: float, b: float, bottom: float, order: int, omega: float, out: Array
) -> int:  # fmt: skip
    """Find all rays from depth a to depth b, the earliest first.

    Args:
        depth, speed, alpha: (n) of the profile, m ascending from 0, m/s and dB/m; linear between its points, constant below.
        x: horizontal distance, m.
        a, b: depths, m, 0 <= a <= b.
        bottom: depth of the flat bottom, m; inf for none: sound that gets below the profile is gone.
        order: reflections at surface and bottom at most.
        omega: angular frequency of the sound, which bounds caustics, rad/s.
        out: (n, COLUMNS) gets what is found, the n earliest of more.

    Returns:
        How many were found.
    """
    m = medium(depth, speed, alpha, a, b, bottom)
    if x < _NEAR_M:
        vertical: int = _vertical(m, order, omega, out)
        return vertical
    angles, nodes = _angles(m)
    count: int = _level(m, x, out)
    # Beyond the angle at which a ray passes the fastest node before the surface, or the bottom, it gets there.
    to_surface, to_bottom, last = 0, 0, len(angles) - 1
    for k in range(last):
        to_surface, to_bottom = k if nodes[k, 0] >= 0 else to_surface, k if nodes[k, 1] >= 0 else to_bottom
    at, flatter = np.zeros((2, 5)), np.zeros(5)
    for k in range(last, -1, -1):
        # No time is less than p x: those of flatter rays are later than the one that is kept.
        if count == len(out) and k < last and math.cos(angles[k + 1]) * x > m.fastest * out[count - 1, TIME]:
            break
        wanted = (order > 0 or k <= to_surface, order > 0 or k <= to_bottom)
        _ways(m, angles[k], nodes[k], wanted, x, flatter, at[0])
        if k < last:
            up, down = k >= to_surface, k >= to_bottom
            count = _in_interval(m, angles[k], angles[k + 1], at, x, order, up, down, omega, out, count)
        at[1] = flatter
    return count
