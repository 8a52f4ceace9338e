"""What an actuator is: it turns a checked command into rows of the kernel's arrays, and knows its neutral."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol

from msgspec import Meta

from uwserver.physics.bodies import Hydrodynamics
from uwserver.ports import Field
from uwserver.table import Table

Given = tuple[tuple[float, ...] | None, ...]
"""A checked command to an actuator that takes numbers alone: a tuple of floats per field, None where the sender left the field out."""

LONGEST_TIMEOUT_S = 1e6
Timeout = Annotated[float, Meta(ge=0, le=LONGEST_TIMEOUT_S)]


class Devices(NamedTuple):
    """The parts of its vehicle that an actuator commands.

    Attributes:
        table: of the vehicle file: thrusters, fins, propellers, ballasts, moving_masses, lamps or mounts.
        noun: what one of them is called.
        field: of the command.
        members: their names; none for all that there are.
        is_vector: one command is of all members, which its key `members` names; else of one.
        key: that names the one.
    """

    table: str
    noun: str
    field: str
    members: tuple[str, ...]
    is_vector: bool = False
    key: str = "member"


class ActuatorTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """What the table of any actuator may hold; each has ``build(body) -> Actuator``.

    Attributes:
        timeout_s: without a command for this long (simulation time) the actuator goes to neutral and says so; 0 for never.
        enabled: False takes the actuator out.

    A kind may also set:
        message: plain name of the standard message that its fields fit ("Wrench"), which belongs to no middleware; "" for none.
        own_wrench: it may hold a force and a moment (`Body.push`) that nobody else replaces.
    """

    message: ClassVar[str] = ""
    own_wrench: ClassVar[bool] = True
    timeout_s: Timeout = 1.0
    enabled: bool = True

    def devices(self) -> Devices | None:
        """The parts of its vehicle that it commands; None for none."""
        return None

    def nudge(self, mass_kg: float) -> str:
        """The arguments of `uwclient send` that visibly move a vehicle of this mass; "" where it commands parts, or where nobody knows."""
        return ""


class Body:
    """The rows that an actuator of one vehicle may write.

    Attributes:
        hydro: arrays of the world.
        row: the vehicle's body row.
        thrusters: thruster rows by name.
        wrench: a wrench row: the vehicle's, or one of its own for an actuator of a kind with `own_wrench`.
        servos: servo rows by table and name (``fins.rudder``).
        lamps: names of its lamps.
        tilts: mounts that tilt: lowest and highest angle (rad), and how fast (rad/s), by name.
    """

    def __init__(
        self,
        hydro: Hydrodynamics,
        row: int,
        thrusters: Mapping[str, int],
        wrench: int,
        servos: Mapping[str, int] | None = None,
        lamps: tuple[str, ...] = (),
        tilts: Mapping[str, tuple[float, float, float]] | None = None,
    ) -> None:
        self.hydro = hydro
        self.row = row
        self.thrusters = thrusters
        self.wrench = wrench
        self.servos = servos or {}
        self.lamps = lamps
        self.tilts = tilts or {}

    def push(self, force: Sequence[float], moment: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Hold a force (N) and a moment (N m) about the body origin, in B, from now on; each replaces the last."""
        self.hydro.wrenches["bias"][self.wrench] = (*force, *moment)


class Actuator(Protocol):
    """One actuator; runs on the simulation thread.

    Its state lies in the kernel's arrays, which `Body` gives it. One that remembers more has an attribute `memory`, a msgspec Struct of plain
    typed values, and nothing beside it: it is saved with the world, and another of its type is put in its place when the world is restored.
    One of which every command counts, not the last alone, has `takes_each = True`.
    One that cannot take all that its fields allow has a method `objection(value) -> Fault | None`: its code is the reason as programs read it,
    its text goes on where the name of the port stands before it.
    """

    @property
    def fields(self) -> tuple[Field, ...]:
        """What a value tuple holds, in order."""

    @property
    def doc(self) -> str:
        """One or two sentences for the port."""

    def apply(self, value: tuple[Any, ...]) -> None:
        """Carry out a checked command: for each field what its type says (`uwserver.ports.Item`), None where it was left out."""

    def neutral(self) -> None:
        """Go to the safe state."""
