"""Underwater motion capture of a test pool: cameras on the walls see markers on the vehicle and report its pose in N."""

from __future__ import annotations

from typing import Any

from uwserver.physics.kernel.arrays import Array
from uwserver.physics.kernel.deferred import compiled
from uwserver.ports import Field
from uwserver.sensors.base import Pose, SensorTable
from uwserver.sensors.compiled import MISSING, CompiledSensor, SensorKernel, loop, p_NS, q_NS, record, submergence


class MotionCaptureConfig(SensorTable, tag="motion_capture", kw_only=True, frozen=True):
    """A camera system without errors of its own: add them as modifiers of `p_NS`."""

    message = "Pose"

    def build(self, mount: Pose) -> MotionCapture:
        return MotionCapture(mount)


@compiled
def measure(head: Any, row: Any, surroundings: Array, t: float, out: Array) -> None:
    """Write the pose; invalid while the markers are above the surface."""
    p = p_NS(head, surroundings)
    out[0], out[1], out[2] = p
    out[3], out[4], out[5], out[6] = q_NS(head, surroundings)
    if submergence(surroundings, p, t) < 0.0:
        out[:], head.valid = MISSING, 0


class MotionCapture(CompiledSensor):
    """Pose of the marker frame while it is under water."""

    doc = "Pose of the marker frame in N, as the cameras of a test pool see it; invalid above the surface."
    fields = (
        Field("p_NS", "m", "position of the marker frame", "N", (3,)),
        Field("q_NS", "1", "attitude of the marker frame, w x y z", "NS", (4,)),
    )
    kernel = SensorKernel(record([]), loop(measure))
    exact = True
