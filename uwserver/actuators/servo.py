"""What fins, shafts, pumps and sliding masses share as actuators: a set point for servos of the vehicle, whose law runs in the kernel."""

from __future__ import annotations

from uwserver.actuators.base import Body, Given
from uwserver.ports import Field


class Servos:
    """Writes set points into servo rows."""

    def __init__(
        self,
        body: Body,
        table: str,
        noun: str,
        members: tuple[str, ...],
        shape: tuple[int, ...],
        field: tuple[str, str, str],
    ) -> None:
        """Find the rows.

        Args:
            body: of the vehicle.
            table, noun: the vehicle file's table (``fins``) and what one of it is called.
            members: names in that table.
            shape: of the field.
            field: name, unit and doc.

        Raises:
            ValueError: a member that the vehicle has not, named with those it has.
        """
        present = {
            name.removeprefix(f"{table}."): row for name, row in body.servos.items() if name.startswith(f"{table}.")
        }
        for name in members:
            if name not in present:
                raise ValueError(f'no {noun} "{name}" here, there are: {", ".join(present) or "none"}')
        self._hydro = body.hydro
        self._rows = [present[name] for name in members]
        rows = body.hydro.servos[self._rows]
        self._neutral = rows["command"].tolist()
        order = ", ".join(members)
        name, unit, doc = field
        if shape:
            doc = f"{doc}, order: {order}"
        self.doc = f"{noun.capitalize()}{'s' if shape else ''} {order}."
        low, high = float(rows["low"].min()), float(rows["high"].max())
        self.fields = (Field(name, unit, doc, "", shape, minimum=low, maximum=high),)

    def apply(self, value: Given) -> None:
        """Hold the set point, within each servo's limits; the field is required, so it is given."""
        (command,) = value
        if command is not None:
            self._hydro.servos["command"][self._rows] = command

    def neutral(self) -> None:
        """Go back to the neutral of the vehicle file."""
        self._hydro.servos["command"][self._rows] = self._neutral
