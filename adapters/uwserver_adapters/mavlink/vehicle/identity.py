"""What the vehicle says of itself: an ArduSub of a version that ground stations know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from uwserver_adapters.mavlink.vehicle.modes import MODES
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
