"""Fins, rudders and planes: one, or several as one vector. Limits, rate, lag, lift and drag run in the kernel."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from uwserver.actuators.base import ActuatorTable, Body, Devices
from uwserver.actuators.servo import Moved, OneServo, Servos
from uwserver.table import Name

_FIN = Moved("fins", "fin", "angle_rad", "rad", "angle about the hinge")


class FinsConfig(ActuatorTable, tag="fins", kw_only=True, frozen=True):
    """Several fins of the vehicle file commanded as one vector of angles.

    Attributes:
        members: names of fins, in the order of the vector; default: all, in the order of the file.
    """

    own_wrench = False
    members: Annotated[tuple[Name, ...], Meta(min_length=1)] | None = None

    def devices(self) -> Devices:
        """The fins."""
        return Devices(_FIN.table, _FIN.noun, _FIN.field, self.members or (), is_vector=True)

    def build(self, body: Body) -> Servos:
        """The actuator.

        Raises:
            ValueError: a member that the vehicle has not, named with those it has.
        """
        members = self.members
        if members is None:
            members = tuple(name.removeprefix("fins.") for name in body.servos if name.startswith("fins."))
        return Servos(body, _FIN, members, (len(members),))


class FinConfig(OneServo, tag="fin", kw_only=True, frozen=True):
    """One fin of the vehicle file; its command is the angle, which it reaches at its own rate.

    The angle counts about the fin's hinge, which shipped vehicles turn so that signs are alike: a positive rudder turns to starboard; a positive
    plane has its trailing edge down, so it dives at the stern (elevator, stern planes) and climbs at the bow; of an X-shaped tail each fin turns
    to starboard at a positive angle, and dives or climbs by its slant.
    """

    moved = _FIN
