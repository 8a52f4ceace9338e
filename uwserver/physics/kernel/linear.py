"""Vectors, quaternions, rigid-body formulas and small matrices in compiled code.

Quaternions are w x y z; `uwserver.frames` has the same formulas for plain floats. LAPACK could solve the linear systems, but its bits differ between
machines, and numba needs scipy to call it.
"""

from __future__ import annotations

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled, inlined


@compiled
def solve(A: Array, B: Array) -> None:
    """Solve A X = B by elimination with partial pivoting. A (n, n) is destroyed, B (n, m) becomes X.

    A singular A gives values that are not finite.
    """
    n, m = B.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            for j in range(m):
                B[k, j], B[pivot, j] = B[pivot, j], B[k, j]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= factor * A[k, j]
            for j in range(m):
                B[i, j] -= factor * B[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(m):
            for i in range(k + 1, n):
                B[k, j] -= A[k, i] * B[i, j]
            B[k, j] /= A[k, k]


@compiled
def dot(a: Array, b: Array) -> float:
    """Return the scalar product of two vectors (3). numba's own one needs a BLAS."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def rotation(w: float, a: float, b: float, c: float, R: Array) -> None:
    """Write R_NB (3, 3) of a quaternion. It is exact for any norm, so that a Runge-Kutta stage needs no normalisation."""
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
    """Return the Hamilton product a b."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@inlined
def to_world(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return R v: a vector of B in N, for R = R_NB."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@inlined
def to_body(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return R^T v: a vector of N in B, for R = R_NB."""
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@inlined
def velocity_at(nu: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the velocity v + w x r of the point r = (x, y, z) of a rigid body with the velocity nu (6) at its origin, all in B."""
    return nu[0] + nu[4] * z - nu[5] * y, nu[1] + nu[5] * x - nu[3] * z, nu[2] + nu[3] * y - nu[4] * x


@inlined
def add_force(wrench: Array, x: float, y: float, z: float, fx: float, fy: float, fz: float) -> None:
    """Add to a wrench (6) about an origin the force (fx, fy, fz) that acts at (x, y, z) from it, and its moment r x f."""
    wrench[0] += fx
    wrench[1] += fy
    wrench[2] += fz
    wrench[3] += y * fz - z * fy
    wrench[4] += z * fx - x * fz
    wrench[5] += x * fy - y * fx


@compiled
def triangle_weights(d1: float, d2: float, d3: float, d4: float, d5: float, d6: float) -> tuple[float, float]:
    """Return v and w of the point a + v (b - a) + w (c - a) of a triangle that is nearest to a point x.

    Ericson, Real-Time Collision Detection (2005), 5.1.5. The arguments are the scalar products of b - a and c - a with x - a (d1, d2), with x - b
    (d3, d4), and with x - c (d5, d6).
    """
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6)
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - w, w
    return vb / (va + vb + vc), vc / (va + vb + vc)
