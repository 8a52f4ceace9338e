"""What an ArduSub says: its modes and the autopilot's modes that carry them out, its version and frame, and the autopilot's texts in its words."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct

from uwserver_adapters.mavlink.wire.dialect import Fields

VERSION = (4, 5, 0)
"""The version of ArduSub whose protocol this is."""
_OFFICIAL = 255
FRAMES = {6: (1, "VECTORED"), 8: (2, "VECTORED_6DOF")}
"""Number of thrusters -> FRAME_CONFIG and name of ArduSub's frame."""
CUSTOM_FRAME = (7, "CUSTOM")
CAPABILITIES = (
    "MISSION_FLOAT", "PARAM_FLOAT", "MISSION_INT", "COMMAND_INT", "FTP", "SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT", "FLIGHT_TERMINATION", "MAVLINK2",
)  # fmt: skip
"""Values of MAV_PROTOCOL_CAPABILITY; neither fences nor rally points."""


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


def banner(server: str, frame_name: str) -> Sequence[str]:
    """Return what ArduSub says when a ground station connects. `server` is the server's name and version."""
    return (f"ArduSub V{'.'.join(map(str, VERSION))} ({server})", f"Frame: {frame_name}")


def autopilot_version(numbers: Mapping[str, int]) -> Fields:
    """Return the fields of AUTOPILOT_VERSION. `numbers` are those of the dialect's names."""
    major, minor, patch = VERSION
    return {
        "capabilities": sum(numbers[f"MAV_PROTOCOL_CAPABILITY_{name}"] for name in CAPABILITIES),
        "flight_sw_version": major << 24 | minor << 16 | patch << 8 | _OFFICIAL,
        "flight_custom_version": tuple(b"uwserver"),
    }


def available_modes(numbers: Mapping[str, int]) -> Sequence[Fields]:
    """Return the fields of AVAILABLE_MODES, one message for each mode.

    None is declared as a MAV_STANDARD_MODE, as in ArduPilot: ground stations would show other names, and start missions by the old ones.
    """
    return [
        {
            "number_modes": len(MODES),
            "mode_index": index,
            "custom_mode": numbers[mode.entry],
            "mode_name": mode.name,
        }
        for index, mode in enumerate(MODES, 1)
    ]


_NAMES = "|".join({mode.autopilot for mode in MODES} | {"velocity", "heading_hold"})
_RULES: tuple[tuple[re.Pattern[str], str | Callable[[re.Match[str]], str]], ...] = (
    (re.compile(r"call \S+/set_mission first"), "upload one first"),
    (re.compile(r"call \S+/arm first"), "arm first"),
    (re.compile(r"call \S+/disarm first, or steer by \S+"), "disarm first, or steer by the sticks"),
    (
        re.compile(r"call \S+/set_mode with ([a-z_]+(?: or [a-z_]+)*) first"),
        lambda m: f"change to {_modes(m[1])} first",
    ),
    (re.compile(r"arm with force = true if you must"), "force arming if you must"),
    (re.compile(r"arm with force = true"), "force arming"),
    (re.compile(rf"\b(in mode|mode) ({_NAMES})\b"), lambda m: f"{m[1]} {shown(m[2]).name}"),
    (re.compile(rf"^({_NAMES})(?= has no )"), lambda m: shown(m[1]).name),
)


def _modes(names: str) -> str:
    """Return ArduSub's names of some of the autopilot's modes, each once."""
    return " or ".join(dict.fromkeys(shown(name).name for name in names.split(" or ")))


def in_words_of_mavlink(text: str) -> str:
    """Return a text of the autopilot as it is sent in STATUSTEXT."""
    for pattern, words in _RULES:
        text = pattern.sub(words, text)
    return text
