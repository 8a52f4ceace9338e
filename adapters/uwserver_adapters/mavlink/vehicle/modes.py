"""The modes of ArduSub, and the modes of the built-in autopilot that carry them out. The dialect has their numbers."""

from __future__ import annotations

from msgspec import Struct


class Mode(Struct, frozen=True):
    """One mode of ArduSub.

    Attributes:
        name: its name in ground stations.
        autopilot: the autopilot's mode that carries it out.
        is_guided: set points of a companion computer are followed.
    """

    name: str
    autopilot: str
    is_guided: bool = False

    @property
    def entry(self) -> str:
        """Its name in the dialect, whose number is the `custom_mode`."""
        return f"SUB_MODE_{self.name}"


MANUAL = Mode("MANUAL", "manual")
GUIDED = Mode("GUIDED", "guided", is_guided=True)
AUTO = Mode("AUTO", "mission")
ALT_HOLD = Mode("ALT_HOLD", "depth_hold")
POSHOLD = Mode("POSHOLD", "position_hold")
SURFACE = Mode("SURFACE", "surface")
MODES = (
    Mode("STABILIZE", "stabilise"),
    Mode("ACRO", "acro"),
    ALT_HOLD,
    AUTO,
    GUIDED,
    SURFACE,
    POSHOLD,
    MANUAL,
    Mode("SURFTRAK", "altitude_hold"),
)
BY_ENTRY = {mode.entry: mode for mode in MODES}
BY_NAME = {mode.name: mode for mode in MODES}
_BY_AUTOPILOT = {mode.autopilot: mode for mode in MODES}
_BY_AUTOPILOT |= {
    "velocity": GUIDED,  # a set point of velocity in GUIDED enters it
    "heading_hold": BY_NAME["STABILIZE"],  # ArduSub's STABILIZE also holds the heading
}


def shown(autopilot: str) -> Mode:
    """Return ArduSub's mode for a mode of the autopilot; MANUAL for an unknown one."""
    return _BY_AUTOPILOT.get(autopilot, MANUAL)
