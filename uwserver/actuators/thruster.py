"""Thrusters: one, or several as one vector. Table, lag, inflow and geometry run in the kernel; here commands become its rows."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from uwserver.actuators.base import ActuatorTable, Body, Devices, Given
from uwserver.physics.kernel.arrays import FloatArray, Records
from uwserver.ports import Field, Propulsor
from uwserver.table import Name

_WHOLE = slice(None)
_FIELDS = {"u": "u", "force": "force_N"}


class ThrustersConfig(ActuatorTable, tag="thrusters", kw_only=True, frozen=True):
    """Several thrusters of the vehicle file commanded as one vector.

    Attributes:
        members: names of thrusters, in the order of the vector; default: all, in the order of the file.
        input: "u" (-1..1 of full command) or "force" (N, before the lag; held to what the supply allows).
    """

    own_wrench = False
    members: Annotated[tuple[Name, ...], Meta(min_length=1)] | None = None
    input: Literal["u", "force"] = "u"

    def devices(self) -> Devices:
        """The thrusters."""
        return Devices("thrusters", "thruster", _FIELDS[self.input], self.members or (), is_vector=True)

    def build(self, body: Body) -> Thrusters:
        """The actuator.

        Raises:
            ValueError: a member that the vehicle has not, named with those it has.
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
        """The thruster."""
        return Devices("thrusters", "thruster", _FIELDS[self.input], (self.member,))

    def build(self, body: Body) -> Thrusters:
        """The actuator; ValueError as for `thrusters`."""
        return Thrusters(body, (self.member,), (), self.input)


class Thrusters:
    """Writes commands into thruster rows.

    Attributes:
        rows: of the members, by name.
        propulsors: where they sit and which way they push.
    """

    def __init__(self, body: Body, members: tuple[str, ...], shape: tuple[int, ...], command: str) -> None:
        for name in members:
            if name not in body.thrusters:
                raise ValueError(f'no thruster "{name}" here, there are: {", ".join(body.thrusters) or "none"}')
        self._hydro = body.hydro
        self.rows = {name: body.thrusters[name] for name in members}
        self._part, self._at = _places([body.thrusters[name] for name in members])
        self.propulsors = tuple(
            Propulsor(
                name, _three(self._hydro.thrusters["r"][row]), _three(self._hydro.thrusters["per_force"][row][:3])
            )
            for name, row in self.rows.items()
        )
        self._by_force = int(command == "force")
        self._all: Records | None = None  # of whose columns these are views: to find one costs as much as to write it
        self._columns: tuple[Records, ...] = ()
        order = ", ".join(members)
        self.doc = f"Thrusters {order}." if shape else f"Thruster {order}."
        if self._by_force:
            self.fields = (Field("force_N", "N", f"thrust along each axis, order: {order}", "", shape),)
        else:
            self.fields = (
                Field("u", "1", f"part of full command, order: {order}", "", shape, minimum=-1.0, maximum=1.0),
            )

    def apply(self, value: Given) -> None:
        """Hold the command; the field is required, so it is given."""
        (command,) = value
        if command is not None:
            self._hold(command)

    def neutral(self) -> None:
        """No thrust asked for; the lag runs out."""
        self._hold(0.0)

    def _hold(self, command: tuple[float, ...] | float) -> None:
        if self._all is not self._hydro.thrusters:  # bodies came, or went back
            self._all = self._hydro.thrusters
            self._columns = tuple(self._all[name][self._part] for name in ("command", "by_force", "fresh"))
        (commands, by_force, fresh), at = self._columns, self._at
        commands[at], by_force[at], fresh[at] = command, self._by_force, 1


def _places(rows: list[int]) -> tuple[slice, list[int] | slice]:
    """Which part of a column to keep a view of, and where in it rows stand: all of it where they are one range, in which numpy writes quickest."""
    if rows and rows == list(range(rows[0], rows[-1] + 1)):
        return slice(rows[0], rows[-1] + 1), _WHOLE
    return _WHOLE, rows


def _three(vector: FloatArray) -> tuple[float, float, float]:
    """Rounded to what a person would write, as the rows hold products of angles."""
    x, y, z = (round(float(component), 9) + 0.0 for component in vector)
    return x, y, z
