"""A mass that slides along an axis to trim the vehicle. Rate and moment run in the kernel."""

from __future__ import annotations

from uwserver.actuators.base import ActuatorTable, Body
from uwserver.actuators.servo import Servos
from uwserver.table import Name

_FIELD = ("position_m", "m", "position along the axis, 0 where the centre of mass of the vehicle file holds")


class MovingMassConfig(ActuatorTable, tag="moving_mass", kw_only=True, frozen=True):
    """One moving mass of the vehicle file; its command is its position along its axis.

    Attributes:
        member: its name.
    """

    member: Name

    def build(self, body: Body) -> Servos:
        """The actuator.

        Raises:
            ValueError: a member that the vehicle has not, named with those it has.
        """
        return Servos(body, "moving_masses", "moving mass", (self.member,), (), _FIELD)
