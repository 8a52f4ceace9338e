"""The arrays that the compiled kernel works on: one row a body, thruster, prescribed wrench or buoyancy shape.

Everything is float64 SI in frames N (NED) and B (FRD), about the body origin. Rows of one body are contiguous; a body names its range by
``first`` and ``count``. Plain numpy records keep the call into the kernel at one argument an array and make a snapshot a copy.
"""

from __future__ import annotations

import numpy as np

P, Q, NU = 0, 3, 7
"""Columns of a state row: p_NB (3, m), q_NB (4, w x y z), nu = v_NB_B (3, m/s) and w_NB_B (3, rad/s)."""
STATE_SIZE = 13

LAG_LEVELS = 5
"""A tick may be cut into 2**0 .. 2**4 sub-steps; the thruster lag has an exact transition matrix for half of each."""

TABLE_SIZE = 48
"""Points of a thruster's force table at one voltage."""
TABLE_VOLTAGES = 8

SHAPE_BOX, SHAPE_SPHERE = 0, 1

BODY = np.dtype(
    [
        ("M_RB", "f8", (6, 6)),
        ("M_A", "f8", (6, 6)),  # already scaled to the density of the water
        ("M_inv", "f8", (6, 6)),  # (M_RB + M_A)^-1, fully submerged
        ("D_L", "f8", (6, 6)),
        ("D_Q", "f8", (6, 6)),
        ("D_S", "f8", (6, 6)),
        # Form of each matrix: 0 zero, 1 diagonal, 2 full. Most vehicles are diagonal, which saves most of the multiplications.
        ("form_M_RB", "i8"),
        ("form_M_A", "i8"),
        ("form_D_L", "i8"),
        ("form_D_Q", "i8"),
        ("form_D_S", "i8"),
        ("weight", "f8"),  # N
        ("buoyancy", "f8"),  # N, fully submerged
        ("r_g", "f8", (3,)),
        ("r_b", "f8", (3,)),
        # Bounds of the damping's fastest rate, 1/s: rate <= rate_L + sum_j rate_Q[j] |nu_r[j]| + rate_S |u_r|.
        ("rate_L", "f8"),
        ("rate_Q", "f8", (6,)),
        ("rate_S", "f8"),
        ("radius", "f8"),  # no part of the buoyancy shapes is farther from the origin, m
        ("shape_first", "i8"),
        ("shape_count", "i8"),  # 0: always fully submerged
        ("thruster_first", "i8"),
        ("thruster_count", "i8"),
        ("wrench_first", "i8"),
        ("wrench_count", "i8"),
    ],
    align=True,
)

SHAPE = np.dtype(
    [
        ("kind", "i8"),
        ("center", "f8", (3,)),  # in B, m
        ("half", "f8", (3,)),  # box: half edges; sphere: radius in half[0]
        ("share", "f8"),  # part of the body's displaced volume, the shares of a body add up to 1
    ],
    align=True,
)

THRUSTER = np.dtype(
    [
        ("per_force", "f8", (6,)),  # wrench about the origin in B per newton: [axis; r x axis + reaction torque]
        ("per_velocity", "f8", (6,)),  # times nu_r: speed of the mount along the axis; [axis; r x axis]
        ("r", "f8", (3,)),  # mount in B, m
        ("inflow", "f8"),  # k in T = T0 - k sqrt(|T0|) V_a, sqrt(N) s/m
        ("disc_radius", "f8"),  # m
        ("table", "i8"),  # row of the force tables
        ("lag", "i8"),  # row of the lags
        ("voltage", "f8"),
        ("installed", "f8"),  # installed thrust over open-water thrust
        ("efficiency", "f8"),  # 1 healthy, 0 dead
        ("command", "f8"),  # u in -1..1, or N with by_force
        ("by_force", "i8"),
        ("fresh", "i8"),  # command or voltage were set since the demand was computed
        ("demand", "f8"),  # static thrust asked for, N
        ("x", "f8", (3,)),  # state of the lag
    ],
    align=True,
)

LAG = np.dtype(
    [
        # y = C x + D u of x' = A x + B u, with the exact transition x+ = F x + G u over half of each sub-step length.
        ("F", "f8", (LAG_LEVELS, 3, 3)),
        ("G", "f8", (LAG_LEVELS, 3)),
        ("C", "f8", (3,)),
        ("D", "f8"),
    ],
    align=True,
)

TABLE = np.dtype(
    [
        ("n_voltages", "i8"),
        ("voltage", "f8", (TABLE_VOLTAGES,)),  # ascending
        ("u", "f8", (TABLE_VOLTAGES, TABLE_SIZE)),  # ascending in each row
        ("force", "f8", (TABLE_VOLTAGES, TABLE_SIZE)),  # N
    ],
    align=True,
)

WRENCH = np.dtype(
    [
        ("frame", "i8"),  # 0: components in B, 1: in N; always about the body origin
        ("bias", "f8", (6,)),
        ("amplitude", "f8", (6,)),
        ("omega", "f8", (6,)),
        ("phase", "f8", (6,)),
        ("harmonic", "i8"),  # 0: the amplitudes are all zero
    ],
    align=True,
)
