"""The contract of an actuator: it writes checked commands into rows of the kernel's arrays, and can return to neutral."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol

from msgspec import Meta

from uwserver.physics.bodies import Hydrodynamics
from uwserver.ports import Field
from uwserver.table import Table

Given = tuple[tuple[float, ...] | None, ...]
"""A checked command to an actuator whose fields are all numbers: a tuple of floats for each field, or None for a field that was left out."""

LONGEST_TIMEOUT_S = 1e6
Timeout = Annotated[float, Meta(ge=0, le=LONGEST_TIMEOUT_S)]


class Devices(NamedTuple):
    """The parts of a vehicle that an actuator commands.

    Attributes:
        table: table of the vehicle file: thrusters, fins, propellers, ballasts, moving_masses, lamps or mounts.
        noun: word for one part, as in "fin".
        field: name of the field of the command.
        members: names of the parts; () for all in the table.
        is_vector: whether a command has one component for each part. Otherwise the actuator commands a single part.
        key: key of the actuator's table that names this single part.
    """

    table: str
    noun: str
    field: str
    members: tuple[str, ...]
    is_vector: bool = False
    key: str = "member"


class ActuatorTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """Base of the tables of actuators. Each table has ``build(body) -> Actuator``.

    Attributes:
        timeout_s: simulation time without a command after which the actuator goes to neutral and reports it; 0 for never.
        enabled: False leaves the actuator out.

    A kind may also set:
        message: plain name of the standard message that its fields fit ("Wrench"); "" for none.
        own_wrench: whether it has a force and a moment of its own (`Body.push`), which no other actuator replaces.
    """

    message: ClassVar[str] = ""
    own_wrench: ClassVar[bool] = True
    timeout_s: Timeout = 1.0
    enabled: bool = True

    def devices(self) -> Devices | None:
        """Return the parts of the vehicle that the actuator commands; None if it commands none."""
        return None

    def nudge(self, mass_kg: float) -> str:
        """Return arguments for `uwclient send` that visibly move a vehicle of this mass; "" if the kind has none or commands parts."""
        return ""


class Body:
    """The rows that the actuators of one vehicle may write.

    Attributes:
        hydro: arrays of the world.
        row: the vehicle's body row.
        thrusters: thruster rows by name.
        wrench: a wrench row: that of the vehicle, or a separate one for an actuator of a kind with `own_wrench`.
        servos: servo rows by table and name (``fins.rudder``).
        lamps: names of its lamps.
        tilts: mounts that tilt, by name: lowest and highest angle (rad), and rate (rad/s).
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
        self.hydro, self.row, self.wrench = hydro, row, wrench
        self.thrusters, self.servos, self.lamps, self.tilts = thrusters, servos or {}, lamps, tilts or {}

    def push(self, force: Sequence[float], moment: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Apply a force (N) and a moment (N m) about the body origin, in B, from now on. They replace those of the last call."""
        self.hydro.wrenches["bias"][self.wrench] = (*force, *moment)


def check_members(noun: str, members: Sequence[str], present: Collection[str]) -> None:
    """Raise ValueError if the vehicle lacks one of the members; the text lists those that it has. `noun` says what a member is: "fin"."""
    for member in members:
        if member not in present:
            raise ValueError(f'no {noun} "{member}" here, there are: {", ".join(present) or "none"}')


class Actuator(Protocol):
    """One actuator. Its methods run on the simulation thread.

    Its state is in the kernel's arrays, which `Body` gives it. An actuator that remembers more has an attribute `memory`: a msgspec Struct of plain
    typed values, and no other state. The memory is saved with the world, and replaced by another one of its type when the world is restored.

    An actuator for which every command counts, and not only the last one, has `takes_each = True`.

    An actuator that cannot take all values that its fields allow has a method `objection(value) -> Fault | None`. The code of the fault is the
    reason for programs; its text continues a sentence that begins with the name of the port.
    """

    @property
    def fields(self) -> tuple[Field, ...]:
        """The fields of a command, in order."""

    @property
    def doc(self) -> str:
        """One or two sentences for the port."""

    def apply(self, value: tuple[Any, ...]) -> None:
        """Carry out a checked command: a value of the type of each field (`uwserver.ports.Item`), or None for a field that was left out."""

    def neutral(self) -> None:
        """Go to the safe state."""
