"""6x6 linear algebra (compiled). LAPACK would do the same, but its bits differ between machines, and numba needs scipy to reach it."""

from __future__ import annotations

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.compiled import compiled


@compiled
def solve(A: Array, B: Array) -> None:
    """Solve A X = B by elimination with partial pivoting; A (n, n) is destroyed, B (n, m) becomes X.

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
    """Scalar product of two vectors (3); numba's own asks for a BLAS."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


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
