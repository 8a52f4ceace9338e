"""Underwater motion capture, as test pools have it: cameras on the walls see markers on the vehicle and report its pose in N."""

from __future__ import annotations

from uwserver.ports import Field, Value
from uwserver.sensors.base import IdealSensor, Pose, Scope, SensorTable


class MotionCaptureConfig(SensorTable, tag="motion_capture", kw_only=True, frozen=True):
    """A camera system without errors of its own: add them as modifiers of `p_NS`."""

    def build(self, mount: Pose) -> MotionCapture:
        return MotionCapture(mount)


class MotionCapture(IdealSensor):
    """Pose of the marker frame while it is under water."""

    doc = "Pose of the marker frame in N, as the cameras of a test pool see it; invalid above the surface."
    fields = (
        Field("p_NS", "m", "position of the marker frame", "N", (3,)),
        Field("q_NS", "1", "attitude of the marker frame, w x y z", "NS", (4,)),
    )

    def __init__(self, mount: Pose) -> None:
        self._mount = mount

    def measure(self, scope: Scope) -> tuple[bool, list[Value]]:
        """Invalid when the markers are above the surface."""
        p_NS = scope.position(self._mount.p)
        if scope.submergence(p_NS) < 0.0:
            return False, [(None,) * 3, (None,) * 4]
        return True, [p_NS, scope.attitude(self._mount.q)]
