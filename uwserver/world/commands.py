"""Commands on their way to the actuators: who commands, who disagrees, and who has fallen silent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, ClassVar

from uwserver.ports import Command, Field, Refused
from uwserver.ports.checks import check_given
from uwserver.world.components import ActuatorSlot
from uwserver.world.part import Part, Stage, State

CONFLICT_WINDOW_S = 1.0
"""Two sources that command one actuator within this simulation time are in conflict."""


class Commands(Part):
    """Commands and watchdogs of all actuators of a world; `next_tick` is when a watchdog may expire. What it knows stands in the slots."""

    path = "world/commands"
    state_type = State
    stage: ClassVar[Stage] = Stage.WATCHDOGS

    def __init__(
        self, actuators: Mapping[str, ActuatorSlot], rate_hz: Fraction, say: Callable[[str, str], None]
    ) -> None:
        """Of a world whose actuators may come and go.

        Args:
            actuators, rate_hz: of the world.
            say: tells an event and its text to all clients.
        """
        self._actuators = actuators
        self._say = say
        self._window = round(CONFLICT_WINDOW_S * rate_hz)
        self._newest: dict[str, Command] = {}

    def accept(self, command: Command, tick: int, fields: tuple[Field, ...] = ()) -> bool:
        """Take a command over; of several to one actuator before the next `apply` only the last can act,
        but for one that takes each. `fields` are those against which it was checked.

        Returns:
            Whether somebody else commands that actuator too.

        Raises:
            Refused: the actuator is gone, deactivated, held by the autopilot, or another one than the command was checked for.
        """
        path = command.port
        slot = self._actuators.get(path)
        if slot is None:
            raise Refused("unknown_port", f'"{path}" is gone', path)
        if not slot.active:
            raise Refused("denied", f'"{path}" is deactivated: call {path}/activate first', path)
        if slot.refusal:
            raise Refused("denied", f'"{path}" {slot.refusal}', path)
        if fields is not slot.port.fields:  # a body of another kind may have come under the name since
            try:
                check_given(slot.port.fields, command.value)
            except ValueError as error:
                text = f'"{path}" is another actuator than when this was sent ({error}); "describe" lists its fields'
                raise Refused("bad_argument", text, path) from None
        if slot.takes_each and path in self._newest:
            slot.actuator.apply(self._newest.pop(path).value)
        objection = slot.objection(command.value)
        if objection is not None:
            raise Refused(objection.code, f'"{path}" {objection.text}', path)
        conflict = False
        if slot.source and slot.source != command.source and not slot.takes_each:
            conflict = tick - slot.last_tick <= self._window
            if conflict and tick - slot.other_tick > self._window:
                self._say(
                    "conflict", f'"{path}" is commanded by {slot.source} and {command.source}: the last command wins'
                )
            if conflict:
                slot.conflicts += 1
                slot.other_tick = tick
        slot.source, slot.last_tick = command.source, tick
        # In the order of the last ones: of set points of an autopilot, each a port of its own, the last one counts as it does between two ticks.
        self._newest.pop(path, None)
        self._newest[path] = command
        return conflict

    def apply(self, tick: int) -> None:
        """Hand what was accepted to the actuators; an actuator that a call removed meanwhile gets nothing."""
        for port, command in self._newest.items():
            slot = self._actuators.get(port)
            if slot is None:
                continue
            slot.actuator.apply(command.value)
            slot.last_value = command.value
            if slot.timeout_ticks:
                expires = tick + slot.timeout_ticks
                self.next_tick = expires if self.next_tick is None else min(self.next_tick, expires)
        self._newest.clear()

    def newest(self, vehicle: str) -> list[str]:
        """The last command to each actuator of a vehicle, in words."""
        return [
            f"last command to {path} in tick {slot.last_tick} by {slot.source}: {slot.last_value}"
            for path, slot in self._actuators.items()
            if path.startswith(f"{vehicle}/") and slot.last_tick >= 0
        ]

    def save(self) -> State:
        """Nothing: commands that are accepted are applied in the same tick."""
        return State()

    def load(self, state: Any) -> None:
        """Look at all watchdogs anew."""
        self.next_tick = -1

    def before(self, tick: int, t_ns: int) -> None:
        """Let the actuators go to neutral that were left without a command for too long."""
        following: int | None = None
        for slot in self._actuators.values():
            if not slot.timeout_ticks or not slot.last_value:
                continue
            expires = slot.last_tick + slot.timeout_ticks
            if expires <= tick:
                slot.actuator.neutral()
                slot.last_value = ()
                slot.timeouts += 1
                self._say(
                    "watchdog", f'no command for "{slot.port.path}" in {slot.port.timeout_s:g} s: it went to neutral'
                )
            else:
                following = expires if following is None else min(following, expires)
        self.next_tick = following
