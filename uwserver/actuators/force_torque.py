"""An external wrench on the vehicle: for tests, towing, pushing, and controllers that do their own allocation."""

from __future__ import annotations

from uwserver.actuators.base import ActuatorTable, Body, Given
from uwserver.ports import Field
from uwserver.table import NonNegative


class ForceTorqueConfig(ActuatorTable, tag="force_torque", kw_only=True, frozen=True):
    """An external wrench on the vehicle.

    Attributes:
        max_force_N, max_torque_Nm: limits of each component; 0 for what accelerates the dry vehicle by 100 m/s2 or 100 rad/s2, beyond
            which one mistaken command would end the run for everybody.
    """

    message = "Wrench"
    own_wrench = False
    max_force_N: NonNegative = 0.0
    max_torque_Nm: NonNegative = 0.0

    def nudge(self, mass_kg: float) -> str:
        """A third of its weight, down."""
        force = 0.3 * 9.8 * mass_kg
        limit = self.max_force_N or force
        return f"force_B='[0,0,{round(min(force, 0.5 * limit)):d}]'"

    def build(self, body: Body) -> ForceTorque:
        """The actuator."""
        inertia = body.hydro.bodies["M_RB"][body.row].diagonal()
        force = self.max_force_N or 100.0 * float(inertia[0])
        return ForceTorque(body, force, self.max_torque_Nm or 100.0 * float(inertia[3:].max()))


class ForceTorque:
    """Holds a wrench in B about the body origin; a field that is left out is zero.

    Attributes:
        rows: that of its wrench, for each component of its command.
    """

    doc = "External force and moment about the body origin, in B; a field that is left out is zero."

    def __init__(self, body: Body, max_force: float, max_torque: float) -> None:
        self._body, self.rows = body, [body.wrench] * 6
        self.fields = (
            _limited("force_B", "N", "force", max_force),
            _limited("torque_B", "N m", "moment about the body origin", max_torque),
        )

    def apply(self, value: Given) -> None:
        """Hold the wrench from now on."""
        force, torque = value
        self._body.push(force or (0.0,) * 3, torque or (0.0,) * 3)

    def neutral(self) -> None:
        """No wrench."""
        self._body.push((0.0,) * 3)


def _limited(name: str, unit: str, doc: str, limit: float) -> Field:
    return Field(name, unit, doc, "B", (3,), minimum=-limit, maximum=limit)
