"""The autopilot of the adapter, which does what pMarinePID does, and a depth that is held for missions in the plane.

All times are simulation time.
"""

from __future__ import annotations

import math
from collections import deque

from uwserver_adapters.moos.codec import Fix, compass, deg, rad, speed_through_water, turned
from uwserver_adapters.moos.config import PidTable

THRUST, RUDDER, ELEVATOR = "DESIRED_THRUST", "DESIRED_RUDDER", "DESIRED_ELEVATOR"
HEADING, SPEED, DEPTH, FACTOR = "DESIRED_HEADING", "DESIRED_SPEED", "DESIRED_DEPTH", "SPEED_FACTOR"
INPUTS = (HEADING, SPEED, DEPTH, FACTOR)
DRIVEN_S = 2.0
"""Time for which a write of an actuator's variable shows that somebody drives."""
_SLOPES = 9
"""Number of slopes of which a loop takes the mean, as pMarinePID does."""
_LEAST_THRUST = 0.01
"""Thrust (%) below which the vehicle stops."""


class Loop:
    """A PID loop by the rules of pMarinePID: the slope of the error is the mean of the last nine, and integral and output are limited.

    Args:
        kp, ki, kd: gains.
        integral_limit: limit of the integral's part of the output.
        limit: limit of the output.
        is_heading: the error is a difference of headings, degrees, which wraps around.
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
        """Forget all earlier errors."""
        self._slopes.clear()
        self._last: tuple[float, float] | None = None
        self._integral = 0.0

    def output(self, error: float, t_s: float) -> float:
        """Return the output for an error at a time."""
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


def _loop(table: PidTable, name: str, limit: float, is_heading: bool = False) -> Loop:
    """Return the loop with the gains ``<name>_pid_*`` of a table."""
    kp, ki, kd, integral_limit = (getattr(table, f"{name}_pid_{key}") for key in ("kp", "ki", "kd", "integral_limit"))
    return Loop(kp, ki, kd, integral_limit, limit, is_heading)


class DepthLoops:
    """Two loops from depth to elevator: depth to pitch, and pitch to elevator. A positive elevator makes the vehicle dive.

    Args:
        table: gains.
    """

    def __init__(self, table: PidTable) -> None:
        self._depth = _loop(table, "z_to_pitch", rad(table.maxpitch))
        self._pitch = _loop(table, "pitch", rad(table.maxelevator))

    def reset(self) -> None:
        """Forget all earlier errors."""
        self._depth.reset()
        self._pitch.reset()

    def elevator(self, wanted: float, depth: float, pitch: float, t_s: float) -> float:
        """Return the value of DESIRED_ELEVATOR (degrees, where the gains are meant so).

        Args:
            wanted, depth: wanted and present depth, m.
            pitch: rad, nose up.
            t_s: time.
        """
        nose_up = self._depth.output(depth - wanted, t_s)
        return deg(self._pitch.output(pitch - nose_up, t_s))


class Autopilot:
    """Turns heading, speed and depth into rudder, thrust and elevator.

    Args:
        table: gains and limits.

    Attributes:
        is_overridden: a person drives, until MOOS_MANUAL_OVERRIDE says false.
        stale: names of the values that are too old; "" for none.
        drives: variables that it writes.
    """

    def __init__(self, table: PidTable) -> None:
        self.is_overridden = True
        self.stale = ""
        self.drives = (THRUST, RUDDER, ELEVATOR) if table.depth_control else (THRUST, RUDDER)
        self._needed = (HEADING, SPEED, DEPTH) if table.depth_control else (HEADING, SPEED)
        self._table = table
        self._factor = table.speed_factor
        self._wanted: dict[str, tuple[float, float]] = {}
        self._thrust = 0.0
        self._yaw = _loop(table, "yaw", table.maxrudder, is_heading=True)
        self._speed = _loop(table, "speed", table.maxthrust)
        self._depth = DepthLoops(table)

    def hear(self, name: str, value: float, t_s: float) -> None:
        """Take a value of one of INPUTS. Raises ValueError where it is not finite, or a negative factor."""
        if not math.isfinite(value):
            raise ValueError(f"{value} is no finite number")
        if name != FACTOR:
            self._wanted[name] = (value, t_s)
        elif value < 0.0:
            raise ValueError(f"{value} is negative")
        else:
            self._factor = value

    def override(self, is_on: bool) -> None:
        """Let a person take over, or give back. After either, all wanted values must come again."""
        if self.is_overridden != is_on:
            self.is_overridden = is_on
            self.reset()

    def reset(self) -> None:
        """Forget the wanted values and all earlier errors."""
        self._wanted.clear()
        self._thrust, self.stale = 0.0, ""
        for loop in (self._yaw, self._speed, self._depth):
            loop.reset()

    @property
    def has_control(self) -> bool:
        """Whether it drives: nobody overrides it, and all wanted values have come."""
        return not self.is_overridden and all(name in self._wanted for name in self._needed)

    def outputs(self, fix: Fix, t_s: float) -> dict[str, float]:
        """Return the values of the variables that it writes; {} where it does not drive. All are 0 where a value is stale or no thrust is wanted.

        Args:
            fix: the vehicle now.
            t_s: time.
        """
        speed = speed_through_water(fix)
        if not self.has_control or speed is None or fix.rpy is None:
            return {}
        _, pitch, yaw = fix.rpy
        found = dict.fromkeys(self.drives, 0.0)
        oldest = t_s - self._table.tardy_helm_threshold
        self.stale = ", ".join(name for name, (_, at) in self._wanted.items() if at < oldest and name in self._needed)
        if self.stale:
            return found
        found[THRUST] = self._thrust = self._thrust_for(speed, t_s)
        if self._thrust > 0.0:
            found[RUDDER] = self._yaw.output(turned(self._wanted[HEADING][0] - compass(yaw)), t_s)
            depth = fix.below
            if ELEVATOR in found and depth is not None:
                found[ELEVATOR] = self._depth.elevator(self._wanted[DEPTH][0], depth, pitch, t_s)
        return found

    def _thrust_for(self, speed: float, t_s: float) -> float:
        wanted = self._wanted[SPEED][0]
        thrust = wanted * self._factor if self._factor else self._thrust + self._speed.output(wanted - speed, t_s)
        return min(thrust, self._table.maxthrust) if thrust >= _LEAST_THRUST else 0.0


class DepthHold:
    """Holds a depth while somebody drives and the mission itself has no depth.

    Args:
        depth_m: the depth, m.
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
        """Take a write of an actuator's variable. Returns whether it is to be obeyed: a mission without a depth writes an elevator of 0."""
        if name.startswith(THRUST) or name == RUDDER:  # DESIRED_THRUST_L too; a ballast drives nothing
            self._driven = t_s
        if name != ELEVATOR:
            return True
        if value != 0.0:
            self.is_needed = False
        return not self.is_needed

    def rest(self) -> None:
        """Hold nothing until somebody drives again."""
        self._driven = -math.inf
        self._loops.reset()

    def reset(self) -> None:
        """Start again: at another time, or in another community."""
        self.is_needed = True
        self.rest()

    def outputs(self, fix: Fix, t_s: float) -> dict[str, float]:
        """Return the elevator; {} where it does not hold."""
        depth, rpy = fix.below, fix.rpy
        if not self.is_needed or depth is None or rpy is None or not 0.0 <= t_s - self._driven <= DRIVEN_S:
            return {}
        return {ELEVATOR: self._loops.elevator(self._depth_m, depth, rpy[1], t_s)}


class Pilot:
    """The autopilot and the depth hold, where the table asks for them.

    Args:
        table: table of the autopilot; None for none.
        hold_depth_m: depth to hold, m; None for none. An autopilot with a depth needs no depth hold.

    Attributes:
        drives: variables of actuators that it may write.
        hears: variables that it reads besides those.
    """

    def __init__(self, table: PidTable | None, hold_depth_m: float | None) -> None:
        self._autopilot = None if table is None else Autopilot(table)
        self._hold: DepthHold | None = None
        self.hears = () if table is None else INPUTS
        self.drives = () if self._autopilot is None else self._autopilot.drives
        if hold_depth_m is not None and ELEVATOR not in self.drives:
            self._hold = DepthHold(hold_depth_m, table or PidTable())
            self.drives = (*self.drives, ELEVATOR)

    def hear(self, name: str, value: float, t_s: float) -> None:
        """Take a value of one of `hears`. Raises ValueError."""
        if self._autopilot is not None:
            self._autopilot.hear(name, value, t_s)

    def admits(self, name: str, value: float, t_s: float) -> bool:
        """Return whether a write of an actuator's variable by somebody else is to be obeyed. Raises ValueError while the autopilot drives."""
        if self._autopilot is not None and self._autopilot.has_control and name in self.drives:
            raise ValueError(
                f"the autopilot of this adapter writes {name} (table `pid`), until MOOS_MANUAL_OVERRIDE is true"
            )
        return self._hold is None or self._hold.hear(name, value, t_s)

    def override(self, is_on: bool) -> None:
        """Let a person take over, or give back."""
        if self._autopilot is not None:
            self._autopilot.override(is_on)

    def rest(self) -> None:
        """Hold no depth until somebody drives again: all actuators go to neutral."""
        if self._hold is not None:
            self._hold.rest()

    def reset(self) -> None:
        """Start again: at another time, or in another community."""
        for part in (self._autopilot, self._hold):
            if part is not None:
                part.reset()

    def outputs(self, fix: Fix, t_s: float) -> dict[str, float]:
        """Return values for variables of actuators; {} where it does not drive."""
        found = {} if self._autopilot is None else self._autopilot.outputs(fix, t_s)
        if self._hold is not None:
            if found:
                self._hold.hear(THRUST, found[THRUST], t_s)
            found |= self._hold.outputs(fix, t_s)
        return found

    def report(self) -> list[str]:
        """Return lines for people who watch a mission."""
        lines = []
        autopilot = self._autopilot
        if autopilot is not None:
            state = "overridden" if autopilot.is_overridden else "drives" if autopilot.has_control else "waits"
            lines.append(f"Autopilot: {state}{f', stale: {autopilot.stale}' if autopilot.stale else ''}")
        if self._hold is not None:
            lines.append(f"Depth hold: {'on' if self._hold.is_needed else 'off, the mission has a depth'}")
        return lines


def _limited(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
