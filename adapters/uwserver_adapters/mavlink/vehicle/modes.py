"""Modes: ArduSub's numbers and names, and those of the built-in autopilot."""

from __future__ import annotations

from msgspec import Struct


class Mode(Struct, frozen=True):
    """One mode of ArduSub.

    Attributes:
        number: `custom_mode`.
        name: as ground stations show it.
        autopilot: what carries it out.
        is_guided: set points of a companion computer count.
    """

    number: int
    name: str
    autopilot: str
    is_guided: bool = False


MANUAL = Mode(19, "MANUAL", "manual")
GUIDED = Mode(4, "GUIDED", "guided", is_guided=True)
AUTO = Mode(3, "AUTO", "mission")
ALT_HOLD = Mode(2, "ALT_HOLD", "depth_hold")
POSHOLD = Mode(16, "POSHOLD", "position_hold")
SURFACE = Mode(9, "SURFACE", "surface")
MODES = (
    Mode(0, "STABILIZE", "stabilise"),
    Mode(1, "ACRO", "acro"),
    ALT_HOLD,
    AUTO,
    GUIDED,
    SURFACE,
    POSHOLD,
    MANUAL,
    Mode(21, "SURFTRAK", "altitude_hold"),
)
BY_NUMBER = {mode.number: mode for mode in MODES}
BY_NAME = {mode.name: mode for mode in MODES}
_BY_AUTOPILOT = {mode.autopilot: mode for mode in MODES}
_BY_AUTOPILOT |= {
    "velocity": GUIDED,  # entered by a set point of velocity in GUIDED
    "heading_hold": BY_NUMBER[0],  # ArduSub's STABILIZE holds the heading too
}


def shown(autopilot: str) -> Mode:
    """The mode of ArduSub that stands for one of the autopilot; MANUAL for one that is not known."""
    return _BY_AUTOPILOT.get(autopilot, MANUAL)
