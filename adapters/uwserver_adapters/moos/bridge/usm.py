"""What uSimMarine listens to besides the DESIRED_ variables: resets, pause, water current."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.adapter import Conversation
from uwserver.ports import Fault, Port, Reply
from uwserver_adapters.moos.codec import Fix, drift, finite, reset_pose

OVERRIDES = ("MOOS_MANUAL_OVERRIDE", "MOOS_MANUAL_OVERIDE")
"""The second is the spelling of old missions."""
MOMENTARY = ("USM_RESET",)
"""What happens once, when it is written; the others are states, which hold."""

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
        post: publishes a variable.
    """

    def __init__(
        self,
        peer: Conversation,
        teleport: Port | None,
        fix: Fix,
        neutral: Callable[[], None],
        post: Callable[[str, Value], None],
    ) -> None:
        self._peer = peer
        self._teleport = teleport
        self._fix = fix
        self._neutral = neutral
        self._post = post
        self._resets = 0
        self._water = (0.0, 0.0)
        self._actions: dict[str, Callable[[Value, str, OnFault], None]] = {
            "USM_RESET": self._reset,
            "USM_SIM_PAUSED": self._pause,
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

    def _reset(self, value: Value, source: str, told: OnFault) -> None:
        if self._teleport is None:
            raise ValueError('the vehicle has no actuator of kind "teleport" that could reset it')
        pose = reset_pose(str(value), self._fix)
        self._neutral()

        def on_answer(reply: Reply) -> None:
            if reply.fault is not None:
                told(reply.fault)
                return
            self._resets += 1
            self._post("USM_RESET_COUNT", float(self._resets))

        self._peer.command(self._teleport.path, pose, on_answer, source)

    def _pause(self, value: Value, source: str, told: OnFault) -> None:
        self._call("world/pause" if _flag(value) else "world/resume", {}, source, told)

    def _water_depth(self, value: Value, source: str, told: OnFault) -> None:
        self._fix.water_depth = _number(value)

    def _add(self, value: Value, source: str, told: OnFault) -> None:
        north, east = drift(str(value))
        self._flow((self._water[0] + north, self._water[1] + east), source, told)

    def _multiply(self, value: Value, source: str, told: OnFault) -> None:
        factor = _number(value)
        self._flow((self._water[0] * factor, self._water[1] * factor), source, told)

    def _flow(self, water: tuple[float, float], source: str, told: OnFault) -> None:
        """Set the current: north and east components, m/s."""
        self._call("world/set_current", {"velocity_N": [*water, 0.0]}, source, told)
        self._water = water

    def _override(self, value: Value, source: str, told: OnFault) -> None:
        # The autopilot falls silent now; what it asked for last must not drive on until a person posts something.
        if _flag(value):
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
