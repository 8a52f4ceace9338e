"""What an autopilot remembers, as typed records; they lie in rows (`rows`)."""

from __future__ import annotations

import math
from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct

from uwserver.autopilot.gains import Gains
from uwserver.autopilot.mission import MAX_ITEMS, Item
from uwserver.frames import IDENTITY, Quat, Vec3

NAN = math.nan
NOWHERE: Vec3 = (NAN, NAN, NAN)
STILL: Vec3 = (0.0, 0.0, 0.0)
NEVER = -(10**18)
"""Time (ns) of what was never heard."""

Mode = Literal[
    "manual", "stabilise", "acro", "depth_hold", "altitude_hold", "heading_hold", "position_hold", "velocity", "guided",
    "mission", "surface",
]  # fmt: skip

SetPointName = Literal["altitude", "depth", "heading", "place"]
GIVEN: tuple[SetPointName, ...] = get_args(SetPointName)
"""Set points that a command can set."""

Reason = Literal[
    "", "pilot", "leak", "battery", "sensor attitude", "sensor heading", "sensor depth", "sensor velocity", "sensor position",
    "sensor altitude",
]  # fmt: skip
"""Why an autopilot does not do what it was told."""
REASONS: tuple[Reason, ...] = get_args(Reason)

Six = tuple[float, float, float, float, float, float]
Parts = Annotated[tuple[float, ...], Meta(max_length=1024)]
"""Parts of the full commands of a vehicle's actuators."""


class Estimate(Struct):
    """Where the vehicle believes itself to be. SI, frames N and B.

    Attributes:
        q, w: attitude q_NB, angular rate in B (rad/s).
        drift: learnt error of the gyroscope, taken off `w`, rad/s.
        p, v, bias: position, velocity and error of the acceleration, all in N.
        flat, steep: upper triangle of the covariance of (p, v, bias) of one axis: of both horizontal ones, and of the vertical one.
        acceleration: sum of those measured since the last step, m/s2 in N; count: how many.
        bottom: depth of the bottom, m; nan when unknown.
        grade: how much deeper the bottom is a metre to the north, and to the east.
        leak, charge: as the probes say; the charge is nan while unknown.
        refused, doubted, strange: position fixes, velocities, and echoes of the bottom, in a row that were too far off.
        imu_ns ... altitude_ns: when each was last valid, ns.
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
    """What the controllers remember.

    Attributes:
        push: learnt acceleration in N that keeps the vehicle where it is (buoyancy, current), m/s2.
        twist: learnt angular acceleration in B, rad/s2.
        crab, sag: of a torpedo, its course less its heading, and the slope of its way down less that of its axis, rad.
        through: its speed by its propeller, m/s.
        tau: demanded wrench in B, N and N m.
        lack: what the actuators could not give of it.
        outputs: what the actuators were told, parts of their full commands.
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
    """What the autopilot was told, and how far it has come.

    Attributes:
        waits: armed from the start, until the sensors have spoken that the mode needs.
        stick: of the pilot, -1..1 in B.
        pilot: whether somebody steers: "" nobody yet, "on", or "lost".
        depth, altitude, heading, place: set points; nan for none. `place` is p_N of which only north and east count. On a way at an altitude
            (`altitude` is given) `depth` follows the bottom, and so does that of the place.
        turn: commanded yaw rate, rad/s; nan for none. `turn_limit`: on the way to `heading`.
        given: names of the set points that a command has set since the mode began.
        attitude, heave: of an attitude command; None without.
        velocity: commanded velocity; its frame is `frame`, "" without.
        origin: where the way to `place` began: a torpedo keeps to the line from there.
        speed, radius: on the way to `place`, m/s and m.
        looks: the vehicle looks where it goes.
        blind: on a way at an altitude the bottom is not seen, and the depth is held.
        settled, astray: a torpedo is there and circles the place; it has missed it and makes another run.
        length: of the way of a `goto`, m.
        pace, bound: speed and heading that a mission has set for what follows; nan for none.
        items, index, reached: mission, item under way (-1 none), items done.
        entered: the item under way has set its set points.
        waited: time spent at the item's place, s.
        test: parts of the full commands that are tried instead of control; () for none.
        failsafe: "" or the reason.
        gains: in use.
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
    """All that an autopilot goes on with, as it lies in its rows: copied in a microsecond, and understood by `bank.Seat.records` alone.

    Attributes:
        row: `rows.REMEMBERED`.
        outputs, test: float64 for each of its devices; `test` is empty where none is going on.
        items: its mission.
    """

    row: bytes
    outputs: bytes
    test: bytes
    items: Annotated[tuple[Item, ...], Meta(max_length=MAX_ITEMS)] = ()
