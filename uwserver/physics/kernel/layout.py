"""The arrays that the compiled kernel works on: one row a body, thruster, prescribed wrench, buoyancy shape or appendage.

Everything is float64 SI in frames N (NED) and B (FRD), about the body origin. Rows of one body are contiguous; a body names its range by
``first`` and ``count``. Plain numpy records keep the call into the kernel at one argument an array and make a snapshot a copy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from uwserver.physics.kernel.arrays import Array, IntArray

P, Q, NU = 0, 3, 7
"""Columns of a state row: p_NB (3, m), q_NB (4, w x y z), nu = v_NB_B (3, m/s) and w_NB_B (3, rad/s)."""
STATE_SIZE = 13

FLOW_V, FLOW_V_T, FLOW_GRADIENT, FLOW_PLANE, FLOW_P, FLOW_T, FLOW_KIND = 0, 3, 6, 15, 19, 22, 23
"""Columns of a flow row, the water near one body and one instant, all in N: velocity (3, m/s), its partial derivative by time (3, m/s2) and its
gradient (3, 3, 1/s; row i has the derivatives of component i), the plane that touches the surface (elevation at x = y = 0 in m, slopes along x
and y, rate of the elevation in m/s), the place (3, m) and the instant (s) of all these, and the kind."""
FLOW_SIZE = 24
STEADY, MOVING, WAVY = 0.0, 1.0, 2.0
"""Kinds of flow: the velocity alone counts; rates and gradient too; the surface too."""

WAVE_KX, WAVE_KY, WAVE_K, WAVE_OMEGA, WAVE_AMPLITUDE, WAVE_PHASE, WAVE_DEPTH = range(7)
"""Columns of a wave: wave number along x and y of N and its size (rad/m), angular frequency (rad/s), amplitude (m), phase (rad), depth of the
water (m, inf for deep water)."""
WAVE_SIZE = 7

PROFILE_SIZE = 15
"""Columns of a piece of a depth profile: from and to depth, depth of its origin (m), four coefficients of a cubic for each component in N."""

LAG_LEVELS = 5
"""A tick may be cut into 2**0 .. 2**4 sub-steps; the thruster lag has an exact transition matrix for half of each."""

TABLE_SIZE = 48
"""Points of a thruster's force table at one voltage."""
TABLE_VOLTAGES = 8

SHAPE_BOX, SHAPE_SPHERE = 0, 1

FREE, STUCK, STUCK_AT = 0, 1, 2
"""Whether a thruster listens to its commands."""

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
        ("displaced", "f8"),  # mass of the displaced water, kg, fully submerged
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
        ("in_contact", "i8"),  # 1: contacts act on the body in this tick
        ("contact", "f8", (6,)),  # their force (N) and moment about the origin (N m), both in N; constant in the tick
        (
            "external",
            "f8",
            (6,),
        ),  # wrench that acts in the coming tick, about the origin in B; constant in the tick, and zero after it
        ("acted", "f8", (6,)),  # the one that acted in the last tick
        ("retired", "i8"),  # 1: removed from the world; the kernel passes it over
        ("fitted", "i8"),  # 1: the body has any of the following
        ("servo_first", "i8"),
        ("servo_count", "i8"),
        ("foil_first", "i8"),
        ("foil_count", "i8"),
        ("propeller_first", "i8"),
        ("propeller_count", "i8"),
        ("weight_first", "i8"),
        ("weight_count", "i8"),
        ("derivative_first", "i8"),
        ("derivative_count", "i8"),
        ("hull_first", "i8"),
        ("hull_count", "i8"),
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
        ("stuck", "i8"),  # FREE, STUCK at its demand, or STUCK_AT stuck_u
        ("stuck_u", "f8"),
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


SERVO = np.dtype(
    [
        ("command", "f8"),  # rad, rad/s, m3 or m
        ("value", "f8"),  # where it is
        ("low", "f8"),
        ("high", "f8"),
        ("rate", "f8"),  # largest change a second; 0: stuck
        ("tau", "f8"),  # time constant of the lag, s
        ("efficiency", "f8"),  # scales the force of the foil or propeller that it sets: 1 healthy, 0 dead
    ],
    align=True,
)

FOIL = np.dtype(
    [
        ("servo", "i8"),  # row of the servo that sets its angle, -1 for a fixed one
        ("r", "f8", (3,)),  # centre of pressure in B, m
        ("chord", "f8", (3,)),  # towards the leading edge at zero angle, unit vector in B
        ("normal", "f8", (3,)),  # lift points there at a positive angle, unit vector in B
        ("pressure_area", "f8"),  # rho A / 2, kg/m
        ("slope", "f8"),  # dC_L/dalpha, 1/rad
        ("induced", "f8"),  # C_D of the lift over C_L squared
        ("cd0", "f8"),
        ("cd90", "f8"),  # normal force coefficient across the flow
        ("stall", "f8"),  # rad
        ("stall_end", "f8"),  # from here on a flat plate, rad
        ("whole", "i8"),  # 1: dynamic pressure of the whole speed, 0: without its part along the span
        ("radius", "f8"),  # half the span, m
    ],
    align=True,
)

PROPELLER_SIZE = 24
"""Points of a propeller's open-water curves."""

PROPELLER = np.dtype(
    [
        ("servo", "i8"),  # row of the servo that holds the shaft speed, rad/s
        ("r", "f8", (3,)),
        ("axis", "f8", (3,)),  # of the thrust at a positive shaft speed, unit vector in B
        ("diameter", "f8"),
        ("density", "f8"),
        ("wake", "f8"),  # 1 - w: speed of advance over the vehicle's
        ("deduction", "f8"),  # 1 - t: thrust on the vehicle over the propeller's
        ("astern", "f8"),  # thrust and torque astern over those ahead
        ("sense", "f8"),  # reaction torque along the axis for positive K_Q: -1 right-handed, 1 left-handed, 0 none
        ("whole", "i8"),  # 1: advances with the whole speed, 0: with its part along the axis
        ("points", "i8"),
        ("J", "f8", (PROPELLER_SIZE,)),  # ascending
        ("KT", "f8", (PROPELLER_SIZE,)),
        ("KQ", "f8", (PROPELLER_SIZE,)),
    ],
    align=True,
)

WEIGHT = np.dtype(
    [
        ("servo", "i8"),
        ("zero", "f8"),  # value at which nothing is added to the body's own weight and buoyancy
        ("force", "f8"),  # along z_N per unit of value, N
        ("moment", "f8", (3,)),  # its lever times the force in B: the moment is moment x z_N
        ("displaces", "i8"),  # 1: displaced volume, which counts as far as it is submerged
    ],
    align=True,
)

DERIVATIVE = np.dtype(
    [
        ("axis", "i8"),  # 0..5, X Y Z K M N
        ("j", "i8"),  # 0..5, u v w p q r of nu_r
        ("k", "i8"),
        ("servo", "i8"),  # row of the servo whose value is a factor too, -1 for none
        ("power", "i8"),  # of that value
        ("coefficient", "f8"),
    ],
    align=True,
)

HULL = np.dtype(
    [
        ("slow", "f8", (6,)),  # diagonal linear damping that fades with speed
        ("fade", "f8"),  # 1 / speed at which it is 1/e, s/m
        ("strips", "i8"),
        ("first", "f8"),  # x of the aftmost strip's centre, m
        ("spacing", "f8"),  # m
        ("sway", "f8"),  # rho C_d height spacing / 2, kg/m
        ("heave", "f8"),
        ("joint", "i8"),  # 1: drag by the resultant of both cross flows, 0: by each alone
    ],
    align=True,
)


SCRATCH = np.dtype(
    [
        ("s", "f8", (6, STATE_SIZE)),  # states and their derivatives, in the rows of `dynamics.scratch`
        ("work", "f8", (14, 6)),  # of `fossen.derivative`, likewise
        ("R", "f8", (3, 3)),  # R_NB
        ("M_inv", "f8", (6, 6)),  # inverse of M_RB + held M_A, which holds in a step
        ("small", "f8", (3, 3)),
    ],
    align=True,
)
"""Work space of a step. As a record it is one pointer to hand on, where arrays of their own cost two atomic counts each."""


class Model(NamedTuple):
    """All rows of a world but those of appendages, as one argument of a kernel.

    Attributes:
        bodies: (n) BODY.
        shapes: SHAPE rows of all bodies; likewise the others.
        forces: (m, 3) work space: lagged thrust of each thruster at the three stage times of a step, N.
    """

    bodies: Array
    shapes: Array
    thrusters: Array
    tables: Array
    lags: Array
    wrenches: Array
    forces: Array


class Fitted(NamedTuple):
    """All rows of appendages of a world; apart from `Model`, as most worlds have none.

    Attributes:
        servos: SERVO rows of all bodies; likewise the others.
        values: (m, 3) work space: value of each servo at the three stage times of a step.
    """

    servos: Array
    foils: Array
    propellers: Array
    weights: Array
    derivatives: Array
    hulls: Array
    values: Array


class SeaRows(NamedTuple):
    """The sea, as one argument of a kernel.

    Attributes:
        uniform: (7) velocity (m/s) in N at an instant, its rate (m/s2), the instant (s).
        profiles: (m, PROFILE_SIZE) pieces, all added where they apply.
        waves: (k, WAVE_SIZE).
    """

    uniform: Array
    profiles: Array
    waves: Array


CELL = np.dtype([("direction", "f8", 3), ("across", "f8", 3), ("along", "f8", 3), ("emitted", "f8")])
"""A ray of a fan: unit direction in the frame of the fan; unit vectors across it, towards growing azimuth and elevation, times the angles that
its cell covers; the intensity that goes into the cell, times its solid angle."""


Forms = Mapping[str, "np.dtype[Any]"]
"""Of each array of a table of addresses, in its order: name, and dtype of a row. The one list by which a table is written and read."""


def columns(dtype: type[np.generic], *shape: int) -> np.dtype[Any]:
    """The form of an array (n, *shape) of plain numbers."""
    return np.dtype((dtype, shape))


WORLD: Forms = {
    "bodies": BODY,
    "shapes": SHAPE,
    "thrusters": THRUSTER,
    "tables": TABLE,
    "lags": LAG,
    "wrenches": WRENCH,
    "servos": SERVO,
    "foils": FOIL,
    "propellers": PROPELLER,
    "weights": WEIGHT,
    "derivatives": DERIVATIVE,
    "hulls": HULL,
    "state": columns(np.float64, STATE_SIZE),
    "flows": columns(np.float64, FLOW_SIZE),
    "forces": columns(np.float64, 3),
    "values": columns(np.float64, 3),
    "scratch": SCRATCH,
}
"""The arrays of `bodies.Hydrodynamics`: those of `Model` and `Fitted`, states, flows and work space."""


def addresses(forms: Forms, arrays: Mapping[str, Any]) -> IntArray:
    """(n, 2) address and length of each array, by which a kernel finds them (`handles`). They must outlive the table.

    Args:
        forms: the list of the table.
        arrays: by name; others than those of the list do not matter.

    Raises:
        TypeError: an array is not of its form or not C-contiguous, so that a kernel would read something else.
    """
    table = np.empty((len(forms), 2), np.int64)
    for k, (name, form) in enumerate(forms.items()):
        array = arrays[name]
        if array.dtype != form.base or array.shape[1:] != form.shape or not array.flags.c_contiguous:
            raise TypeError(f"{name}: C-contiguous rows of {form} expected, found {array.dtype} {array.shape}")
        table[k] = array.ctypes.data, len(array)
    return table
