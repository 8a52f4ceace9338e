"""The table of the built-in autopilot in a scenario: its modes, and the gains, limits and time-outs of its controllers.

Loops whose output is an acceleration have gains per unit of inertia, so that one set of gains fits vehicles of any size. The controller multiplies
with the inertia of the vehicle, added mass included.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.table import Positive, Table, Vector3

Gain = Annotated[float, Meta(ge=0, le=1000)]


class Gains(Table, kw_only=True, frozen=True, omit_defaults=False):
    """Gains, limits and time-outs of the controllers. All can be read and changed while the autopilot runs.

    Attributes:
        rate_p, rate_i: roll and pitch rate to angular acceleration, 1/s and 1/s2.
        attitude_p: roll and pitch to rate, 1/s.
        yaw_rate_p, yaw_rate_i: yaw rate to angular acceleration, 1/s and 1/s2.
        heading_p: heading to yaw rate, 1/s.
        climb_p, climb_i: vertical speed to acceleration, 1/s and 1/s2.
        depth_p: depth to vertical speed, 1/s. Torpedo: depth error to the slope of its path, rad/m.
        velocity_p, velocity_i: horizontal speed to acceleration, 1/s and 1/s2.
        position_p: horizontal position to speed, 1/s.
        unwind: how fast an integral decreases while an actuator is at its limit, 1/s.
        look_ahead_m: a torpedo steers at a point on its line, this far ahead.
        orbit_m: radius of the circle on which a torpedo holds a position.
        stick: part of the actuators' power that a full stick commands where it acts on forces.
        max_tilt_rad: roll and pitch at full stick, and the steepest path of a torpedo.
        max_rate_radps: largest roll and pitch rate, and that of a full stick.
        max_yaw_rate_radps: largest yaw rate, and that of a full stick.
        max_climb_mps: largest vertical speed, and that of a full stick.
        max_speed_mps: largest horizontal speed, and that of a full stick.
        cruise_mps: speed on the way to a place, if no other is given.
        surface_mps: vertical speed on the way to the surface.
        min_altitude_m: a vehicle that goes at an altitude stays at least this far above the bottom.
        max_depth_m: a vehicle that goes at an altitude goes no deeper than this.
        max_rise_rad: steepest path of a torpedo upwards, over a rising bottom.
        shaft_per_speed: shaft speed of a torpedo over its speed, used while it cannot measure its speed, rad/m.
        attitude_timeout_s: the attitude is lost after this time without a valid sample.
        depth_timeout_s: the same for the depth.
        velocity_timeout_s: the same for the velocity over ground.
        position_timeout_s: the same for a position fix, while the velocity is lost.
        altitude_timeout_s: the same for the altitude.
        battery_low: charge (part of the capacity) at which the vehicle surfaces.
    """

    # Encoded with its defaults (`omit_defaults=False`): equal gains must give equal saved states.

    rate_p: Gain = 6.0
    rate_i: Gain = 3.0
    attitude_p: Gain = 3.0
    yaw_rate_p: Gain = 4.0
    yaw_rate_i: Gain = 1.5
    heading_p: Gain = 1.5
    climb_p: Gain = 2.5
    climb_i: Gain = 0.8
    depth_p: Gain = 0.8
    velocity_p: Gain = 2.0
    velocity_i: Gain = 0.6
    position_p: Gain = 0.5
    unwind: Gain = 2.0
    look_ahead_m: Positive = 10.0
    orbit_m: Positive = 15.0
    stick: Gain = 1.0
    max_tilt_rad: Positive = 0.5
    max_rate_radps: Positive = 1.5
    max_yaw_rate_radps: Positive = 0.8
    max_climb_mps: Positive = 0.4
    max_speed_mps: Positive = 0.6
    cruise_mps: Positive = 0.4
    surface_mps: Positive = 0.3
    min_altitude_m: Positive = 0.5
    max_depth_m: Positive = 12_000.0
    max_rise_rad: Positive = 0.45
    shaft_per_speed: Gain = 80.0
    attitude_timeout_s: Positive = 0.5
    depth_timeout_s: Positive = 1.0
    velocity_timeout_s: Positive = 2.0
    position_timeout_s: Positive = 5.0
    altitude_timeout_s: Positive = 2.0
    battery_low: Annotated[float, Meta(ge=0, le=1)] = 0.1


Mode = Literal[
    "manual", "stabilise", "acro", "depth_hold", "altitude_hold", "heading_hold", "position_hold", "velocity", "guided",
    "mission", "surface",
]  # fmt: skip
"""What the autopilot holds or follows."""

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
