"""A mount that tilts the cameras on it, as the servo in the dome of an ROV does."""

from __future__ import annotations

from msgspec import Struct

from uwserver.actuators.base import ActuatorTable, Body, Devices, Given, Timeout
from uwserver.ports import Field
from uwserver.table import Name


class CameraMountConfig(ActuatorTable, tag="camera_mount", kw_only=True, frozen=True):
    """Tilts a mount of the vehicle that has `tilt_deg`. It turns the cameras on that mount, and no other sensors.

    Attributes:
        mount: its name.
    """

    own_wrench = False
    timeout_s: Timeout = 0.0
    mount: Name

    def devices(self) -> Devices:
        """Return the mount."""
        return Devices("mounts", "mount", "tilt", (self.mount,), key="mount")

    def build(self, body: Body) -> CameraMount:
        """Return the actuator.

        Raises:
            ValueError: the vehicle has no such mount that tilts; the text lists those that do.
        """
        if self.mount not in body.tilts:
            there = ", ".join(body.tilts) or "none"
            raise ValueError(f'no mount "{self.mount}" that tilts, there are: {there}; give it tilt_deg')
        return CameraMount(self.mount, *body.tilts[self.mount])


class MountMemory(Struct):
    """The commanded tilt, rad."""

    tilt: float = 0.0


class CameraMount:
    """Holds a commanded tilt. The cameras on the mount turn to it.

    Attributes:
        mount: name of the mount.
        rate: rad/s.
        memory: the commanded tilt.
    """

    def __init__(self, mount: str, low: float, high: float, rate: float) -> None:
        self.mount, self.rate, self.memory = mount, rate, MountMemory()
        self.doc = f'Tilt of the mount "{mount}" with the cameras on it.'
        self.fields = (Field("tilt", "rad", "angle above the mount's rest, up positive", minimum=low, maximum=high),)

    def apply(self, value: Given) -> None:
        """Tilt to the commanded angle."""
        (tilt,) = value
        if tilt is not None:
            self.memory = MountMemory(tilt[0])

    def neutral(self) -> None:
        """Return to the rest position."""
        self.memory = MountMemory()
