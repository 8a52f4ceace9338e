"""A propeller by its shaft speed. Rate, lag, thrust and torque over the advance number run in the kernel."""

from __future__ import annotations

from uwserver.actuators.base import ActuatorTable, Body
from uwserver.actuators.servo import Servos
from uwserver.table import Name


class PropellerConfig(ActuatorTable, tag="propeller", kw_only=True, frozen=True):
    """One shaft propeller of the vehicle file; its command is the speed of the shaft, which it reaches at its own rate.

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
            "propellers",
            "propeller",
            (self.member,),
            (),
            ("speed_radps", "rad/s", "speed of the shaft, positive ahead"),
        )
