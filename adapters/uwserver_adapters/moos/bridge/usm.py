"""The variables that uSimMarine reads besides DESIRED_*: resets, pause, on and off, water current."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from uwserver.adapter import Conversation
from uwserver.ports import Fault, Port, Reply
from uwserver_adapters.moos.codec import Fix, ResetPose, compass, drift, finite, pose_of, rad, reset_pose

OVERRIDES = ("MOOS_MANUAL_OVERRIDE", "MOOS_MANUAL_OVERIDE")
"""The second is the spelling of old missions."""
MOMENTARY = ("USM_RESET",)
"""Variables that cause something once, when they are written. All others are states, which hold."""

FREE = (*OVERRIDES, "WATER_DEPTH")
"""Variables that cost the world nothing, or must never be refused."""
ENABLED = "USM_ENABLED"
ELSEWHERE = ("NAV_X", "NAV_Y", "NAV_HEADING")
"""Variables by which another simulator moves the vehicle while this one is off."""

Value = float | str
OnFault = Callable[[Fault], None]
"""Gets the fault where the world refuses."""


class UsmInputs:
    """Turns variables into service calls and commands.

    Args:
        peer: sends calls and commands.
        teleport: the actuator for USM_RESET; None where the vehicle has none.
        fix: what is known of the vehicle; WATER_DEPTH is kept there.
        neutral: puts all actuators to neutral.
        override: gets whether a person drives.
        post: publishes a variable.
        listen: asks for writes of further variables.

    Attributes:
        is_enabled: this simulator moves the vehicle. Otherwise it commands nothing and publishes no NAV_*.
        names: variables that mean something here.
    """

    def __init__(
        self,
        peer: Conversation,
        teleport: Port | None,
        fix: Fix,
        neutral: Callable[[], None],
        override: Callable[[bool], None],
        post: Callable[[str, Value], None],
        listen: Callable[[Sequence[str]], None],
    ) -> None:
        self.is_enabled = True
        self._peer = peer
        self._teleport = teleport
        self._fix = fix
        self._neutral = neutral
        self._tell_override = override
        self._post = post
        self._listen = listen
        self._resets = 0
        self._asked: tuple[ResetPose, float] | None = None
        self._elsewhere: dict[str, float] = {}
        self._water = (0.0, 0.0)
        # Name -> the new current, north and east, m/s.
        self._currents: dict[str, Callable[[Value], tuple[float, float]]] = {
            "DRIFT_VECTOR": lambda value: drift(str(value)),
            "DRIFT_VECTOR_ADD": self._added,
            "DRIFT_VECTOR_MULT": lambda value: (self._water[0] * _number(value), self._water[1] * _number(value)),
            **dict.fromkeys(("DRIFT_X", "CURRENT_X"), lambda value: (self._water[0], _number(value))),
            **dict.fromkeys(("DRIFT_Y", "CURRENT_Y"), lambda value: (_number(value), self._water[1])),
        }
        self._actions: dict[str, Callable[[Value, str, OnFault], None]] = {
            "USM_RESET": self._reset,
            "USM_SIM_PAUSED": self._pause,
            ENABLED: self._enable,
            "WATER_DEPTH": self._water_depth,
            **dict.fromkeys(OVERRIDES, self._override),
        }
        self.names = (*self._actions, *self._currents)

    def take(self, name: str, value: Value, source: str, on_fault: OnFault) -> None:
        """Carry out what a variable says.

        Raises:
            ValueError: it cannot be read.
            Refused: the world does not take it.
        """
        if name in self._currents:
            self._flow(self._currents[name](value), source, on_fault)
        else:
            self._actions[name](value, source, on_fault)

    def hear_elsewhere(self, name: str, value: Value) -> None:
        """Keep one of ELSEWHERE, while this simulator is off."""
        if not self.is_enabled:
            self._elsewhere[name] = _number(value)

    def _reset(self, value: Value, source: str, on_fault: OnFault) -> None:
        if not isinstance(value, str):
            raise ValueError(f"{value} is a number: write USM_RESET as a text")
        self._move(reset_pose(value, self._base()), source, on_fault)

    def _base(self) -> ResetPose:
        """Return where the vehicle is, or where it will be after a reset that no position has shown yet."""
        if self._asked is not None and self._fix.t_ns <= self._asked[1]:
            return self._asked[0]
        return pose_of(self._fix)

    def _move(self, pose: ResetPose, source: str, on_fault: OnFault) -> None:
        if self._teleport is None:
            raise ValueError('the vehicle has no actuator of kind "teleport" that could reset it')
        self._neutral()
        before = self._asked

        def on_answer(reply: Reply) -> None:
            is_last = self._asked is not None and self._asked[0] is pose
            if reply.fault is not None:
                self._asked = before if is_last else self._asked
                on_fault(reply.fault)
                return
            if is_last:
                self._asked = (pose, reply.t_ns)
            self._resets += 1
            self._post("USM_RESET_COUNT", float(self._resets))

        self._asked = (pose, math.inf)
        try:
            self._peer.command(self._teleport.path, pose.command(), on_answer, source)
        except BaseException:
            self._asked = before
            raise

    def forget(self) -> None:
        """Start again at another time."""
        self._asked = None

    def _enable(self, value: Value, source: str, on_fault: OnFault) -> None:
        is_on = _flag(value)
        if is_on == self.is_enabled:
            return
        self.is_enabled = is_on
        if not is_on:
            self._neutral()
            self._elsewhere.clear()
            self._listen(ELSEWHERE)
        elif self._elsewhere and self._teleport is not None:
            pose = self._base()
            north, east, down = pose.p_N
            north, east = self._elsewhere.get("NAV_Y", north), self._elsewhere.get("NAV_X", east)
            heading = self._elsewhere.get("NAV_HEADING", compass(pose.yaw))
            self._move(ResetPose((north, east, down), rad(heading), 0.0), source, on_fault)

    def _pause(self, value: Value, source: str, on_fault: OnFault) -> None:
        def on_answer(reply: Reply) -> None:
            if reply.fault is not None:
                on_fault(reply.fault)

        self._peer.call("world/pause" if _flag(value) else "world/resume", {}, on_answer, source=source)

    def _water_depth(self, value: Value, source: str, on_fault: OnFault) -> None:
        depth = _number(value)
        if depth < 0.0:
            raise ValueError(f"{depth:g} is negative: WATER_DEPTH is counted downwards, 0 for not known")
        self._fix.water_depth = depth or None

    def _added(self, value: Value) -> tuple[float, float]:
        north, east = drift(str(value))
        return self._water[0] + north, self._water[1] + east

    def _flow(self, water: tuple[float, float], source: str, on_fault: OnFault) -> None:
        """Set the current: north and east components, m/s."""
        north, east = water

        def on_answer(reply: Reply) -> None:
            if reply.fault is not None:
                on_fault(reply.fault)
                return
            angle = compass(math.atan2(east, north)) if water != (0.0, 0.0) else 0.0
            text = f"ang={angle:.2f}, mag={math.hypot(north, east):.2f}, xmag={east:.3f}, ymag={north:.3f}"
            self._post("USM_DRIFT_SUMMARY", text)

        self._peer.call("world/set_current", {"velocity_N": [*water, 0.0]}, on_answer, source=source)
        self._water = water

    def _override(self, value: Value, source: str, on_fault: OnFault) -> None:
        is_on = _flag(value)
        self._tell_override(is_on)
        if is_on:
            # The autopilot is silent from now on. What it wanted last must not drive the vehicle until the person writes something.
            self._neutral()


def _number(value: Value) -> float:
    return finite(str(value))


def _flag(value: Value) -> bool:
    word = str(value)[:40].strip().lower()
    if word not in ("true", "false"):
        raise ValueError(f'"{word}" is neither true nor false')
    return word == "true"
