"""What uSimMarine listens to besides the DESIRED_ variables: resets, pause, off and on, water current."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from uwserver.adapter import Conversation
from uwserver.ports import Fault, Port, Reply
from uwserver_adapters.moos.codec import Fix, ResetPose, angle_of, compass, drift, finite, pose_of, reset_pose

OVERRIDES = ("MOOS_MANUAL_OVERRIDE", "MOOS_MANUAL_OVERIDE")
"""The second is the spelling of old missions."""
MOMENTARY = ("USM_RESET",)
"""What happens once, when it is written; the others are states, which hold."""

FREE = (*OVERRIDES, "WATER_DEPTH")
"""What costs the world nothing, or must never be refused."""
ENABLED = "USM_ENABLED"
ELSEWHERE = ("NAV_X", "NAV_Y", "NAV_HEADING")
"""What another simulator says while this one is off."""

Value = float | str
OnFault = Callable[[Fault], None]
"""Told when the world refuses."""


class UsmInputs:
    """Variable to service or command.

    Args:
        peer: through which they go.
        teleport: the actuator for USM_RESET; None when the vehicle has none.
        fix: what is known of the vehicle; WATER_DEPTH is kept there.
        neutral: puts all actuators to neutral.
        override: told whether a person drives.
        post: publishes a variable.
        listen: asks for writes of variables that mean something only now.

    Attributes:
        is_enabled: this simulator moves the vehicle; else it commands nothing and tells no NAV_*.
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
        self._told_override = override
        self._post = post
        self._listen = listen
        self._resets = 0
        self._asked: tuple[ResetPose, float] | None = None
        self._elsewhere: dict[str, float] = {}
        self._water = (0.0, 0.0)
        self._actions: dict[str, Callable[[Value, str, OnFault], None]] = {
            "USM_RESET": self._reset,
            "USM_SIM_PAUSED": self._pause,
            ENABLED: self._enable,
            "WATER_DEPTH": self._water_depth,
            "DRIFT_VECTOR": lambda value, source, told: self._flow(drift(str(value)), source, told),
            "DRIFT_VECTOR_ADD": self._add,
            "DRIFT_VECTOR_MULT": self._multiply,
        }
        for name in ("DRIFT_X", "CURRENT_X"):
            self._actions[name] = lambda value, source, told: self._flow((self._water[0], _number(value)), source, told)
        for name in ("DRIFT_Y", "CURRENT_Y"):
            self._actions[name] = lambda value, source, told: self._flow((_number(value), self._water[1]), source, told)
        for name in OVERRIDES:
            self._actions[name] = self._override

    @property
    def names(self) -> tuple[str, ...]:
        """Variables that it listens to."""
        return tuple(self._actions)

    def take(self, name: str, value: Value, source: str, on_fault: OnFault) -> None:
        """Carry out what a variable says.

        Raises:
            ValueError: it cannot be read.
            Refused: the world does not take it.
        """
        self._actions[name](value, source, on_fault)

    def hear_elsewhere(self, name: str, value: Value) -> None:
        """One of ELSEWHERE, while this simulator is off."""
        if not self.is_enabled:
            self._elsewhere[name] = _number(value)

    def _reset(self, value: Value, source: str, told: OnFault) -> None:
        if not isinstance(value, str):
            raise ValueError(f"{value} is a number: write USM_RESET as a text")
        self._move(reset_pose(value, self._base()), source, told)

    def _base(self) -> ResetPose:
        """Where the vehicle is, or will be by a reset of which no position has told yet."""
        if self._asked is not None and self._fix.t_ns <= self._asked[1]:
            return self._asked[0]
        return pose_of(self._fix)

    def _move(self, pose: ResetPose, source: str, told: OnFault) -> None:
        if self._teleport is None:
            raise ValueError('the vehicle has no actuator of kind "teleport" that could reset it')
        self._neutral()
        before = self._asked

        def on_answer(reply: Reply) -> None:
            is_last = self._asked is not None and self._asked[0] is pose
            if reply.fault is not None:
                self._asked = before if is_last else self._asked
                told(reply.fault)
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
        """Time begins anew."""
        self._asked = None

    def _enable(self, value: Value, source: str, told: OnFault) -> None:
        is_on = _flag(value)
        if is_on == self.is_enabled:
            return
        if not is_on:
            self._neutral()
            self.is_enabled = False
            self._elsewhere.clear()
            self._listen(ELSEWHERE)
            return
        self.is_enabled = True
        if self._elsewhere and self._teleport is not None:
            pose = self._base()
            north, east, down = pose.p_N
            north, east = self._elsewhere.get("NAV_Y", north), self._elsewhere.get("NAV_X", east)
            heading = self._elsewhere.get("NAV_HEADING", compass(pose.yaw))
            self._move(ResetPose((north, east, down), angle_of(heading), 0.0), source, told)

    def _pause(self, value: Value, source: str, told: OnFault) -> None:
        self._call("world/pause" if _flag(value) else "world/resume", {}, source, told)

    def _water_depth(self, value: Value, source: str, told: OnFault) -> None:
        depth = _number(value)
        if depth < 0.0:
            raise ValueError(f"{depth:g} is negative: WATER_DEPTH is counted downwards, 0 for not known")
        self._fix.water_depth = depth or None

    def _add(self, value: Value, source: str, told: OnFault) -> None:
        north, east = drift(str(value))
        self._flow((self._water[0] + north, self._water[1] + east), source, told)

    def _multiply(self, value: Value, source: str, told: OnFault) -> None:
        factor = _number(value)
        self._flow((self._water[0] * factor, self._water[1] * factor), source, told)

    def _flow(self, water: tuple[float, float], source: str, told: OnFault) -> None:
        """Set the current: north and east components, m/s."""
        north, east = water

        def on_answer(reply: Reply) -> None:
            if reply.fault is not None:
                told(reply.fault)
                return
            angle = compass(math.atan2(east, north)) if water != (0.0, 0.0) else 0.0
            text = f"ang={angle:.2f}, mag={math.hypot(north, east):.2f}, xmag={east:.3f}, ymag={north:.3f}"
            self._post("USM_DRIFT_SUMMARY", text)

        self._peer.call("world/set_current", {"velocity_N": [*water, 0.0]}, on_answer, source=source)
        self._water = water

    def _override(self, value: Value, source: str, told: OnFault) -> None:
        # The autopilot falls silent now; what it asked for last must not drive on until a person posts something.
        is_on = _flag(value)
        self._told_override(is_on)
        if is_on:
            self._neutral()

    def _call(self, service: str, args: dict[str, object], source: str, told: OnFault) -> None:
        def on_answer(reply: Reply) -> None:
            if reply.fault is not None:
                told(reply.fault)

        self._peer.call(service, args, on_answer, source=source)


def _number(value: Value) -> float:
    return finite(str(value))


def _flag(value: Value) -> bool:
    word = str(value)[:40].strip().lower()
    if word not in ("true", "false"):
        raise ValueError(f'"{word}" is neither true nor false')
    return word == "true"
