"""Set points of the vehicle's servos: fins, propellers, ballasts and moving masses. The kernel computes limits, rate, lag, lift and drag."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, NamedTuple

from msgspec import Meta

from uwserver.actuators.base import ActuatorTable, Body, Devices, Given, check_members
from uwserver.ports import Field
from uwserver.table import Name


class Moved(NamedTuple):
    """What servos of one kind move.

    Attributes:
        table: table of the vehicle file (``fins``).
        noun: name of one of them ("fin").
        field, unit, doc: those of the command.
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
        """Return the part that the servo moves."""
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
        rows: rows of the members.
    """

    def __init__(self, body: Body, moved: Moved, members: Sequence[str] | None, *, is_vector: bool = False) -> None:
        """Find the rows of the members.

        Args:
            body: body of the vehicle.
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


_FIN = Moved("fins", "fin", "angle_rad", "rad", "angle about the hinge")


class FinsConfig(ActuatorTable, tag="fins", kw_only=True, frozen=True):
    """Several fins of the vehicle file, commanded as one vector of angles.

    Attributes:
        members: names of fins, in the order of the vector; default: all, in the order of the file.
    """

    own_wrench = False
    members: Annotated[tuple[Name, ...], Meta(min_length=1)] | None = None

    def devices(self) -> Devices:
        """Return the fins."""
        return Devices(_FIN.table, _FIN.noun, _FIN.field, self.members or (), is_vector=True)

    def build(self, body: Body) -> Servos:
        """Return the actuator.

        Raises:
            ValueError: the vehicle lacks a member; the text lists those that it has.
        """
        return Servos(body, _FIN, self.members, is_vector=True)


class FinConfig(OneServo, tag="fin", kw_only=True, frozen=True):
    """One fin of the vehicle file. The command is its angle, which it reaches at its own rate.

    The angle counts about the hinge of the fin. The hinges of the shipped vehicles are turned so that signs agree: a positive rudder turns the
    vehicle to starboard. A positive plane has its trailing edge down: at the stern (elevator, stern planes) it makes the vehicle dive, at the bow
    climb. Each fin of an X-shaped tail turns the vehicle to starboard at a positive angle; its slant decides whether the vehicle dives or climbs.
    """

    moved = _FIN
