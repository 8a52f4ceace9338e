"""An external wrench on the vehicle: for tests, towing, pushing, and controllers that do their own allocation."""

from __future__ import annotations

from uwserver.actuators.base import ActuatorTable, Body, Given
from uwserver.ports import Field
from uwserver.table import NonNegative


class ForceTorqueConfig(ActuatorTable, tag="force_torque", kw_only=True, frozen=True):
    """Attributes:
    max_force_N, max_torque_Nm: limits of each component; 0 for none.
    """

    max_force_N: NonNegative = 0.0
    max_torque_Nm: NonNegative = 0.0

    def build(self, body: Body) -> ForceTorque:
        """The actuator."""
        return ForceTorque(body, self.max_force_N or None, self.max_torque_Nm or None)


class ForceTorque:
    """Holds a wrench in B about the body origin; a field that is left out is zero."""

    doc = "External force and moment about the body origin, in B; a field that is left out is zero."

    def __init__(self, body: Body, max_force: float | None, max_torque: float | None) -> None:
        self._hydro, self._row = body.hydro, body.wrench
        self.fields = (
            _limited("force_B", "N", "force", max_force),
            _limited("torque_B", "N m", "moment about the body origin", max_torque),
        )

    def apply(self, value: Given) -> None:
        """Hold the wrench from now on."""
        force, torque = value
        self._hydro.wrenches["bias"][self._row] = (*(force or (0.0,) * 3), *(torque or (0.0,) * 3))

    def neutral(self) -> None:
        """No wrench."""
        self._hydro.wrenches["bias"][self._row] = 0.0


def _limited(name: str, unit: str, doc: str, limit: float | None) -> Field:
    low = None if limit is None else -limit
    return Field(name, unit, doc, "B", (3,), minimum=low, maximum=limit)
