"""The rows of autopilots, for compiled code: one row for each vehicle, with its estimate, memory and orders, and what is known of the vehicle.

Python reads and writes the first three as typed records (`arrays.Live`): `state.Estimate`, `state.Memory`, `state.Orders`.
"""

from __future__ import annotations

from typing import get_args

import numpy as np

from uwserver import frames
from uwserver.autopilot.config import Gains, Mode
from uwserver.autopilot.state import Six
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
"""`state.Memory` without `outputs`, which are in the rows of the devices."""

GAINS = np.dtype([(name, "f8") for name in Gains.__struct_fields__])

ORDERS = np.dtype(
    [
        ("gains", GAINS),
        ("mode", "i8"),  # index in MODES
        ("armed", "i8"),
        ("waits", "i8"),
        ("stick", "f8", (6,)),
        ("pilot", "i8"),  # index in PILOTS
        ("depth", "f8"),
        ("altitude", "f8"),
        ("heading", "f8"),
        ("place", "f8", (3,)),
        ("turn", "f8"),
        ("turn_limit", "f8"),
        ("given", "i8"),  # one bit for each of GIVEN
        ("attitude", "f8", (4,)),  # nan if there is none
        ("heave", "f8"),
        ("velocity", "f8", (3,)),
        ("frame", "i8"),  # index in FRAMES
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
        ("failsafe", "i8"),  # index in REASONS
    ]
)
"""`state.Orders` without the mission and the test of the actuators."""

SHAFT = np.dtype([(name, "f8") for name in ("a", "b", "strength", "advance", "diameter", "astern", "limit")])
"""`allocation.Shaft`."""

SPEC = np.dtype(
    [
        ("divisor", "i8"),  # ticks per step
        ("dt", "f8"),  # of a step, s
        ("torpedo", "i8"),  # 1: controlled by `torpedo`; 0: by `hover`
        ("means", "i8"),  # kind of its actuators: THRUSTERS, FINS or WRENCHES of `allocation`
        ("up", "f8"),  # the vehicle is at the surface if its origin is above this depth, m
        ("device_first", "i8"),  # rows of its devices
        ("device_count", "i8"),
        ("axes", "i8", (6,)),  # 1 for each axis that can be controlled
        ("inertia", "f8", (6,)),
        ("linear", "f8", (6,)),  # damping
        ("quadratic", "f8", (6,)),
        ("reach", "f8", (6,)),
        ("righting", "f8"),
        ("shaft", SHAFT),
        # Of the estimator:
        ("has_imu", "i8"),
        ("has_attitude", "i8"),
        ("restlessness", "f8"),  # density of the error of the acceleration (`vehicle_spec.MEASURED`)
        ("gravity", "f8"),
        ("latitude", "f8"),  # of the origin of N, rad
        ("longitude", "f8"),
        # What Python tells compiled code, and the answers:
        ("errand", "i8"),  # 1: a call waits until the vehicle has arrived
        ("silence", "f8"),  # time since its last report of progress, s
        ("item", "i8"),  # kind of the present item of the mission
        ("lasts", "f8"),  # time to stay there, s
        ("items", "i8"),  # number of items of the mission
        ("testing", "i8"),  # 1: the actuators are being tested
        ("need", "i8"),  # what the step needs Python for: see `flight`
        ("gives", "i8"),  # 1: the step has made new commands for the devices
    ]
)
"""What an autopilot knows of its vehicle, and what Python and compiled code tell each other."""

REMEMBERED = np.dtype([("e", ESTIMATE), ("m", MEMORY), ("o", ORDERS)])
"""The part of a row that is saved with the world."""

PILOT = np.dtype([*((name, REMEMBERED[name]) for name in REMEMBERED.names or ()), ("c", SPEC)])
"""The row of one autopilot: REMEMBERED, and its vehicle."""

DEVICE = np.dtype(
    [
        ("kind", "i8"),  # THRUSTER, FIN, SHAFT_SPEED or WRENCH
        ("row", "i8"),  # its row in the bodies' arrays
        ("component", "i8"),  # index in the wrench, if it is a component of one
        ("by_force", "i8"),  # 1: a thruster that is commanded in N
        ("active", "i8"),
        ("into", "f8", (6,)),  # its force for one unit of each component of a wrench
        ("column", "f8", (6,)),  # the wrench of one unit of its force
        ("low", "f8"),  # limits of its force
        ("high", "f8"),
        ("full", "f8"),  # its full command
        ("curve_first", "i8"),  # first point of its thrust curve
        ("astern", "i8"),  # number of points astern, and ahead
        ("ahead", "i8"),
        ("first", "f8"),  # in a step: the force that the important axes demand
        ("rest", "f8"),  # in a step: the force that the other axes demand
        ("force", "f8"),  # its force, and then its command, in the unit of the command
        ("part", "f8"),  # its last command, as a part of the full command
        ("test", "f8"),  # the same of the command of a test
    ]
)
"""One thruster, fin, shaft or component of a wrench that the autopilot commands."""

THRUSTER, FIN, SHAFT_SPEED, WRENCH = range(4)

SENSOR = np.dtype(
    [
        ("pilot", "i8"),  # row
        ("next", "i8"),  # row of another SENSOR that reads the same stream, or -1
        ("kind", "i8"),  # index in `vehicle_spec.MESSAGES`
        ("place", "i8", (3,)),  # places of its fields in a row of the stream
        ("p", "f8", (3,)),
        ("q", "f8", (4,)),
        ("sigma", "f8"),
        ("north", "f8"),
        ("density", "f8"),
        ("atmosphere", "f8"),
        ("beacon_first", "i8"),
    ]
)
"""A stream that an autopilot reads: `vehicle_spec.SensorInput`."""

FORMS: Forms = {
    "pilots": PILOT,
    "devices": DEVICE,
    "curves": columns(np.float64, 2),
    "sensors": SENSOR,
    "beacons": columns(np.float64, 3),
    "listeners": columns(np.int64),
}
"""The arrays in the table of a world's autopilots. `listeners` has for each stream of a sensor the first SENSOR that reads it, or -1."""

rotate, multiply, conjugate, quat_from_rpy, rpy_from_quat = (
    compiled(frames.rotate), compiled(frames.multiply), compiled(frames.conjugate), compiled(frames.quat_from_rpy),
    compiled(frames.rpy_from_quat),
)  # fmt: skip
"""The functions of `uwserver.frames`, for compiled code."""


@inlined
def three(a: Array) -> Vec3:
    """Return a vector in a row."""
    return a[0], a[1], a[2]


@inlined
def four(a: Array) -> Quat:
    """Return a quaternion in a row."""
    return a[0], a[1], a[2], a[3]


@inlined
def six(a: Array) -> Six:
    """Return a wrench or a covariance in a row."""
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
