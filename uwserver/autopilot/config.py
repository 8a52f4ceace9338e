"""The table of the built-in autopilot in a scenario."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.autopilot.state import Mode
from uwserver.table import Positive, Table, Vector3

Timeout = Annotated[float, Meta(ge=0, le=1e6)]


class AutopilotConfig(Table, kw_only=True, frozen=True):
    """Puts the built-in autopilot into a vehicle. It reads the samples of the vehicle's sensors, never the truth.

    Attributes:
        rate_hz: steps per second; it must divide the physics rate; default: the largest such rate up to 60.
        state_rate_hz: rate of its port `state`; the same, up to 10.
        mode: at the start.
        armed: whether it commands the actuators from the start. It first waits for the sensors that the mode needs; what the mode holds (depth,
            place ...) begins at their first values.
        start_position_ned_m: where dead reckoning begins; default: the origin of N, until a sensor measures the position.
        pilot_timeout_s: after this time without a command from the pilot the sticks return to neutral; 0 for never.
        setpoint_timeout_s: after this time without a command the set points `velocity` and `attitude` end; 0 for never.
        on_leak, on_low_battery: come up, or only report it.
        gains: replace those of the vehicle file; the same names.
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
