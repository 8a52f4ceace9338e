"""The Kalman filter of dead reckoning: position, velocity and error of the acceleration along one axis.

x = (p, v, b); p' = v, v' = a + b with a measured acceleration a, b' = 0, each with white noise. The covariance is a tuple of its upper triangle
(pp, pv, pb, vv, vb, bb). Both horizontal axes share one covariance, because their measurements come together and are equally good.
"""

from __future__ import annotations

import math

from uwserver.autopilot.state import Six
from uwserver.physics.kernel.deferred import compiled

MEASURED = 0.01
"""Density of the error of a measured acceleration, m2/s3."""
UNMEASURED = 0.25
"""The same without an accelerometer: how much vehicles accelerate."""
DRIFT = 1e-4
"""Growth of the variance of b, m2/s5."""
SPREAD = 1e-4
"""Growth of the variance of p by errors of scale and heading, which are not in the model, m2/s."""

Measured = tuple[float, float, float, Six]
"""Effect of a measurement: the Kalman gains of p, v and b, and the covariance after it."""


@compiled
def predict(c: Six, dt: float, density: float) -> Six:
    """Return the covariance dt (s) later. `density` is `MEASURED` or `UNMEASURED`."""
    pp, pv, pb, vv, vb, bb = c
    # F = [[1, dt, dt^2/2], [0, 1, dt], [0, 0, 1]]; the noise of the acceleration reaches p in second order only.
    h = 0.5 * dt * dt
    pv1, vv1 = pv + dt * vv + h * vb, vv + dt * vb
    pb1, vb1 = pb + dt * vb + h * bb, vb + dt * bb
    return (
        pp + dt * pv + h * pb + dt * pv1 + h * pb1 + SPREAD * dt,
        pv1 + dt * pb1,
        pb1,
        vv1 + dt * vb1 + density * dt,
        vb1,
        bb + DRIFT * dt,
    )


@compiled
def measure_position(c: Six, variance: float) -> Measured:
    """Return the Kalman gains of p, v and b for a measured position, and the covariance after it. `variance` in m2."""
    pp, pv, pb, vv, vb, bb = c
    s = 1.0 / (pp + variance)
    k, m, n = pp * s, pv * s, pb * s
    rest = 1.0 - k
    return k, m, n, (rest * pp, rest * pv, rest * pb, vv - m * pv, vb - m * pb, bb - n * pb)


@compiled
def measure_velocity(c: Six, variance: float) -> Measured:
    """Return the same for a measured velocity; `variance` in m2/s2."""
    pp, pv, pb, vv, vb, bb = c
    s = 1.0 / (vv + variance)
    k, m, n = pv * s, vv * s, vb * s
    rest = 1.0 - m
    return k, m, n, (pp - k * pv, rest * pv, pb - k * vb, rest * vv, rest * vb, bb - n * vb)


@compiled
def measure_bearing(c: Six, variance: float) -> Measured:
    """Return the same for a measured distance along one horizontal direction. It reduces the shared covariance by half as much as a position fix."""
    k, m, n, d = measure_position(c, variance)
    half = (
        0.5 * (c[0] + d[0]), 0.5 * (c[1] + d[1]), 0.5 * (c[2] + d[2]),
        0.5 * (c[3] + d[3]), 0.5 * (c[4] + d[4]), 0.5 * (c[5] + d[5]),
    )  # fmt: skip
    return k, m, n, half


@compiled
def is_likely(innovation: float, c: Six, variance: float) -> bool:
    """Return whether a difference of a measured position from the estimate (m) is within six standard deviations."""
    return abs(innovation) <= 6.0 * math.sqrt(c[0] + variance)
