"""Estimate, memory and orders of an autopilot, as typed records. The values themselves are in rows (`rows`)."""

from __future__ import annotations

import math
from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct

from uwserver.autopilot.config import Gains, Mode
from uwserver.autopilot.mission import MAX_ITEMS, Item
from uwserver.frames import IDENTITY, Quat, Vec3

NAN = math.nan
NOWHERE: Vec3 = (NAN, NAN, NAN)
STILL: Vec3 = (0.0, 0.0, 0.0)
NEVER = -(10**18)
"""The time (ns) of a sample that never came."""

SetPointName = Literal["altitude", "depth", "heading", "place"]
GIVEN: tuple[SetPointName, ...] = get_args(SetPointName)
"""The set points that a command can set."""

Reason = Literal[
    "", "pilot", "leak", "battery", "sensor attitude", "sensor heading", "sensor depth", "sensor velocity", "sensor position",
    "sensor altitude",
]  # fmt: skip
"""The reasons of a fail-safe: why an autopilot does not do what it was told."""
REASONS: tuple[Reason, ...] = get_args(Reason)

Six = tuple[float, float, float, float, float, float]
Parts = Annotated[tuple[float, ...], Meta(max_length=1024)]
"""Commands of the actuators of a vehicle, as parts of their full commands."""


class Estimate(Struct):
    """The estimated state of the vehicle. SI, frames N and B.

    Attributes:
        q, w: attitude q_NB, and angular rate in B (rad/s).
        drift: estimated error of the gyroscope, which is subtracted from `w`, rad/s.
        p, v, bias: position, velocity and error of the acceleration, all in N.
        flat, steep: upper triangle of the covariance of (p, v, bias) along one axis: `flat` for both horizontal axes, `steep` for the vertical one.
        acceleration: sum of the accelerations that were measured since the last step, m/s2 in N.
        count: their number.
        bottom: depth of the bottom under the vehicle, m; nan if unknown.
        grade: slope of the bottom: by how much it gets deeper for each metre to the north, and to the east.
        leak, charge: readings of the leak and battery sensors; the charge is nan while unknown.
        refused, doubted, strange: number of consecutive position fixes, velocities, and echoes of the bottom that were rejected as too far off.
        imu_ns ... altitude_ns: time of the last valid sample of each, ns.
    """

    q: Quat = IDENTITY
    w: Vec3 = STILL
    drift: Vec3 = STILL
    p: Vec3 = STILL
    v: Vec3 = STILL
    bias: Vec3 = STILL
    flat: Six = (1e6, 0.0, 0.0, 1.0, 0.0, 0.01)
    steep: Six = (1e6, 0.0, 0.0, 1.0, 0.0, 0.01)
    acceleration: Vec3 = STILL
    count: int = 0
    bottom: float = NAN
    grade: tuple[float, float] = (0.0, 0.0)
    leak: bool = False
    charge: float = NAN
    refused: int = 0
    doubted: int = 0
    strange: int = 0
    imu_ns: int = NEVER
    attitude_ns: int = NEVER
    heading_ns: int = NEVER
    depth_ns: int = NEVER
    velocity_ns: int = NEVER
    fix_ns: int = NEVER
    altitude_ns: int = NEVER


class Memory(Struct):
    """The memory of the controllers.

    Attributes:
        push: integral of the position loops: the acceleration in N against buoyancy and current, m/s2.
        twist: integral of the rate loops: angular acceleration in B, rad/s2.
        crab: crab of a torpedo: course minus heading, rad.
        sag: sag of a torpedo: angle of its path down minus angle of its axis down, rad.
        through: speed through the water of a torpedo, as its propeller should have made it, m/s.
        tau: demanded wrench in B, N and N m.
        lack: the part of `tau` that the actuators could not make.
        outputs: last commands of the actuators, as parts of their full commands.
    """

    push: Vec3 = STILL
    twist: Vec3 = STILL
    crab: float = 0.0
    sag: float = 0.0
    through: float = 0.0
    tau: Six = (0.0,) * 6
    lack: Six = (0.0,) * 6
    outputs: Parts = ()


class Orders(Struct):
    """What the autopilot was told to do, and how far it has got.

    Attributes:
        gains: in use.
        waits: the autopilot is armed from the start, and waits for the sensors that the mode needs.
        stick: sticks of the pilot, -1..1 in B.
        pilot: whether a pilot steers: "" nobody yet, "on", or "lost".
        depth, altitude, heading, place: set points; nan if there is none. Of `place` (p_N) only north and east count. If the vehicle goes to a place
            at an altitude (`altitude` is given), `depth` and the depth of `place` follow the bottom.
        turn: commanded yaw rate, rad/s; nan if there is none.
        turn_limit: largest yaw rate while the vehicle turns to `heading`, rad/s.
        given: the set points that a command has set since the mode began.
        attitude, heave: those of an attitude command; the attitude is None if there is none.
        velocity: commanded velocity.
        frame: its frame; "" if no velocity is commanded.
        origin: start of the path to `place`. The vehicle follows the line from there.
        speed, radius: those of the path to `place`, m/s and m.
        looks: the vehicle turns its bow to where it goes.
        blind: the vehicle goes at an altitude and does not see the bottom, so it holds its depth.
        settled: a torpedo has arrived, and circles the place.
        astray: a torpedo has missed the place, and makes another run.
        length: length of the path of a `goto`, m.
        pace, bound: speed and heading that the mission has set for the items that follow; nan if it has not.
        items: the mission.
        index, reached: number of the present item (-1: none), and number of items that are done.
        entered: the present item has set its set points.
        waited: time spent at the place of the item, s.
        test: commands of a test of the actuators, as parts of the full ones; () if there is no test.
        failsafe: reason of the fail-safe; "" if there is none.
    """

    gains: Gains
    mode: Mode = "manual"
    armed: bool = False
    waits: bool = False
    stick: Six = (0.0,) * 6
    pilot: Literal["", "on", "lost"] = ""
    depth: float = NAN
    altitude: float = NAN
    heading: float = NAN
    place: Vec3 = NOWHERE
    turn: float = NAN
    turn_limit: float = math.inf
    given: Annotated[tuple[SetPointName, ...], Meta(max_length=4)] = ()
    attitude: Quat | None = None
    heave: float = 0.0
    velocity: Vec3 = STILL
    frame: Literal["", "B", "N"] = ""
    origin: Vec3 = NOWHERE
    speed: float = NAN
    radius: float = 1.0
    looks: bool = False
    blind: bool = False
    settled: bool = False
    astray: bool = False
    length: float = 0.0
    pace: float = NAN
    bound: float = NAN
    items: Annotated[tuple[Item, ...], Meta(max_length=MAX_ITEMS)] = ()
    index: int = -1
    reached: int = 0
    entered: bool = False
    waited: float = 0.0
    test: Parts = ()
    failsafe: Reason = ""


class Remembered(Struct, frozen=True):
    """The saved state of an autopilot, as the bytes of its rows: they are copied in a microsecond. `arrays.AutopilotRow.records` makes
    records of them.

    Attributes:
        row: `rows.REMEMBERED`.
        outputs, test: a float64 for each of its devices; `test` is empty if there is no test.
        items: its mission.
    """

    row: bytes
    outputs: bytes
    test: bytes
    items: Annotated[tuple[Item, ...], Meta(max_length=MAX_ITEMS)] = ()
