"""A ballast tank or an oil bladder by its volume. Pump rate and force run in the kernel."""

from __future__ import annotations

from uwserver.actuators.base import ActuatorTable, Body
from uwserver.actuators.servo import Servos
from uwserver.table import Name


class BallastConfig(ActuatorTable, tag="ballast", kw_only=True, frozen=True):
    """One ballast of the vehicle file; its command is the volume, which its pump reaches at its own rate. The watchdog pumps back to neutral.

    Attributes:
        member: its name.
    """

    member: Name

    def build(self, body: Body) -> Servos:
        """The actuator.

        Raises:
            ValueError: a member that the vehicle has not, named with those it has.
        """
        return Servos(
            body,
            "ballasts",
            "ballast",
            (self.member,),
            (),
            ("volume_m3", "m^3", "oil in the bladder, or water in the tank"),
        )
