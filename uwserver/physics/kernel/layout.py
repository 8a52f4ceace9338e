"""The arrays that the compiled kernels work on: one row for each body, thruster, prescribed wrench, buoyancy shape or appendage.

Rows are records of float64 and int64; states, flows and work space are float64 alone. All is SI, in the frames N (NED) and B (FRD), about the body
origin. The rows of one body are contiguous; a body names its range by ``first`` and ``count``. A kernel gets all arrays of a world as one table of
addresses (`addresses`, `handles`), and a snapshot is a copy of those that change.
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
"""Columns of a flow row, the water near one body at one instant, all in N: velocity (3, m/s), its partial derivative by time (3, m/s2) and its
gradient (3, 3, 1/s; row i has the derivatives of component i), the plane that touches the surface (elevation at x = y = 0 in m, slopes along x and
y, rate of the elevation in m/s), the place (3, m) and the instant (s) for which all these hold, and the kind."""
FLOW_SIZE = 24
STEADY, MOVING, WAVY = 0.0, 1.0, 2.0
"""Kinds of flow: only the velocity counts; rates and gradient count too; the surface counts too."""

WAVE_KX, WAVE_KY, WAVE_K, WAVE_OMEGA, WAVE_AMPLITUDE, WAVE_PHASE, WAVE_DEPTH = range(7)
"""Columns of a wave: wave number along x and y of N and its size (rad/m), angular frequency (rad/s), amplitude (m), phase (rad), depth of the water
(m, inf for deep water)."""
WAVE_SIZE = 7

PROFILE_SIZE = 15
"""Columns of a piece of a depth profile: upper and lower depth, depth of the origin of the cubics (m), and four coefficients of a cubic for each
component in N."""

LAG_LEVELS = 5
"""A tick may be cut into 2**0 to 2**4 sub-steps. The thruster lag has an exact transition matrix for half of each."""

TABLE_SIZE = 48
"""Number of points of a thruster's force table at one voltage."""
TABLE_VOLTAGES = 8

SHAPE_BOX, SHAPE_SPHERE = 0, 1

NEAR_NOTHING, NEAR_SPHERE, NEAR_CYLINDER = 0, 1, 2
"""The shape as which a hull is treated where surface or bottom change its added mass. The cylinder lies along x of B."""

FREE, STUCK, STUCK_AT = 0, 1, 2
"""Whether a thruster obeys its commands: it does, it keeps its demand, or it keeps the command `stuck_u`."""

_Fields = list[tuple[str, str, tuple[int, ...]]]


def _f8(names: str, *shape: int) -> _Fields:
    """Return fields of float64, each a number or an array of this shape."""
    return [(name, "f8", shape) for name in names.split()]


def _i8(names: str) -> _Fields:
    """Return fields of whole numbers."""
    return [(name, "i8", ()) for name in names.split()]


def _ranges(names: str) -> _Fields:
    """Return the fields of ranges of rows that belong to a body: the first row and their number."""
    return [field for name in names.split() for field in _i8(f"{name}_first {name}_count")]


def _record(*groups: _Fields) -> np.dtype[Any]:
    return np.dtype([field for fields in groups for field in fields], align=True)


BODY = _record(
    _f8("M_RB", 6, 6),
    _f8("M_A", 6, 6),  # already scaled to the density of the water
    _f8("M_inv", 6, 6),  # (M_RB + M_A)^-1, fully submerged
    _f8("D_L D_Q D_S", 6, 6),
    # Form of each matrix: 0 zero, 1 diagonal, 2 full. Most vehicles are diagonal, which saves most of the multiplications.
    _i8("form_M_RB form_M_A form_D_L form_D_Q form_D_S"),
    _f8("weight buoyancy"),  # N at the surface; buoyancy fully submerged
    _f8("gravity_growth"),  # of both with depth, relative, 1/m
    _f8("displaced"),  # mass of the displaced water, kg, fully submerged
    _f8("r_g r_b", 3),
    # Bounds of the damping's fastest rate, 1/s: rate <= rate_L + sum_j rate_Q[j] |nu_r[j]| + rate_S |u_r|.
    _f8("rate_L"),
    _f8("rate_Q", 6),
    _f8("rate_S"),
    _f8("radius"),  # distance from the origin to the farthest part that the surface can affect, m
    _ranges("shape thruster wrench"),  # without shapes it is always fully submerged
    _ranges("strip"),  # of a long hull in waves
    _i8("strip_axis"),  # of B, along which they lie
    _f8("strip_half"),  # half the length that they share, m, about r_b
    # Factors about each axis of B for the turning of the water along the hull (1/m2), and for the first moment of its acceleration (1).
    _f8("strip_turn strip_moment", 3),
    _i8("near_form"),  # how M_A changes near surface and bottom: NEAR_NOTHING, NEAR_SPHERE or NEAR_CYLINDER
    _f8("near_radius"),  # of that sphere or cylinder, m
    _f8("floor"),  # depth of the level bottom, m, inf for none
    _i8("in_contact"),  # 1: contacts act on the body in this tick
    _f8("contact", 10),  # their force (N), moment about N's origin (N m) and its rate (N m/s), in N, from when on (s)
    _f8(
        "external", 6
    ),  # wrench from outside in the coming tick, about the origin in B; constant in the tick, zero after it
    _f8("acted", 6),  # wrench from outside that acted in the last tick
    _i8("retired"),  # 1: removed from the world; the kernels skip it
    _i8("fitted"),  # 1: the body has any of the following
    _ranges("servo foil propeller weight derivative hull"),
)

SHAPE = _record(
    _i8("kind"),
    _f8("center", 3),  # in B, m
    _f8("half", 3),  # box: half edges; sphere: radius in half[0]
    _f8("share"),  # part of the body's displaced volume, the shares of a body add up to 1
)

THRUSTER = _record(
    _f8("per_force", 6),  # wrench about the origin in B per newton: [axis; r x axis + reaction torque]
    _f8("per_velocity", 6),  # times nu_r: speed of the mount along the axis; [axis; r x axis]
    _f8("r", 3),  # mount in B, m
    _f8("inflow"),  # k in T = T0 - k sqrt(|T0|) V_a, sqrt(N) s/m
    _f8("drag"),  # of the stopped propeller over V_a |V_a|, N s2/m2
    _f8("disc_radius"),  # m
    _i8("table"),  # row of the force tables
    _i8("lag"),  # row of the lags
    _f8("voltage"),
    _f8("installed"),  # installed thrust over open-water thrust
    _f8("cross_loss"),  # c in exp(-c V_t^2) for the speed V_t across the axis, s2/m2
    _i8(
        "ventilates"
    ),  # 1: loses thrust near the surface by ventilation, 0: by the part of the disc that is out of the water
    _f8("efficiency"),  # 1 healthy, 0 dead
    _f8("command"),  # u in -1..1, or N with by_force
    _i8("by_force"),
    _i8("fresh"),  # command or voltage were set since the demand was computed
    _i8("stuck"),  # FREE, STUCK at its demand, or STUCK_AT stuck_u
    _f8("stuck_u"),
    _f8("demand"),  # static thrust asked for, N
    _f8("x", 3),  # state of the lag
)

LAG = _record(
    # y = C x + D u of x' = A x + B u, with the exact transition x+ = F x + G u over half of each sub-step length.
    _f8("F", LAG_LEVELS, 3, 3),
    _f8("G", LAG_LEVELS, 3),
    _f8("C", 3),
    _f8("D"),
)

TABLE = _record(
    _i8("n_voltages"),
    _f8("voltage", TABLE_VOLTAGES),  # ascending
    _f8("u", TABLE_VOLTAGES, TABLE_SIZE),  # ascending in each row
    _f8("force", TABLE_VOLTAGES, TABLE_SIZE),  # N
)

WRENCH = _record(
    _i8("frame"),  # 0: components in B, 1: in N; always about the body origin
    _f8("bias amplitude omega phase", 6),
    _i8("harmonic"),  # 0: the amplitudes are all zero
)

SERVO = _record(
    _f8("command"),  # rad, rad/s, m3 or m
    _f8("value"),  # present value
    _f8("low high"),
    _f8("rate"),  # largest change a second; 0: stuck
    _f8("tau"),  # time constant of the lag, s
    _f8("efficiency"),  # scales the force of the foil or propeller that it sets: 1 healthy, 0 dead
)

FOIL = _record(
    _i8("servo"),  # row of the servo that sets its angle, -1 for a fixed one
    _f8("r", 3),  # centre of pressure in B, m
    _f8("chord", 3),  # towards the leading edge at zero angle, unit vector in B
    _f8("normal", 3),  # lift points there at a positive angle, unit vector in B
    _f8("pressure_area"),  # rho A / 2, kg/m
    _f8("slope"),  # dC_L/dalpha, 1/rad
    _f8("induced"),  # C_D of the lift over C_L squared
    _f8("cd0"),
    _f8("cd90"),  # normal force coefficient across the flow
    _f8("stall stall_end"),  # rad; from the second on a flat plate
    _i8("whole"),  # 1: dynamic pressure of the whole speed, 0: without its part along the span
    _f8("radius"),  # half the span, m
)

PROPELLER_SIZE, HARMONICS = 24, 31
"""Most points of a propeller's open-water curves, and most terms of its series over the advance angle, including the constant one."""

PROPELLER = _record(
    _i8("servo"),  # row of the servo that holds the shaft speed, rad/s
    _f8("r", 3),
    _f8("axis", 3),  # of the thrust at a positive shaft speed, unit vector in B
    _f8("diameter density"),
    _f8("wake"),  # 1 - w: speed of advance over the vehicle's
    _f8("deduction"),  # 1 - t: thrust on the vehicle over the propeller's
    _f8("sense"),  # reaction torque along the axis for positive K_Q: -1 right-handed, 1 left-handed, 0 none
    _i8("whole"),  # 1: advances with the whole speed, 0: with its part along the axis
    _i8("harmonics"),  # 0: by its curves, else terms of `series`
    _f8("series", HARMONICS, 4),  # cosine and sine coefficients of C_T*, then of C_Q*
    _f8("stopped", 4),  # C_T* and C_Q* of the stopped propeller, ahead and astern, that the hull's damping has already
    _i8("points"),
    _f8("J KT KQ", PROPELLER_SIZE),  # J ascending
    _f8("astern"),  # thrust and torque astern over those ahead, by the curves
)

WEIGHT = _record(
    _i8("servo"),
    _f8("zero"),  # value at which nothing is added to the body's own weight and buoyancy
    _f8("force"),  # along z_N per unit of value, N
    _f8("moment", 3),  # its lever times the force in B: the moment is moment x z_N
    _i8("displaces"),  # 1: displaced volume, which counts as far as it is submerged
)

DERIVATIVE = _record(
    _i8("axis"),  # 0..5, X Y Z K M N
    _i8("j k"),  # 0..5, u v w p q r of nu_r
    _i8("servo"),  # row of the servo whose value is a factor too, -1 for none
    _i8("power"),  # of that value
    _f8("coefficient"),
)

HULL = _record(
    _f8("slow", 6),  # diagonal linear damping that fades with speed
    _f8("fade"),  # 1 / speed at which it is 1/e, s/m
    _i8("strips"),
    _f8("first"),  # x of the aftmost strip's centre, m
    _f8("spacing"),  # m
    _f8("sway heave"),  # rho C_d height spacing / 2, kg/m; likewise with the width
    _i8("joint"),  # 1: drag by the resultant of both cross flows, 0: by each alone
)

STRIP = _record(
    _f8("r", 3),  # in B, m
    _f8("share"),  # of the hull; the shares of a body add up to 1
    _f8("place"),  # on the hull from -1 to 1
    _f8(
        "barycentric bend"
    ),  # of interpolation: its weight, and the slope there of the polynomial that is 1 at this strip alone
    # The water there in N, at the place and instant for which `flows` was filled, as in its rows: place, velocity, its rate, its gradient.
    _f8("p v v_t", 3),
    _f8("gradient", 3, 3),
    _f8("u", 3),  # velocity of the water there at the present stage, N
)
"""A point of a long hull in waves."""

SCRATCH = _record(
    _f8("s", 6, STATE_SIZE),  # states and their derivatives, in the rows of `dynamics.scratch`
    _f8("work", 17, 6),  # of `fossen.derivative`, likewise
    _f8("R", 3, 3),  # R_NB
    _f8("M_inv", 6, 6),  # inverse of M_RB + held M_A, which holds in a step
    _f8("M_A M_A_z", 6, 6),  # M_A near surface and bottom, and its derivative by depth; of a body that asks for it
    _f8("small", 3, 3),
    _i8("diverged"),  # the first body that this thread found diverged in the tick
    _f8("apart", 8),  # a cache line of padding, so that no two threads write to the same one
)
"""Work space of a step, for one thread. As a record it is passed as one pointer; separate arrays would cost two atomic counts each."""


class Model(NamedTuple):
    """All rows of a world except those of appendages, as one argument of a kernel.

    Attributes:
        bodies: (n) BODY.
        shapes: SHAPE rows of all bodies; likewise the others.
        forces: (m, 3) work space: lagged thrust of each thruster at the three stage times of a step, N.
        strips: STRIP rows of all bodies.
    """

    bodies: Array
    shapes: Array
    thrusters: Array
    tables: Array
    lags: Array
    wrenches: Array
    forces: Array
    strips: Array


class Fitted(NamedTuple):
    """All rows of appendages of a world. They are separate from `Model`, as most worlds have none.

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
    """The moving water, as one argument of a kernel.

    Attributes:
        uniform: (7) velocity (m/s) in N at an instant, its rate (m/s2), the instant (s).
        profiles: (m, PROFILE_SIZE) pieces, all added where they apply.
        waves: (k, WAVE_SIZE).
    """

    uniform: Array
    profiles: Array
    waves: Array


Forms = Mapping[str, "np.dtype[Any]"]
"""The arrays of a table of addresses, in order: name, and dtype of a row. The table is written and read by this one list."""


class Codes(NamedTuple):
    """Addresses of the code that moves bodies in a tick, and of that which finds their accelerations (`contact.carrying`). Those of the contact
    stages are 0 in a world without solids."""

    advance: int
    rates: int
    strike: int
    finish_contacts: int


def columns(dtype: type[np.generic], *shape: int) -> np.dtype[Any]:
    """Return the form of an array (n, *shape) of plain numbers."""
    return np.dtype((dtype, shape))


WORLD: Forms = {
    "bodies": BODY,
    "shapes": SHAPE,
    "thrusters": THRUSTER,
    "tables": TABLE,
    "lags": LAG,
    "wrenches": WRENCH,
    "strips": STRIP,
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
    "team": columns(np.int64),
}
"""The arrays of `bodies.Hydrodynamics`: those of `Model` and `Fitted`, the states, flows and work space, and the team of threads (`sharing`)."""


def addresses(forms: Forms, arrays: Mapping[str, Any]) -> IntArray:
    """Return the address and length (n, 2) of each array, by which a kernel finds them (`handles`). The arrays must outlive the table.

    Args:
        forms: the list of the table.
        arrays: by name; arrays that are not in the list do not matter.

    Raises:
        TypeError: an array does not have its form or is not C-contiguous, so that a kernel would read something else.
    """
    table = np.empty((len(forms), 2), np.int64)
    for k, (name, form) in enumerate(forms.items()):
        array = arrays[name]
        if array.dtype != form.base or array.shape[1:] != form.shape or not array.flags.c_contiguous:
            raise TypeError(f"{name}: C-contiguous rows of {form} expected, found {array.dtype} {array.shape}")
        table[k] = array.ctypes.data, len(array)
    return table
