"""What each mode needs to know, where it falls back to, and which commands it follows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import get_args

from uwserver.autopilot.estimator import Known
from uwserver.autopilot.state import Mode

MODES: tuple[Mode, ...] = get_args(Mode)

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
"""Modes in which a set point's port takes commands; the others refuse them, so that nobody waits for what will not come."""

REMEDY: Mapping[str, str] = {
    "attitude": "no attitude: it needs a valid sensor of kind attitude, imu or motion_capture",
    "heading": "no heading: it needs a valid sensor of kind attitude or motion_capture",
    "depth": "no depth: it needs a valid sensor of kind pressure or motion_capture",
    "velocity": "no velocity over ground: it needs a dvl with bottom lock, or frequent positions, and a heading",
    "position": "no position: it needs a dvl with bottom lock, or valid gps, usbl, lbl or motion_capture, and a heading",
    "altitude": "no altitude: it needs an altimeter or a dvl that hears the bottom",
}


def missing(mode: Mode, known: Known) -> str:
    """What keeps a mode from working, the first of it; "" for nothing."""
    return next((need for need in NEEDS[mode] if not getattr(known, need)), "")


def refuge(mode: Mode, known: Known) -> Mode:
    """The nearest safer mode that works."""
    while missing(mode, known):
        mode = FALLBACK[mode]
    return mode
