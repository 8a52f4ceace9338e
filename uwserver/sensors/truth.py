"""Ground truth of a vehicle, under ``<vehicle>/truth/``; an adapter serves it only when it is told to."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.frames import conjugate, rotate
from uwserver.ports import Field, Value
from uwserver.sensors.base import IdealSensor, Scope, Sensor
from uwserver.table import Positive, Table


class Truth(Table, kw_only=True, frozen=True):
    """Ground truth under ``<vehicle>/truth/``: pose, velocity, acceleration, wrench, flow. Adapters serve it only if they are told to."""

    rate_hz: Positive = 20.0


class TruthPose(IdealSensor):
    """Exact pose."""

    doc = "Exact pose of the body origin."
    fields = (
        Field("p_NB", "m", "position of the body origin", "N", (3,)),
        Field("q_NB", "1", "attitude, w x y z", "NB", (4,)),
    )

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Always valid."""
        return True, [scope.p_NB, scope.q_NB]


class TruthVelocity(IdealSensor):
    """Exact velocity nu."""

    doc = "Exact velocity of the body origin relative to N."
    fields = (
        Field("v_NB_B", "m/s", "surge, sway, heave velocity", "B", (3,)),
        Field("w_NB_B", "rad/s", "roll, pitch, yaw rate", "B", (3,)),
    )

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Always valid."""
        return True, [scope.v_NB_B, scope.w_NB_B]


class TruthAcceleration(IdealSensor):
    """Exact derivative of nu."""

    doc = "Exact time derivative of the body-fixed velocity components."
    needs_rates = True
    fields = (
        Field("v_dot_B", "m/s^2", "derivative of surge, sway, heave velocity", "B", (3,)),
        Field("w_dot_B", "rad/s^2", "derivative of roll, pitch, yaw rate", "B", (3,)),
    )

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Always valid."""
        return True, [scope.nu_dot[:3], scope.nu_dot[3:]]


class TruthWrench(IdealSensor):
    """Force and moment of all actuators."""

    doc = "Force and moment of all actuators about the body origin (thrust with lag, inflow and immersion; applied wrenches)."
    needs_rates = True
    fields = (
        Field("force_B", "N", "force", "B", (3,)),
        Field("torque_B", "N m", "moment about the body origin", "B", (3,)),
    )

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Always valid."""
        return True, [scope.tau[:3], scope.tau[3:]]


class TruthFlow(IdealSensor):
    """Exact velocity of the water."""

    doc = "Exact velocity of the undisturbed water at the body origin: current and waves."
    fields = (Field("v_NW_B", "m/s", "velocity of the water relative to N", "B", (3,)),)

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Always valid."""
        return True, [rotate(conjugate(scope.q_NB), scope.water.velocity(scope.p_NB, scope.t))]


TRUTH: dict[str, Callable[[], Sensor]] = {
    "pose": TruthPose,
    "velocity": TruthVelocity,
    "acceleration": TruthAcceleration,
    "wrench": TruthWrench,
    "flow": TruthFlow,
}
