"""Rays in a layered sea, whose sound speed is linear between nodes, and the choice of these nodes. In each layer a ray is an arc of a circle, in
closed form.

A ray keeps its slowness p = cos(grazing) / c (Snell). Between two depths it is described by `theta`, its grazing angle where the sound is fastest:
so no sine is computed as a difference of two nearly equal numbers, however flat the ray is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, entry, inlined

_SAME_M = 1e-9
"""Depths that are closer than this count as the same."""
ENDLESS_M = 1e15
"""Distance of a ray that never arrives; longer than any real distance."""
_SMALL = 1e-3
"""Argument below which five terms of a series are exact to the last digit."""
_FLAT = 1e-2
"""Argument below which four terms of a series are exact to the last digit."""
_SPREAD = 6
"""Number of nodes before the turning point at which bends of the profile are smoothed."""
_SMOOTH = 2.0
"""Largest ratio of gradients of a bend that is smoothed."""


class Medium(NamedTuple):
    """Layers between nodes, prepared for rays between two ends.

    Attributes:
        z, c, alpha: (n) depth (m), sound speed (m/s) and absorption (dB/m) of the nodes; the ends of the ray are nodes.
        e, f: (n) squared sine of a ray at a node is e + f sin(theta)^2; if it is not positive, the ray turns before the node.
        k: (n - 1) sum of the speeds at both ends of a layer times its thickness, m2/s.
        g: (n - 1) absolute gradient of the layer, 1/s.
        upper, lower: nodes of the upper and the lower end.
        fastest: highest speed between the ends, m/s.
        closed: whether there is a bottom, at the last node.
    """

    z: Array
    c: Array
    alpha: Array
    e: Array
    f: Array
    k: Array
    g: Array
    upper: int
    lower: int
    fastest: float
    closed: bool


@compiled
def medium(depth: Array, speed: Array, alpha: Array, a: float, b: float, bottom: float) -> Medium:
    """Return the layers from the surface to the bottom (m; inf: to the end of the profile), with nodes at the ends of a ray, a <= b (m)."""
    n, closed = len(depth), math.isfinite(bottom)
    last = bottom if closed else max(b, depth[-1])
    z, c, w = np.empty(n + 4), np.empty(n + 4), np.empty(n + 4)
    ends = (a, b, last)
    count, nxt, upper, lower = 0, 0, 0, 0
    for i in range(n + 1):
        here = depth[i] if i < n else math.inf
        while nxt < 3 and ends[nxt] <= here + _SAME_M:
            if count == 0 or ends[nxt] > z[count - 1] + _SAME_M:
                j = min(max(i, 1), n - 1)
                # The speed is constant beyond the profile.
                part = min(max((ends[nxt] - depth[j - 1]) / (depth[j] - depth[j - 1]), 0.0), 1.0)
                z[count], c[count] = ends[nxt], speed[j - 1] + part * (speed[j] - speed[j - 1])
                w[count] = alpha[j - 1] + part * (alpha[j] - alpha[j - 1])
                count += 1
            if nxt == 0:
                upper = count - 1
            if nxt == 1:
                lower = count - 1
            nxt += 1
        if here >= last - _SAME_M:
            break
        if count == 0 or here > z[count - 1] + _SAME_M:
            z[count], c[count], w[count] = here, speed[i], alpha[i]
            count += 1
    z, c, w = z[:count], c[:count], w[:count]
    fastest = c[upper : lower + 1].max()
    e = (fastest - c) * (fastest + c) / (fastest * fastest)
    k, g = (c[1:] + c[:-1]) * (z[1:] - z[:-1]), np.abs(c[1:] - c[:-1]) / (z[1:] - z[:-1])
    return Medium(z, c, w, e, 1.0 - e, k, g, upper, lower, fastest, closed)


@compiled
def sine_at(m: Medium, node: int, q: float) -> float:
    """Return the sine of the grazing angle at a node; q is the squared sine of theta. It is 0 if the ray turns before the node."""
    return math.sqrt(max(m.e[node] + q * m.f[node], 0.0))


@compiled
def advance_slope(m: Medium, p: float, q: float, begin: int, end: int) -> tuple[float, float]:
    """Return the horizontal distance of a ray from one node to another, or until it turns (m), and its derivative with p."""
    x, slope, near = 0.0, 0.0, sine_at(m, begin, q)
    step = 1 if end > begin else -1
    layer = begin if end > begin else begin - 1
    for node in range(begin + step, end + step, step):
        square = m.e[node] + q * m.f[node]
        if square <= 0.0:
            arc = near / (p * m.g[layer])
            return x + arc, slope - arc / (p * near * near)
        far = math.sqrt(square)
        both = near * far
        ratio = m.k[layer] / ((near + far) * both)
        x += p * ratio * both
        slope += ratio
        near = far
        layer += step
    return x, slope


@inlined
def _squared_asin(v: float) -> float:
    """Return the square of the angle with this sine."""
    if abs(v) < _FLAT:
        u = v * v
        return u * (1.0 + u * (1.0 / 3.0 + u * (8.0 / 45.0 + u * (4.0 / 35.0 + u * (128.0 / 1575.0)))))
    return math.asin(min(abs(v), 1.0)) ** 2


class Leg(NamedTuple):
    """A part of a ray between two nodes, or up to where it turns.

    Attributes:
        x: horizontal distance, m.
        time: time of travel, s.
        tube: x / p, which is finite for a vertical ray too, m2/s.
        loss: absorption, dB.
        turned: whether the ray turned.
    """

    x: float
    time: float
    tube: float
    loss: float
    turned: bool


@compiled
def leg(m: Medium, p: float, q: float, begin: int, end: int) -> Leg:
    """Return distance, time, tube and loss of a ray from one node towards another."""
    x, time, tube, loss, near = 0.0, 0.0, 0.0, 0.0, sine_at(m, begin, q)
    step = 1 if end > begin else -1
    layer = begin if end > begin else begin - 1
    for node in range(begin + step, end + step, step):
        square, c0 = m.e[node] + q * m.f[node], m.c[node - step]
        if square <= 0.0:
            g, dip = m.g[layer], math.asin(min(near, 1.0))
            arc = near / (p * g)
            loss += m.alpha[node - step] * dip / (p * g)
            return Leg(x + arc, time + math.atanh(min(near, 1.0)) / g, tube + arc / p, loss, True)
        far, c1, thick = math.sqrt(square), m.c[node], abs(m.z[node] - m.z[node - step])
        ratio = m.k[layer] / (near + far)
        run = p * ratio
        x, tube = x + run, tube + ratio
        time += thick * slowness(p, c0, c1, near, far)
        turn = _squared_asin((near * c1 - far * c0) * p)
        length = math.sqrt(run * run + thick * thick) * (1.0 + turn * (1.0 / 24.0 + turn * (7.0 / 5760.0)))
        loss += 0.5 * (m.alpha[node] + m.alpha[node - step]) * length
        near = far
        layer += step
    return Leg(x, time, tube, loss, False)


@compiled
def widening(m: Medium, p: float, q: float, begin: int, end: int) -> tuple[float, bool]:
    """Return the derivative with p of a ray's distance from one node towards another, for a smooth profile; and whether the ray turns.

    A small jump of the gradient g at a node stands for a smooth bend of the profile across the layers about it. For rays that turn just beyond the
    node it would cause a large jump: dx/dp has the term (1 / g before - 1 / g behind) / (p^2 sine). So near the turning point the mean of 1 / sine
    about the node replaces 1 / sine. A large jump of the gradient is taken as a property of the sea, and kept.
    """
    _, slope = advance_slope(m, p, q, begin, end)
    step = 1 if end > begin else -1
    node = begin
    while node != end and m.e[node + step] + q * m.f[node + step] > 0.0:
        node += step
    if node == end:
        return slope, False
    for j in range(node + step, node - _SPREAD * step, -step):
        if (j - begin) * step <= 0:
            break
        if j == end:
            continue
        before, behind = (m.c[j] - m.c[j - step]), (m.c[j + step] - m.c[j])
        if before <= 0.0 or behind <= 0.0:
            continue
        before, behind = abs(m.z[j] - m.z[j - step]) / before, abs(m.z[j + step] - m.z[j]) / behind
        if max(before, behind) > _SMOOTH * min(before, behind):
            continue
        here = m.e[j] + q * m.f[j]
        a = 0.5 * (here + m.e[j - step] + q * m.f[j - step])
        b = 0.5 * (here + m.e[j + step] + q * m.f[j + step])
        if a > 0.0:
            root = math.sqrt(a)
            mean = 2.0 / (root + math.sqrt(b)) if b > 0.0 else 2.0 * root / (a - b)
            slope -= (mean - (1.0 / math.sqrt(here) if here > 0.0 else 0.0)) * (behind - before) / (p * p)
    return slope, True


@compiled
def slowness(p: float, c0: float, c1: float, near: float, far: float) -> float:
    """Return travel time over thickness of a layer, s/m: log(c1 (1 + sine) / (c0 (1 + sine'))) / (c1 - c0), which has a limit for equal speeds."""
    flat = p * p * (c0 + c1) / ((near + far) * (1.0 + far))
    rate = 1.0 / c0 + flat + flat * (c1 - c0) / c0
    u = (c1 - c0) * rate
    if abs(u) < _SMALL:
        return rate * (1.0 + u * (-1.0 / 2.0 + u * (1.0 / 3.0 + u * (-1.0 / 4.0 + u * (1.0 / 5.0 - u * (1.0 / 6.0))))))
    return rate * (math.log1p(u) / u)


@entry
def thin_out(depth: Array, speed: Array, tolerance: float) -> Array:
    """Choose points of a profile such that the lines between them miss no other point by more than the tolerance (m/s; Douglas and Peucker, 1973).

    Args:
        depth, speed: (n) m ascending, and m/s.
        tolerance: m/s.

    Returns:
        (m) numbers of the chosen points, ascending; the first and the last point are always among them.
    """
    n = len(depth)
    kept, stack = np.zeros(n, np.bool_), np.empty((n + 1, 2), np.int64)
    kept[0] = kept[n - 1] = True
    stack[0, 0], stack[0, 1], size = 0, n - 1, 1
    while size:
        size -= 1
        low, high = stack[size]
        slope = (speed[high] - speed[low]) / (depth[high] - depth[low])
        worst, most = -1, tolerance
        for i in range(low + 1, high):
            off = abs(speed[i] - speed[low] - slope * (depth[i] - depth[low]))
            if off > most:
                worst, most = i, off
        if worst > 0:
            kept[worst] = True
            stack[size, 0], stack[size, 1], stack[size + 1, 0], stack[size + 1, 1] = low, worst, worst, high
            size += 2
    return np.nonzero(kept)[0]
