"""Quaternions w x y z in compiled code; `uwserver.frames` has the same on plain floats."""

from __future__ import annotations

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled


@compiled
def rotation(w: float, a: float, b: float, c: float, R: Array) -> None:
    """R_NB (3, 3) of a quaternion; exact for any norm, so that a Runge-Kutta stage needs no normalisation."""
    s = 2.0 / (w * w + a * a + b * b + c * c)
    R[0, 0] = 1.0 - s * (b * b + c * c)
    R[0, 1] = s * (a * b - w * c)
    R[0, 2] = s * (a * c + w * b)
    R[1, 0] = s * (a * b + w * c)
    R[1, 1] = 1.0 - s * (a * a + c * c)
    R[1, 2] = s * (b * c - w * a)
    R[2, 0] = s * (a * c - w * b)
    R[2, 1] = s * (b * c + w * a)
    R[2, 2] = 1.0 - s * (a * a + b * b)


@compiled
def product(
    aw: float, ax: float, ay: float, az: float, bw: float, bx: float, by: float, bz: float
) -> tuple[float, float, float, float]:
    """Hamilton product a b."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
