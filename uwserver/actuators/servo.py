"""What fins, shafts, pumps and sliding masses share as actuators: a set point for servos of the vehicle, whose law runs in the kernel."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from uwserver.actuators.base import ActuatorTable, Body, Devices, Given
from uwserver.ports import Field
from uwserver.table import Name


class Moved(NamedTuple):
    """What servos of one kind move.

    Attributes:
        table: of the vehicle file (``fins``).
        noun: what one of it is called.
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
        """The actuator.

        Raises:
            ValueError: a member that the vehicle has not, named with those it has.
        """
        return Servos(body, self.moved, (self.member,), ())


class Servos:
    """Writes set points into servo rows.

    Attributes:
        rows: of the members.
    """

    def __init__(self, body: Body, moved: Moved, members: tuple[str, ...], shape: tuple[int, ...]) -> None:
        """Find the rows.

        Args:
            body: of the vehicle.
            moved: their kind.
            members: names in its table.
            shape: of the field.

        Raises:
            ValueError: a member that the vehicle has not, named with those it has.
        """
        table, noun, name, unit, doc = moved
        present = {
            name.removeprefix(f"{table}."): row for name, row in body.servos.items() if name.startswith(f"{table}.")
        }
        for member in members:
            if member not in present:
                raise ValueError(f'no {noun} "{member}" here, there are: {", ".join(present) or "none"}')
        self._hydro = body.hydro
        self.rows = [present[member] for member in members]
        rows = body.hydro.servos[self.rows]
        self._neutral = rows["command"].tolist()
        order = ", ".join(members)
        if shape:
            doc = f"{doc}, order: {order}"
        self.doc = f"{noun.capitalize()}{'s' if shape else ''} {order}."
        low, high = float(rows["low"].min()), float(rows["high"].max())
        self.fields = (Field(name, unit, doc, "", shape, minimum=low, maximum=high),)

    def apply(self, value: Given) -> None:
        """Hold the set point, within each servo's limits; the field is required, so it is given."""
        (command,) = value
        if command is not None:
            self._hydro.servos["command"][self.rows] = command

    def neutral(self) -> None:
        """Go back to the neutral of the vehicle file."""
        self._hydro.servos["command"][self.rows] = self._neutral
