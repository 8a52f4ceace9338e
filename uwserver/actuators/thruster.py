"""Thrusters: one, or several as one vector. Commands are written into rows; the kernel computes thrust table, lag, inflow and geometry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from msgspec import Meta

from uwserver.actuators.base import ActuatorTable, Body, Devices, Given, check_members
from uwserver.physics.kernel.arrays import FloatArray, Records
from uwserver.ports import Field, Propulsor
from uwserver.table import Name

_WHOLE = slice(None)
_FIELDS = {"u": "u", "force": "force_N"}


class ThrustersConfig(ActuatorTable, tag="thrusters", kw_only=True, frozen=True):
    """Several thrusters of the vehicle file, commanded as one vector.

    Attributes:
        members: names of thrusters, in the order of the vector; default: all, in the order of the file.
        input: "u" (-1..1 of full command) or "force" (N, before the lag; held to what the supply allows).
    """

    own_wrench = False
    members: Annotated[tuple[Name, ...], Meta(min_length=1)] | None = None
    input: Literal["u", "force"] = "u"

    def devices(self) -> Devices:
        """Return the thrusters."""
        return Devices("thrusters", "thruster", _FIELDS[self.input], self.members or (), is_vector=True)

    def build(self, body: Body) -> Thrusters:
        """Return the actuator.

        Raises:
            ValueError: the vehicle lacks a member; the text lists those that it has.
        """
        members = tuple(body.thrusters) if self.members is None else self.members
        return Thrusters(body, members, (len(members),), self.input)


class ThrusterConfig(ActuatorTable, tag="thruster", kw_only=True, frozen=True):
    """One thruster of the vehicle file.

    Attributes:
        member: its name.
        input: as for `thrusters`.
    """

    own_wrench = False
    member: Name
    input: Literal["u", "force"] = "u"

    def devices(self) -> Devices:
        """Return the thruster."""
        return Devices("thrusters", "thruster", _FIELDS[self.input], (self.member,))

    def build(self, body: Body) -> Thrusters:
        """Return the actuator; ValueError as for `thrusters`."""
        return Thrusters(body, (self.member,), (), self.input)


class Thrusters:
    """Writes commands into thruster rows.

    Attributes:
        rows: rows of the members, by name.
        propulsors: their places and the directions of their thrust.
    """

    def __init__(self, body: Body, members: Sequence[str], shape: tuple[int, ...], command: str) -> None:
        check_members("thruster", members, body.thrusters)
        self._hydro = body.hydro
        rows = [body.thrusters[name] for name in members]
        self.rows = dict(zip(members, rows, strict=True))
        self._part, self._at = _places(rows)
        self.propulsors = tuple(
            Propulsor(name, _three(body.hydro.thrusters["r"][row]), _three(body.hydro.thrusters["per_force"][row][:3]))
            for name, row in self.rows.items()
        )
        self._by_force = int(command == "force")
        # Views of columns of `_all` are kept, because to find a column costs as much as to write it.
        self._all: Records | None = None
        self._columns: tuple[Records, ...] = ()
        order = ", ".join(members)
        self.doc = f"Thrusters {order}." if shape else f"Thruster {order}."
        if self._by_force:
            self.fields = (Field("force_N", "N", f"thrust along each axis, order: {order}", "", shape),)
        else:
            doc = f"part of full command, order: {order}"
            self.fields = (Field("u", "1", doc, "", shape, minimum=-1.0, maximum=1.0),)

    def apply(self, value: Given) -> None:
        """Hold the command from now on."""
        (command,) = value
        if command is not None:
            self._hold(command)

    def neutral(self) -> None:
        """Command no thrust; the present thrust decays with the lag."""
        self._hold(0.0)

    def _hold(self, command: tuple[float, ...] | float) -> None:
        if self._all is not self._hydro.thrusters:  # bodies were added or removed
            self._all = self._hydro.thrusters
            self._columns = tuple(self._all[name][self._part] for name in ("command", "by_force", "fresh"))
        (commands, by_force, fresh), at = self._columns, self._at
        commands[at], by_force[at], fresh[at] = command, self._by_force, 1


def _places(rows: list[int]) -> tuple[slice, list[int] | slice]:
    """Return the part of a column of which to keep a view, and the indices of the rows in it.

    If the rows are one range, the view is just this range, because numpy writes a whole view fastest.
    """
    if rows and rows == list(range(rows[0], rows[-1] + 1)):
        return slice(rows[0], rows[-1] + 1), _WHOLE
    return _WHOLE, rows


def _three(vector: FloatArray) -> tuple[float, float, float]:
    """Return a vector, rounded as a person would write it: the rows hold products of sines and cosines."""
    x, y, z = (round(float(component), 9) + 0.0 for component in vector)
    return x, y, z
