"""The autopilot within the adapter: what pMarinePID does, and a depth that is held for missions in the plane. Simulation time alone counts."""

from __future__ import annotations

import math
from collections import deque

from uwserver_adapters.moos.codec import Fix, angle_of, degrees, heading_of, pitch_of, speed_through_water, turned
from uwserver_adapters.moos.config import PidTable

THRUST, RUDDER, ELEVATOR = "DESIRED_THRUST", "DESIRED_RUDDER", "DESIRED_ELEVATOR"
OUTPUTS = (THRUST, RUDDER, ELEVATOR)
HEADING, SPEED, DEPTH, FACTOR = "DESIRED_HEADING", "DESIRED_SPEED", "DESIRED_DEPTH", "SPEED_FACTOR"
INPUTS = (HEADING, SPEED, DEPTH, FACTOR)
DRIVEN_S = 2.0
"""Simulation time for which a write of an actuator's variable shows that somebody drives."""
_SLOPES = 9
_LEAST_THRUST = 0.01


class Loop:
    """A PID loop with pMarinePID's rules: the slope of the error is the mean of the last nine, integral and output are limited.

    Args:
        kp, ki, kd: gains.
        integral_limit: of the integral's part of the output.
        limit: of the output.
        is_heading: the error is one of headings, degrees, which begin anew after a turn.
    """

    def __init__(
        self, kp: float, ki: float, kd: float, integral_limit: float, limit: float, is_heading: bool = False
    ) -> None:
        self._is_heading = is_heading
        self._kp, self._ki, self._kd = kp, ki, kd
        self._integral_limit, self._limit = integral_limit, limit
        self._slopes: deque[float] = deque(maxlen=_SLOPES)
        self.reset()

    def reset(self) -> None:
        """Forget all that was."""
        self._slopes.clear()
        self._last: tuple[float, float] | None = None
        self._integral = 0.0

    def output(self, error: float, t_s: float) -> float:
        """The output for an error at a time."""
        if self._last is not None:
            before, at = self._last
            elapsed = t_s - at
            if elapsed > 0.0:
                change = turned(error - before) if self._is_heading else error - before
                self._slopes.append(change / elapsed)
                self._integral = _limited(self._integral + self._ki * error * elapsed, self._integral_limit)
        self._last = (error, t_s)
        slope = sum(self._slopes) / len(self._slopes) if self._slopes else 0.0
        return _limited(self._kp * error + self._kd * slope + self._integral, self._limit)


class DepthLoops:
    """From a depth to an elevator: depth to pitch, pitch to fins. A positive elevator goes deeper.

    Args:
        table: gains.
    """

    def __init__(self, table: PidTable) -> None:
        self._depth = Loop(
            table.z_to_pitch_pid_kp,
            table.z_to_pitch_pid_ki,
            table.z_to_pitch_pid_kd,
            table.z_to_pitch_pid_integral_limit,
            angle_of(table.maxpitch),
        )
        self._pitch = Loop(
            table.pitch_pid_kp,
            table.pitch_pid_ki,
            table.pitch_pid_kd,
            table.pitch_pid_integral_limit,
            angle_of(table.maxelevator),
        )

    def reset(self) -> None:
        """Forget all that was."""
        self._depth.reset()
        self._pitch.reset()

    def elevator(self, wanted: float, depth: float, pitch: float, t_s: float) -> float:
        """The value of DESIRED_ELEVATOR (degrees, by gains that fit degrees).

        Args:
            wanted, depth: m.
            pitch: rad, nose up.
            t_s: simulation time.
        """
        nose_up = self._depth.output(depth - wanted, t_s)
        return degrees(self._pitch.output(pitch - nose_up, t_s))


class Autopilot:
    """Heading, speed and depth to rudder, thrust and elevator.

    Args:
        table: gains and limits.

    Attributes:
        is_overridden: a person drives, until MOOS_MANUAL_OVERRIDE says false.
        stale: what is too old, "" for nothing.
    """

    def __init__(self, table: PidTable) -> None:
        self.is_overridden = True
        self.stale = ""
        self._table = table
        self._factor = table.speed_factor
        self._wanted: dict[str, tuple[float, float]] = {}
        self._thrust = 0.0
        self._yaw = Loop(
            table.yaw_pid_kp, table.yaw_pid_ki, table.yaw_pid_kd, table.yaw_pid_integral_limit, table.maxrudder, True
        )
        self._speed = Loop(
            table.speed_pid_kp, table.speed_pid_ki, table.speed_pid_kd, table.speed_pid_integral_limit, table.maxthrust
        )
        self._depth = DepthLoops(table)

    def hear(self, name: str, value: float, t_s: float) -> None:
        """One of INPUTS was written. Raises ValueError when it is not finite, or a negative factor."""
        if not math.isfinite(value):
            raise ValueError(f"{value} is no finite number")
        if name != FACTOR:
            self._wanted[name] = (value, t_s)
        elif value < 0.0:
            raise ValueError(f"{value} is negative")
        else:
            self._factor = value

    def override(self, is_on: bool) -> None:
        """A person takes over, or gives back: then all wishes must come anew."""
        if self.is_overridden != is_on:
            self.is_overridden = is_on
            self.reset()

    def reset(self) -> None:
        """Forget wishes and loops."""
        self._wanted.clear()
        self._thrust, self.stale = 0.0, ""
        for loop in (self._yaw, self._speed, self._depth):
            loop.reset()

    @property
    def has_control(self) -> bool:
        """Whether it drives: nobody overrides it, and all wishes have come."""
        return not self.is_overridden and all(name in self._wanted for name in self._needed())

    def outputs(self, fix: Fix, t_s: float) -> dict[str, float]:
        """What the three variables become; {} when it does not drive. All zero when something is stale, or no thrust is wanted.

        Args:
            fix: heading, speed through the water, depth and pitch now.
            t_s: simulation time.
        """
        speed, heading, pitch = speed_through_water(fix), heading_of(fix), pitch_of(fix)
        if not self.has_control or speed is None or heading is None or pitch is None:
            return {}
        table = self._table
        names = OUTPUTS if table.depth_control else (THRUST, RUDDER)
        found = dict.fromkeys(names, 0.0)
        oldest = t_s - table.tardy_helm_threshold
        self.stale = ", ".join(name for name, (_, at) in self._wanted.items() if at < oldest and name in self._needed())
        if self.stale:
            return found
        found[THRUST] = self._thrust = self._thrust_for(speed, t_s)
        if self._thrust > 0.0:
            found[RUDDER] = self._yaw.output(turned(self._wanted[HEADING][0] - heading), t_s)
            depth = fix.below
            if table.depth_control and depth is not None:
                found[ELEVATOR] = self._depth.elevator(self._wanted[DEPTH][0], depth, pitch, t_s)
        return found

    def _needed(self) -> tuple[str, ...]:
        return (HEADING, SPEED, DEPTH) if self._table.depth_control else (HEADING, SPEED)

    def _thrust_for(self, speed: float, t_s: float) -> float:
        wanted = self._wanted[SPEED][0]
        thrust = wanted * self._factor if self._factor else self._thrust + self._speed.output(wanted - speed, t_s)
        return min(thrust, self._table.maxthrust) if thrust >= _LEAST_THRUST else 0.0


class DepthHold:
    """Holds a depth while somebody drives and nobody else has a depth in mind.

    Args:
        depth_m: that is held.
        table: gains.

    Attributes:
        is_needed: nobody has written an elevator yet.
    """

    def __init__(self, depth_m: float, table: PidTable) -> None:
        self.is_needed = True
        self._depth_m = depth_m
        self._loops = DepthLoops(table)
        self._driven = -math.inf

    def hear(self, name: str, value: float, t_s: float) -> bool:
        """A variable of an actuator was written. Returns whether it is to be obeyed: an elevator of 0 is what a mission without depth says."""
        if name.startswith(THRUST) or name == RUDDER:  # DESIRED_THRUST_L too; a ballast drives nothing
            self._driven = t_s
        if name != ELEVATOR:
            return True
        if value != 0.0:
            self.is_needed = False
        return not self.is_needed

    def rest(self) -> None:
        """Nobody drives any more."""
        self._driven = -math.inf
        self._loops.reset()

    def reset(self) -> None:
        """Time begins anew, or a community is joined."""
        self.is_needed = True
        self.rest()

    def outputs(self, fix: Fix, t_s: float) -> dict[str, float]:
        """The elevator, {} when it does not hold."""
        depth, pitch = fix.below, pitch_of(fix)
        if not self.is_needed or depth is None or pitch is None or not 0.0 <= t_s - self._driven <= DRIVEN_S:
            return {}
        return {ELEVATOR: self._loops.elevator(self._depth_m, depth, pitch, t_s)}


class Pilot:
    """Both: the autopilot, if there is one, and the depth that is held, if one is.

    Args:
        table: the autopilot's; None for none.
        hold_depth_m: a depth to hold; None for none.

    Attributes:
        drives: variables of actuators that it may write.
        hears: variables that it listens to, besides those.
    """

    def __init__(self, table: PidTable | None, hold_depth_m: float | None) -> None:
        gains = table or PidTable()
        self._autopilot = None if table is None else Autopilot(table)
        # An autopilot that has a depth needs no other.
        has_depth = table is not None and table.depth_control
        self._hold = None if hold_depth_m is None or has_depth else DepthHold(hold_depth_m, gains)
        self.hears = INPUTS if table is not None else ()
        driven = () if table is None else OUTPUTS if has_depth else (THRUST, RUDDER)
        self.drives = (*driven, *(() if self._hold is None else (ELEVATOR,)))

    def hear(self, name: str, value: float, t_s: float) -> None:
        """One of `hears` was written. Raises ValueError."""
        if self._autopilot is not None:
            self._autopilot.hear(name, value, t_s)

    def admits(self, name: str, value: float, t_s: float) -> bool:
        """A variable of an actuator was written by somebody; whether it is to be obeyed. Raises ValueError when our autopilot drives."""
        if self._autopilot is not None and self._autopilot.has_control and name in self.drives:
            raise ValueError(
                f"the autopilot of this adapter writes {name} (table `pid`), until MOOS_MANUAL_OVERRIDE is true"
            )
        return self._hold is None or self._hold.hear(name, value, t_s)

    def override(self, is_on: bool) -> None:
        """Whether a person drives."""
        if self._autopilot is not None:
            self._autopilot.override(is_on)

    def rest(self) -> None:
        """All actuators go to neutral: nobody drives, until somebody writes again."""
        if self._hold is not None:
            self._hold.rest()

    def reset(self) -> None:
        """Time begins anew, or a community is joined."""
        if self._autopilot is not None:
            self._autopilot.reset()
        if self._hold is not None:
            self._hold.reset()

    def outputs(self, fix: Fix, t_s: float) -> dict[str, float]:
        """Values for variables of actuators; {} when it does not drive."""
        found = {} if self._autopilot is None else self._autopilot.outputs(fix, t_s)
        if self._hold is not None:
            if found:
                self._hold.hear(THRUST, found[THRUST], t_s)
            found |= self._hold.outputs(fix, t_s)
        return found

    def report(self) -> list[str]:
        """What people who watch should know."""
        lines = []
        if self._autopilot is not None:
            state = (
                "overridden" if self._autopilot.is_overridden else "drives" if self._autopilot.has_control else "waits"
            )
            lines.append(f"Autopilot: {state}{f', stale: {self._autopilot.stale}' if self._autopilot.stale else ''}")
        if self._hold is not None:
            lines.append(f"Depth hold: {'on' if self._hold.is_needed else 'off, the mission has a depth'}")
        return lines


def _limited(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
