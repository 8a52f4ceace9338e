"""Sine, cosine and exponential of many numbers at once, in plain arithmetic (compiled).

The compiler turns such loops into instructions that take several numbers at a time, so each number costs a tenth of a call of `math`. And the bits
are the same on all machines, while those of `math` depend on the C library.
"""

from __future__ import annotations

import numpy as np

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, inlined

_WHOLE = 1.5 * 2.0**52
"""Adding this to a number below 2**51 and subtracting it again rounds the number to a whole one; in between, the last bits hold that whole number."""
_BIAS, _FRACTION = 1023, 52
"""Bias of the exponent of a float64, and number of bits of the fraction."""
_PER_QUARTER = 6.36619772367581382433e-01
_QUARTER_1, _QUARTER_2, _QUARTER_3 = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21
"""2 / pi; and pi / 2 as a sum of three parts. Multiples of the first two are exact up to 2**20 (W. J. Cody, W. Waite, Software Manual for the
Elementary Functions, 1980; the parts are those of fdlibm)."""
_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11
"""Coefficients of minimax polynomials of sine and cosine within an eighth of a turn (fdlibm, Sun Microsystems 1993, `k_sin.c` and `k_cos.c`)."""
_PER_DOUBLING = 1.44269504088896338700
_DOUBLING_1, _DOUBLING_2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""1 / ln 2; and ln 2 as a sum of two parts, as above."""
_LEAST = -700.0
"""The smallest exponent that is used: exp(-700) is 1e-304."""


@inlined
def within_an_eighth(x: float) -> tuple[float, float]:
    """Return sine and cosine of an angle (rad) of at most an eighth of a turn to either side, within 2.3e-16."""
    z = x * x
    sine = x + x * z * (_S1 + z * (_S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * _S6)))))
    return sine, 1.0 - (0.5 * z - z * z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * _C6))))))


@compiled
def sines_and_cosines(angle: Array, sin: Array, cos: Array) -> None:
    """Compute sine and cosine of angles (n, rad) up to 1e6, to 3e-16; those of larger angles are as exact as the angle itself."""
    for i in range(len(angle)):
        x = angle[i]
        quarters = (x * _PER_QUARTER + _WHOLE) - _WHOLE
        s, c = within_an_eighth(((x - quarters * _QUARTER_1) - quarters * _QUARTER_2) - quarters * _QUARTER_3)
        # Quarters without whole turns, 0 to 3, and whether their number is odd.
        quarter = quarters - 4.0 * ((0.25 * quarters - 0.375 + _WHOLE) - _WHOLE)
        odd = quarter - 2.0 * ((0.5 * quarter - 0.25 + _WHOLE) - _WHOLE)
        across, along = (s, c) if odd == 0.0 else (c, s)
        sin[i] = across if quarter < 1.5 else -across
        cos[i] = along if quarter < 0.5 or quarter > 2.5 else -along


@compiled
def exponentials(x: Array, scale: Array) -> None:
    """Replace each number x (n, 0 or less) by its exponential, with a relative error of 4e-16; below -700 by that of -700. `scale` (n) is work
    space."""
    bits = scale.view(np.int64)
    for i in range(len(x)):
        x[i] = max(x[i], _LEAST)
        scale[i] = x[i] * _PER_DOUBLING + _WHOLE
    for i in range(len(x)):
        doublings = scale[i] - _WHOLE
        r = (x[i] - doublings * _DOUBLING_1) - doublings * _DOUBLING_2
        # Taylor's series: |r| is at most 0.35, so the terms that are left out are below 2e-16.
        p = 1.0 / 39916800.0 + r * (1.0 / 479001600.0)
        p = 1.0 / 40320.0 + r * (1.0 / 362880.0 + r * (1.0 / 3628800.0 + r * p))
        p = 1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0 + r * p))
        p = 0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * p))
        x[i] = 1.0 + (r + r * r * p)
    for i in range(len(x)):
        bits[i] = (bits[i] << _FRACTION) + (_BIAS << _FRACTION)
    for i in range(len(x)):
        x[i] *= scale[i]
