"""The scenario's table of a built-in autopilot."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.autopilot.state import Mode
from uwserver.table import Positive, Table, Vector3

Timeout = Annotated[float, Meta(ge=0, le=1e6)]


class AutopilotConfig(Table, kw_only=True, frozen=True):
    """Puts the built-in autopilot into a vehicle. It sees the samples of the vehicle's sensors, never the truth.

    Attributes:
        rate_hz: steps a second; divides the physics rate; default: the largest that does, up to 60.
        state_rate_hz: of its port `state`; likewise, up to 10.
        mode: at the start.
        armed: whether it holds the actuators at the start; a mode that holds begins where its sensors first find it.
        start_position_ned_m: where its dead reckoning begins; default: at the origin of N, until a sensor knows better.
        pilot_timeout_s: without a command of the pilot for so long the sticks spring back; 0 for never.
        setpoint_timeout_s: likewise the set points `velocity` and `attitude`.
        on_leak, on_low_battery: come up, or only say so.
        gains: instead of those of the vehicle file; names as there.
    """

    kind: Literal["builtin"] = "builtin"
    rate_hz: Positive | UnsetType = UNSET
    state_rate_hz: Positive | UnsetType = UNSET
    mode: Mode = "manual"
    armed: bool = False
    start_position_ned_m: Vector3 | UnsetType = UNSET
    pilot_timeout_s: Timeout = 1.0
    setpoint_timeout_s: Timeout = 1.0
    on_leak: Literal["surface", "warn"] = "surface"
    on_low_battery: Literal["surface", "warn"] = "surface"
    gains: dict[str, float] = field(default_factory=dict)
