"""Fins, rudders and planes: one, or several as one vector. The kernel computes limits, rate, lag, lift and drag."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.actuators.base import ActuatorTable, Body, Devices
from uwserver.actuators.servo import Moved, OneServo, Servos
from uwserver.table import Name

_FIN = Moved("fins", "fin", "angle_rad", "rad", "angle about the hinge")


class FinsConfig(ActuatorTable, tag="fins", kw_only=True, frozen=True):
    """Several fins of the vehicle file, commanded as one vector of angles.

    Attributes:
        members: names of fins, in the order of the vector; default: all, in the order of the file.
    """

    own_wrench = False
    members: Annotated[tuple[Name, ...], Meta(min_length=1)] | None = None

    def devices(self) -> Devices:
        """The fins."""
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
