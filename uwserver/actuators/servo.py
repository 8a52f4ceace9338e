"""Set points of the vehicle's servos: fins, propellers, ballasts and moving masses. The law of a servo runs in the kernel.

The tables of fins are in `fin`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from uwserver.actuators.base import ActuatorTable, Body, Devices, Given, check_members
from uwserver.ports import Field
from uwserver.table import Name


class Moved(NamedTuple):
    """What servos of one kind move.

    Attributes:
        table: of the vehicle file (``fins``).
        noun: name of one of them ("fin").
        field, unit, doc: of the command.
    """

    table: str
    noun: str
    field: str
    unit: str
    doc: str


class OneServo(ActuatorTable, kw_only=True, frozen=True):
    """The table of an actuator that commands one servo.

    Attributes:
        member: its name.
    """

    own_wrench = False
    moved: ClassVar[Moved]
    member: Name

    def devices(self) -> Devices:
        """The servo."""
        return Devices(self.moved.table, self.moved.noun, self.moved.field, (self.member,))

    def build(self, body: Body) -> Servos:
        """Return the actuator.

        Raises:
            ValueError: the vehicle lacks the member; the text lists those that it has.
        """
        return Servos(body, self.moved, (self.member,))


class PropellerConfig(OneServo, tag="propeller", kw_only=True, frozen=True):
    """One shaft propeller of the vehicle file. The command is the speed of its shaft, which it reaches at its own rate."""

    moved = Moved("propellers", "propeller", "speed_radps", "rad/s", "speed of the shaft, positive ahead")


class BallastConfig(OneServo, tag="ballast", kw_only=True, frozen=True):
    """One ballast tank or oil bladder of the vehicle file. The command is its volume, which its pump reaches at its own rate. The watchdog pumps back
    to neutral."""

    moved = Moved("ballasts", "ballast", "volume_m3", "m^3", "oil in the bladder, or water in the tank")


class MovingMassConfig(OneServo, tag="moving_mass", kw_only=True, frozen=True):
    """One mass of the vehicle file that slides along an axis to trim the vehicle. The command is its position along the axis."""

    moved = Moved(
        "moving_masses", "moving mass", "position_m", "m",
        "position along the axis, 0 where the centre of mass of the vehicle file holds",
    )  # fmt: skip


class Servos:
    """Writes set points into servo rows.

    Attributes:
        rows: of the members.
    """

    def __init__(self, body: Body, moved: Moved, members: Sequence[str] | None, *, is_vector: bool = False) -> None:
        """Find the rows of the members.

        Args:
            body: of the vehicle.
            moved: what the servos move.
            members: names in the table of `moved`; None for all in it.
            is_vector: whether the command is a vector; otherwise it is one number for the only member.

        Raises:
            ValueError: the vehicle lacks a member; the text lists those that it has.
        """
        table, noun, name, unit, doc = moved
        prefix = f"{table}."
        present = {path.removeprefix(prefix): row for path, row in body.servos.items() if path.startswith(prefix)}
        members = tuple(present) if members is None else members
        check_members(noun, members, present)
        self._hydro = body.hydro
        self.rows = [present[member] for member in members]
        rows = body.hydro.servos[self.rows]
        self._neutral = rows["command"].tolist()
        order = ", ".join(members)
        shape: tuple[int, ...] = ()
        self.doc = f"{noun.capitalize()} {order}."
        if is_vector:
            doc, shape = f"{doc}, order: {order}", (len(members),)
            self.doc = f"{noun.capitalize()}s {order}."
        low, high = float(rows["low"].min()), float(rows["high"].max())
        self.fields = (Field(name, unit, doc, "", shape, minimum=low, maximum=high),)

    def apply(self, value: Given) -> None:
        """Hold the set point. The kernel keeps each servo within its own limits."""
        (command,) = value
        if command is not None:
            self._hydro.servos["command"][self.rows] = command

    def neutral(self) -> None:
        """Return to the neutral of the vehicle file."""
        self._hydro.servos["command"][self.rows] = self._neutral
