"""What an autopilot is in compiled code: one row a vehicle, of what it believes, remembers, was told, and knows of its vehicle.

Python reads and writes such a row by typed records of the same names (`records.Live`): `state.Estimate`, `state.Memory`, `state.Orders`.
"""

from __future__ import annotations

from typing import get_args

import numpy as np

from uwserver import frames
from uwserver.autopilot.gains import Gains
from uwserver.autopilot.state import Mode, Six
from uwserver.frames import Quat, Vec3
from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled, inlined
from uwserver.physics.kernel.layout import Forms, columns

MODES: tuple[Mode, ...] = get_args(Mode)
(
    MANUAL, STABILISE, ACRO, DEPTH_HOLD, ALTITUDE_HOLD, HEADING_HOLD, POSITION_HOLD, VELOCITY, GUIDED, MISSION, SURFACE,
) = range(len(MODES))  # fmt: skip
"""Codes of the modes."""

FRAMES = "", "B", "N"
NO_FRAME, IN_B, IN_N = range(3)
PILOTS = "", "on", "lost"

ESTIMATE = np.dtype(
    [
        *((name, "f8", (size,)) for name, size in (("q", 4), ("w", 3), ("drift", 3), ("p", 3), ("v", 3), ("bias", 3))),
        ("flat", "f8", (6,)),
        ("steep", "f8", (6,)),
        ("acceleration", "f8", (3,)),
        ("count", "i8"),
        ("bottom", "f8"),
        ("grade", "f8", (2,)),
        ("leak", "i8"),
        ("charge", "f8"),
        *(
            (name, "i8")
            for name in (
                "refused", "doubted", "strange", "imu_ns", "attitude_ns", "heading_ns", "depth_ns", "velocity_ns", "fix_ns", "altitude_ns",
            )
        ),
    ]
)  # fmt: skip
"""`state.Estimate`."""

MEMORY = np.dtype(
    [
        ("push", "f8", (3,)),
        ("twist", "f8", (3,)),
        ("crab", "f8"),
        ("sag", "f8"),
        ("through", "f8"),
        ("tau", "f8", (6,)),
        ("lack", "f8", (6,)),
    ]
)
"""`state.Memory`, but for its outputs, which stand with the devices."""

GAINS = np.dtype([(name, "f8") for name in Gains.__struct_fields__])

ORDERS = np.dtype(
    [
        ("gains", GAINS),
        ("mode", "i8"),  # place in MODES
        ("armed", "i8"),
        ("waits", "i8"),
        ("stick", "f8", (6,)),
        ("pilot", "i8"),  # place in PILOTS
        ("depth", "f8"),
        ("altitude", "f8"),
        ("heading", "f8"),
        ("place", "f8", (3,)),
        ("turn", "f8"),
        ("turn_limit", "f8"),
        ("given", "i8"),  # a bit for each of GIVEN
        ("attitude", "f8", (4,)),  # nan for none
        ("heave", "f8"),
        ("velocity", "f8", (3,)),
        ("frame", "i8"),  # place in FRAMES
        ("origin", "f8", (3,)),
        ("speed", "f8"),
        ("radius", "f8"),
        ("looks", "i8"),
        ("blind", "i8"),
        ("settled", "i8"),
        ("astray", "i8"),
        ("length", "f8"),
        ("pace", "f8"),
        ("bound", "f8"),
        ("index", "i8"),
        ("reached", "i8"),
        ("entered", "i8"),
        ("waited", "f8"),
        ("failsafe", "i8"),  # place in REASONS
    ]
)
"""`state.Orders`, but for the mission and the test of actuators."""

SHAFT = np.dtype([(name, "f8") for name in ("a", "b", "strength", "advance", "diameter", "astern", "limit")])
"""`fins.Shaft`."""

CRAFT = np.dtype(
    [
        ("divisor", "i8"),  # ticks of a step
        ("dt", "f8"),
        ("torpedo", "i8"),  # 1: it is flown as one; 0: as a vehicle that hovers
        ("means", "i8"),  # what it is driven by: code of the allocation
        ("up", "f8"),  # depth of the origin from which on it has come up, m
        ("device_first", "i8"),
        ("device_count", "i8"),
        ("axes", "i8", (6,)),  # 1 for those that can be controlled
        ("inertia", "f8", (6,)),
        ("linear", "f8", (6,)),  # damping
        ("quadratic", "f8", (6,)),
        ("reach", "f8", (6,)),
        ("righting", "f8"),
        ("shaft", SHAFT),
        # Of the estimator:
        ("has_imu", "i8"),
        ("has_attitude", "i8"),
        ("restlessness", "f8"),  # density of the error of the acceleration
        ("gravity", "f8"),
        ("latitude", "f8"),  # of the origin of N, rad
        ("longitude", "f8"),
        # What goes on in Python, as compiled code has to know of it:
        ("errand", "i8"),  # 1: a call waits for the end of the way
        ("silence", "f8"),  # since that was last told how far it is, s
        ("item", "i8"),  # kind of the item under way
        ("lasts", "f8"),  # of that: time to stay, s
        ("items", "i8"),  # of its mission
        ("testing", "i8"),  # 1: the actuators are tried
        ("need", "i8"),  # what it needs of Python: see `flight`
        ("gives", "i8"),  # 1: the devices have new commands
    ]
)
"""What an autopilot knows of its vehicle."""

REMEMBERED = np.dtype([("e", ESTIMATE), ("m", MEMORY), ("o", ORDERS)])
"""What of an autopilot changes as it flies, but for what compiled code is told of things that go on in Python."""

PILOT = np.dtype([*((name, REMEMBERED[name]) for name in REMEMBERED.names or ()), ("c", CRAFT)])
"""One autopilot: REMEMBERED, and its vehicle."""

DEVICE = np.dtype(
    [
        ("kind", "i8"),  # THRUSTER, FIN, SHAFT_SPEED or WRENCH
        ("row", "i8"),  # in the bodies' arrays
        ("component", "i8"),  # of a wrench
        ("by_force", "i8"),  # 1: a thruster that is commanded in N
        ("active", "i8"),
        ("into", "f8", (6,)),  # what it makes of each component of a wrench
        ("column", "f8", (6,)),  # the wrench that its unit makes
        ("low", "f8"),
        ("high", "f8"),
        ("full", "f8"),  # its full command
        ("curve_first", "i8"),
        ("astern", "i8"),  # points of its curve with a force below zero, then those above
        ("ahead", "i8"),
        ("first", "f8"),  # of a step: what the important axes want, the others, and what it gets
        ("rest", "f8"),
        ("force", "f8"),  # its command, in its unit
        ("part", "f8"),  # what it was told, part of its full command
        ("test", "f8"),  # what it is tried with
    ]
)
"""One thruster, fin, shaft or component of a wrench that the autopilot commands."""

THRUSTER, FIN, SHAFT_SPEED, WRENCH = range(4)

SOURCE = np.dtype(
    [
        ("pilot", "i8"),  # row
        ("next", "i8"),  # row of another one that hears the same stream, or -1
        ("kind", "i8"),  # place in `sources.MESSAGES`
        ("place", "i8", (3,)),  # of its fields among the numbers of the stream
        ("p", "f8", (3,)),
        ("q", "f8", (4,)),
        ("sigma", "f8"),
        ("north", "f8"),
        ("density", "f8"),
        ("atmosphere", "f8"),
        ("beacon_first", "i8"),
    ]
)
"""A stream that an autopilot hears: `sources.Source`."""


FORMS: Forms = {
    "pilots": PILOT,
    "devices": DEVICE,
    "curves": columns(np.float64, 2),
    "sources": SOURCE,
    "beacons": columns(np.float64, 3),
    "ears": columns(np.int64),
}
"""Of the table of a world's autopilots; `ears`: of each stream of a sensor the first SOURCE that hears it, or -1."""


rotate, multiply, conjugate, quat_from_rpy, rpy_from_quat = (
    compiled(frames.rotate), compiled(frames.multiply), compiled(frames.conjugate), compiled(frames.quat_from_rpy),
    compiled(frames.rpy_from_quat),
)  # fmt: skip
"""Of `uwserver.frames`, for compiled code."""


@inlined
def three(a: Array) -> Vec3:
    """A vector of a row."""
    return a[0], a[1], a[2]


@inlined
def four(a: Array) -> Quat:
    """A quaternion of a row."""
    return a[0], a[1], a[2], a[3]


@inlined
def six(a: Array) -> Six:
    """A wrench or covariance of a row."""
    return a[0], a[1], a[2], a[3], a[4], a[5]


@inlined
def set_three(a: Array, v: Vec3) -> None:
    """Write a vector into a row."""
    a[0], a[1], a[2] = v


@inlined
def set_four(a: Array, q: Quat) -> None:
    """Write a quaternion into a row."""
    a[0], a[1], a[2], a[3] = q


@inlined
def set_six(a: Array, v: Six) -> None:
    """Write six numbers into a row."""
    a[0], a[1], a[2], a[3], a[4], a[5] = v
