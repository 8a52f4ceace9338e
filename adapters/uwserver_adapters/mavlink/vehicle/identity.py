"""Who we say we are: an ArduSub vehicle of a version that ground stations know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from uwserver_adapters.mavlink.vehicle.modes import MODES
from uwserver_adapters.mavlink.wire.dialect import Fields

VERSION = (4, 5, 0)
"""Of ArduSub, whose protocol this is."""
_OFFICIAL = 255
FRAMES = {6: (1, "VECTORED"), 8: (2, "VECTORED_6DOF")}
"""FRAME_CONFIG and name of ArduSub's frame with so many thrusters."""
CUSTOM_FRAME = (7, "CUSTOM")
CAPABILITIES = (
    "MISSION_FLOAT", "PARAM_FLOAT", "MISSION_INT", "COMMAND_INT", "FTP", "SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT", "FLIGHT_TERMINATION", "MAVLINK2",
)  # fmt: skip
"""Of MAV_PROTOCOL_CAPABILITY; neither fence nor rally points."""


class Identity:
    """Version, capabilities, modes.

    Args:
        server: name and version of the server, for the banner.
        thrusters: how many the vehicle has.
        numbers: of the dialect's names.

    Attributes:
        frame: FRAME_CONFIG.
    """

    def __init__(self, server: str, thrusters: int, numbers: Mapping[str, int]) -> None:
        self.frame, self._frame_name = FRAMES.get(thrusters, CUSTOM_FRAME)
        self._server = server
        self._numbers = numbers

    @property
    def banner(self) -> Sequence[str]:
        """What ArduSub says when a ground station connects."""
        return (f"ArduSub V{'.'.join(map(str, VERSION))} ({self._server})", f"Frame: {self._frame_name}")

    def autopilot_version(self) -> Fields:
        """Fields of AUTOPILOT_VERSION."""
        major, minor, patch = VERSION
        return {
            "capabilities": sum(self._numbers[f"MAV_PROTOCOL_CAPABILITY_{name}"] for name in CAPABILITIES),
            "flight_sw_version": major << 24 | minor << 16 | patch << 8 | _OFFICIAL,
            "flight_custom_version": tuple(b"uwserver"),
        }

    def available_modes(self) -> Sequence[Fields]:
        """Fields of AVAILABLE_MODES, one message a mode. None is a MAV_STANDARD_MODE, as with ArduPilot: ground stations would call them by other
        names, and start missions by the old ones."""
        return [
            {
                "number_modes": len(MODES),
                "mode_index": index,
                "custom_mode": self._numbers[mode.entry],
                "mode_name": mode.name,
            }
            for index, mode in enumerate(MODES, 1)
        ]
