"""Ground truth of a vehicle, under ``<vehicle>/truth/``. An adapter serves it only if it is configured to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Field
from uwserver.sensors.base import Sensor
from uwserver.sensors.compiled import (
    CompiledSensor,
    SensorKernel,
    conjugate,
    loop,
    nu_dot_at,
    p_NB,
    q_NB,
    record,
    rotate,
    tau_at,
    v_NB_B,
    w_NB_B,
    water_velocity,
)
from uwserver.table import Positive, Table


class Truth(Table, kw_only=True, frozen=True):
    """Ground truth under ``<vehicle>/truth/``: pose, velocity, acceleration, wrench, flow. Adapters serve it only if they are configured to."""

    rate_hz: Positive = 20.0


_RECORD = record([])


@compiled
def pose(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write p_NB and q_NB."""
    out[0], out[1], out[2] = p_NB(head, surroundings)
    out[3], out[4], out[5], out[6] = q_NB(head, surroundings)


@compiled
def velocity(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write nu."""
    out[0], out[1], out[2] = v_NB_B(head, surroundings)
    out[3], out[4], out[5] = w_NB_B(head, surroundings)


@compiled
def acceleration(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write nu_dot."""
    out[:] = nu_dot_at(surroundings)[head.body]


@compiled
def wrench(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write tau."""
    out[:] = tau_at(surroundings)[head.body]


@compiled
def flow(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the velocity of the water in B."""
    out[0], out[1], out[2] = rotate(
        conjugate(q_NB(head, surroundings)), water_velocity(surroundings, p_NB(head, surroundings), t)
    )


class _Exact(CompiledSensor):
    """A sensor of the truth, which is always valid."""

    exact = True


class TruthPose(_Exact):
    """Exact pose."""

    doc = "Exact pose of the body origin."
    fields = (
        Field("p_NB", "m", "position of the body origin", "N", (3,)),
        Field("q_NB", "1", "attitude, w x y z", "NB", (4,)),
    )
    kernel = SensorKernel(_RECORD, loop(pose))


class TruthVelocity(_Exact):
    """Exact velocity nu."""

    doc = "Exact velocity of the body origin relative to N."
    fields = (
        Field("v_NB_B", "m/s", "surge, sway, heave velocity", "B", (3,)),
        Field("w_NB_B", "rad/s", "roll, pitch, yaw rate", "B", (3,)),
    )
    kernel = SensorKernel(_RECORD, loop(velocity))


class TruthAcceleration(_Exact):
    """Exact derivative of nu."""

    doc = "Exact time derivative of the body-fixed velocity components."
    needs_rates = True
    fields = (
        Field("v_dot_B", "m/s^2", "derivative of surge, sway, heave velocity", "B", (3,)),
        Field("w_dot_B", "rad/s^2", "derivative of roll, pitch, yaw rate", "B", (3,)),
    )
    kernel = SensorKernel(_RECORD, loop(acceleration))


class TruthWrench(_Exact):
    """Force and moment of all actuators."""

    doc = "Force and moment of all actuators about the body origin (thrust with lag, inflow and immersion; applied wrenches)."
    needs_rates = True
    fields = (
        Field("force_B", "N", "force", "B", (3,)),
        Field("torque_B", "N m", "moment about the body origin", "B", (3,)),
    )
    kernel = SensorKernel(_RECORD, loop(wrench))


class TruthFlow(_Exact):
    """Exact velocity of the water."""

    doc = "Exact velocity of the undisturbed water at the body origin: current and waves."
    fields = (Field("v_NW_B", "m/s", "velocity of the water relative to N", "B", (3,)),)
    kernel = SensorKernel(_RECORD, loop(flow))


TRUTH: dict[str, Callable[[], Sensor]] = {
    "pose": TruthPose,
    "velocity": TruthVelocity,
    "acceleration": TruthAcceleration,
    "wrench": TruthWrench,
    "flow": TruthFlow,
}
