"""The slots of actuators, and their commands: which source commands, which sources disagree, and which actuators have had no command for too long."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any, ClassVar

from msgspec import Meta, Struct, structs

from uwserver.actuators import Actuator
from uwserver.ports import Command, Fault, Field, Items, Port, Refused
from uwserver.ports.checks import check_given
from uwserver.world.parts.part import Count, Part, Stage, State, Stateless, read_record, record

NEVER = -(10**18)
"""A tick before all others."""
Tick = Annotated[int, Meta(ge=NEVER, le=2**62)]
CONFLICT_WINDOW_S = 1.0
"""Two sources that command the same actuator within this simulation time are in conflict."""


class CommandHistory(Struct, frozen=True):
    """Which source commanded an actuator, when another source did so, and how many conflicts and time-outs there were."""

    source: Annotated[str, Meta(max_length=4096)] = ""
    other_tick: Tick = NEVER
    conflicts: Count = 0
    timeouts: Count = 0


class ActuatorState(State, frozen=True):
    """The state of one actuator's slot. The state of the device is in the arrays of the bodies, or in `memory`."""

    active: bool
    timeout_ticks: Count
    last_tick: Tick
    last_value: Items
    memory: bytes
    sources: CommandHistory

    def deciding(self) -> ActuatorState:
        """Leave the sources out: they do not change the run."""
        return structs.replace(self, sources=CommandHistory())


@dataclass(slots=True, eq=False)
class ActuatorSlot(Part):
    """An actuator in the world: its last command, the source of that command, and its watchdog.

    Attributes:
        timeout_ticks: ticks without a command after which the actuator goes to neutral; 0 for never.
        last_tick, last_value, source: those of the last command.
        other_tick: last tick in which two sources were in conflict.
        refusal: why the actuator takes no commands at present; "" if it does.
    """

    state_type = ActuatorState

    port: Port
    actuator: Actuator
    rate_hz: Fraction
    timeout_ticks: int
    active: bool = True
    last_tick: int = -1
    last_value: Items = ()
    source: str = ""
    other_tick: int = NEVER
    conflicts: int = 0
    timeouts: int = 0
    refusal: str = ""

    @property
    def path(self) -> str:
        """Path of the port."""
        return self.port.path

    @property
    def takes_each(self) -> bool:
        """Whether every command counts, as for a modem: no command replaces another, and two sources are not in conflict."""
        return bool(getattr(self.actuator, "takes_each", False))

    def objection(self, value: Items) -> Fault | None:
        """Return why the device refuses a value that its fields allow; None if it does not refuse. Changes nothing."""
        object_to: Callable[[Items], Fault | None] | None = getattr(self.actuator, "objection", None)
        return None if object_to is None else object_to(value)

    def set_timeout(self, ticks: int) -> None:
        """Set the time-out of the watchdog; 0 ticks for none."""
        self.timeout_ticks = ticks
        self.port = structs.replace(self.port, timeout_s=float(ticks / self.rate_hz) or None)

    def save(self) -> ActuatorState:
        """Return the state of the slot."""
        memory = getattr(self.actuator, "memory", None)
        return ActuatorState(
            self.active,
            self.timeout_ticks,
            self.last_tick,
            self.last_value,
            b"" if memory is None else record(memory),
            CommandHistory(self.source, self.other_tick, self.conflicts, self.timeouts),
        )

    def check(self, state: Any) -> None:
        """Raise ValueError if the state is not of this actuator: another kind of memory, or a last command that does not fit the fields."""
        memory = getattr(self.actuator, "memory", None)
        if memory is not None:
            read_record(state.memory, memory)
        elif state.memory:
            raise ValueError("it has a memory, and this actuator has none")
        if state.last_value:
            check_given(self.port.fields, state.last_value)

    def load(self, state: ActuatorState) -> None:
        """Take over a checked state."""
        self.active, self.last_tick, self.last_value = state.active, state.last_tick, state.last_value
        if state.timeout_ticks != self.timeout_ticks:
            self.set_timeout(state.timeout_ticks)
        memory = getattr(self.actuator, "memory", None)
        if memory is not None:
            self.actuator.memory = read_record(state.memory, memory)  # type: ignore[attr-defined]  # those that remember
        by = state.sources
        self.source, self.other_tick = by.source, by.other_tick
        self.conflicts, self.timeouts = by.conflicts, by.timeouts


class Commands(Stateless):
    """The commands and watchdogs of all actuators of a world. Its state stands in the slots of the actuators; `next_tick` is when a
    watchdog may expire."""

    path = "world/commands"
    stage: ClassVar[Stage] = Stage.WATCHDOGS

    def __init__(
        self, actuators: Mapping[str, ActuatorSlot], rate_hz: Fraction, say: Callable[[str, str], None]
    ) -> None:
        """Begin without commands.

        Args:
            actuators: slots of the world by path; the mapping may change later.
            rate_hz: ticks per second.
            say: sends an event with a text to all clients.
        """
        self._actuators = actuators
        self._say = say
        self._window = round(CONFLICT_WINDOW_S * rate_hz)
        self._newest: dict[str, Command] = {}

    def accept(self, command: Command, tick: int, fields: tuple[Field, ...] = ()) -> bool:
        """Accept a command. It acts at the next `apply`. If several commands for one actuator come before that, only the last one acts,
        unless the actuator takes each command.

        Args:
            command: checked against the fields of a port.
            tick: the present tick.
            fields: the fields against which the command was checked.

        Returns:
            Whether another source commands the same actuator at present.

        Raises:
            Refused: the actuator is gone, is deactivated, is held by the autopilot, has been replaced by another one that takes no such
                command, or refuses the value.
        """
        path = command.port
        slot = self._actuators.get(path)
        if slot is None:
            raise Refused("unknown_port", f'"{path}" is gone', path)
        if not slot.active:
            raise Refused("denied", f'"{path}" is deactivated: call {path}/activate first', path)
        if slot.refusal:
            raise Refused("denied", f'"{path}" {slot.refusal}', path)
        if fields is not slot.port.fields:  # Another body may have come under this name since the check.
            try:
                check_given(slot.port.fields, command.value)
            except ValueError as error:
                text = f'"{path}" was replaced by another actuator after this was sent ({error}); "describe" lists its fields'
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
        # Moved to the end: each set point of an autopilot has its own port, and the newest command has to act last, as it would in separate
        # ticks.
        self._newest.pop(path, None)
        self._newest[path] = command
        return conflict

    def apply(self, tick: int) -> None:
        """Give the accepted commands to their actuators. Commands to an actuator that a call has removed meanwhile are dropped."""
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
        """Return the last command to each actuator of a vehicle as text, for an error report."""
        return [
            f"last command to {path} in tick {slot.last_tick} by {slot.source}: {slot.last_value}"
            for path, slot in self._actuators.items()
            if path.startswith(f"{vehicle}/") and slot.last_tick >= 0
        ]

    def load(self, state: Any) -> None:
        """Check all watchdogs in the next tick, as the slots have other states."""
        self.next_tick = -1

    def before(self, tick: int, t_ns: int) -> None:
        """Set actuators to neutral that had no command for longer than their time-out."""
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
