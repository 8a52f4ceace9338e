"""The modes: what each must know of the vehicle, its fallback, and which commands it follows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from uwserver.autopilot.config import Gains, Mode
from uwserver.autopilot.rows import MODES
from uwserver.autopilot.state import Estimate
from uwserver.units import NANOSECONDS

CERTAIN_MPS = 0.3
"""Without a DVL the velocity counts as known if its standard deviation is less than this."""

NEEDS: Mapping[Mode, tuple[str, ...]] = {
    "manual": (),
    "stabilise": ("attitude",),
    "acro": ("attitude",),
    "depth_hold": ("attitude", "depth"),
    "altitude_hold": ("attitude", "depth", "altitude"),
    "heading_hold": ("attitude", "heading"),
    "position_hold": ("attitude", "heading", "depth", "position"),
    "velocity": ("attitude", "heading", "depth", "velocity"),
    "guided": ("attitude", "heading", "depth", "position"),
    "mission": ("attitude", "heading", "depth", "position"),
    "surface": (),
}

FALLBACK: Mapping[Mode, Mode] = {
    "stabilise": "manual",
    "acro": "manual",
    "heading_hold": "stabilise",
    "depth_hold": "stabilise",
    "altitude_hold": "depth_hold",
    "position_hold": "depth_hold",
    "velocity": "depth_hold",
    "guided": "depth_hold",
    "mission": "depth_hold",
}

FOLLOWS: Mapping[str, tuple[Mode, ...]] = {
    "depth": ("depth_hold", "position_hold", "velocity", "guided"),
    "altitude": ("altitude_hold",),
    "heading": ("stabilise", "depth_hold", "altitude_hold", "heading_hold", "position_hold", "velocity", "guided"),
    "attitude": ("guided",),
    "velocity": ("velocity", "guided"),
    "position": ("position_hold", "guided"),
    "test": MODES,
}
"""The modes in which the port of a set point takes commands. In the other modes it refuses them, so that nobody waits for an effect in vain."""

REMEDY: Mapping[str, str] = {
    "attitude": "no attitude: it needs a valid sensor of kind attitude, imu or motion_capture",
    "heading": "no heading: it needs a valid sensor of kind attitude or motion_capture",
    "depth": "no depth: it needs a valid sensor of kind pressure or motion_capture",
    "velocity": "no velocity over ground: it needs a dvl with bottom lock, or frequent positions, and a heading",
    "position": "no position: it needs a dvl with bottom lock, or valid gps, usbl, lbl or motion_capture, and a heading",
    "altitude": "no altitude: it needs an altimeter or a dvl that hears the bottom",
}


class Known(NamedTuple):
    """Which parts of an estimate can be trusted at an instant; `motion`: whether any sensor measures the horizontal motion."""

    attitude: bool
    heading: bool
    depth: bool
    velocity: bool
    position: bool
    altitude: bool
    motion: bool


NEEDED = tuple([tuple([name in NEEDS[mode] for name in Known._fields]) for mode in MODES])
"""`NEEDS` as truth values, in the order of `MODES` and of `Known`, for compiled code."""


def known(e: Estimate, gains: Gains, now_ns: int) -> Known:
    """Return which parts of an estimate are not older than their time-outs. It takes records; the compiled version takes rows."""
    ns = NANOSECONDS
    velocity = now_ns - e.velocity_ns <= gains.velocity_timeout_s * ns
    fixed = now_ns - e.fix_ns <= gains.position_timeout_s * ns
    motion = velocity or fixed
    if fixed and not velocity:
        velocity = e.flat[3] < CERTAIN_MPS**2
    attitude = now_ns - e.attitude_ns <= gains.attitude_timeout_s * ns
    heading = now_ns - e.heading_ns <= gains.attitude_timeout_s * ns
    depth = now_ns - e.depth_ns <= gains.depth_timeout_s * ns
    bottom = now_ns - e.altitude_ns <= gains.altitude_timeout_s * ns
    position = (velocity or fixed) and heading
    return Known(attitude, heading, depth, velocity and heading, position, bottom and not math.isnan(e.bottom), motion)


def missing(mode: Mode, known: Known) -> str:
    """Return the first thing that a mode needs and that is not known; "" if the mode can work."""
    return next((need for need in NEEDS[mode] if not getattr(known, need)), "")


def refuge(mode: Mode, known: Known) -> Mode:
    """Return the nearest fallback of a mode that can work."""
    while missing(mode, known):
        mode = FALLBACK[mode]
    return mode
