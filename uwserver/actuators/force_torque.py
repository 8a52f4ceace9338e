"""An external wrench on the vehicle: for tests, towing, pushing, and controllers that do their own allocation."""

from __future__ import annotations

from uwserver.actuators.base import ActuatorTable, Body, Given
from uwserver.ports import Field
from uwserver.table import NonNegative


class ForceTorqueConfig(ActuatorTable, tag="force_torque", kw_only=True, frozen=True):
    """An external wrench on the vehicle.

    Attributes:
        max_force_N, max_torque_Nm: limits of each component. 0: what accelerates the dry vehicle by 100 m/s2 or 100 rad/s2. A larger mistaken
            command would end the run for everybody.
    """

    message = "Wrench"
    own_wrench = False
    max_force_N: NonNegative = 0.0
    max_torque_Nm: NonNegative = 0.0

    def nudge(self, mass_kg: float) -> str:
        """Return a force of a third of the weight, down, but of at most half of the limit."""
        force = 0.3 * 9.8 * mass_kg
        limit = self.max_force_N or force
        return f"force_B='[0,0,{round(min(force, 0.5 * limit)):d}]'"

    def build(self, body: Body) -> ForceTorque:
        """Return the actuator."""
        inertia = body.hydro.bodies["M_RB"][body.row].diagonal()
        force = self.max_force_N or 100.0 * float(inertia[0])
        return ForceTorque(body, force, self.max_torque_Nm or 100.0 * float(inertia[3:].max()))


class ForceTorque:
    """Holds a wrench in B about the body origin. A field that is left out is zero.

    Attributes:
        rows: the row of its wrench, once for each component of the command.
    """

    doc = "External force and moment about the body origin, in B; a field that is left out is zero."

    def __init__(self, body: Body, max_force: float, max_torque: float) -> None:
        self._body, self.rows = body, [body.wrench] * 6
        moment = "moment about the body origin"
        self.fields = (
            Field("force_B", "N", "force", "B", (3,), minimum=-max_force, maximum=max_force),
            Field("torque_B", "N m", moment, "B", (3,), minimum=-max_torque, maximum=max_torque),
        )

    def apply(self, value: Given) -> None:
        """Apply the wrench from now on."""
        force, torque = value
        self._body.push(force or (0.0,) * 3, torque or (0.0,) * 3)

    def neutral(self) -> None:
        """Apply no wrench."""
        self._body.push((0.0,) * 3)
