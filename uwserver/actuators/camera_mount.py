"""A mount that tilts the cameras on it, as the servo in the dome of an ROV does."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from uwserver.actuators.base import ActuatorTable, Body, Given, Timeout
from uwserver.ports import Field
from uwserver.table import Name, Positive
from uwserver.units import rad

Angle = Annotated[float, Meta(ge=-180, le=180)]


class CameraMountConfig(ActuatorTable, tag="camera_mount", kw_only=True, frozen=True):
    """Tilts a mount of the vehicle about its y axis: up is positive. It turns the cameras on that mount, and no other sensor.

    Attributes:
        mount: name of the vehicle's mount.
        low_deg, high_deg: how far it tilts.
        rate_degps: how fast.
    """

    timeout_s: Timeout = 0.0
    mount: Name
    low_deg: Angle = -45.0
    high_deg: Angle = 45.0
    rate_degps: Positive = 90.0

    def __post_init__(self) -> None:
        """ValueError where keys do not go together."""
        if not self.low_deg <= 0.0 <= self.high_deg:
            raise ValueError("low_deg and high_deg must have 0, its neutral, between them")

    def build(self, body: Body) -> CameraMount:  # noqa: ARG002 - of all actuators
        """The actuator."""
        return CameraMount(self)


class MountMemory(Struct):
    """Where it is to go, rad."""

    tilt: float = 0.0


class CameraMount:
    """Remembers a tilt, to which cameras on the mount turn.

    Attributes:
        mount: name of it.
        rate: rad/s.
        memory: the tilt.
    """

    def __init__(self, config: CameraMountConfig) -> None:
        self.mount, self.rate = config.mount, rad(config.rate_degps)
        self.memory = MountMemory()
        self.doc = f'Tilt of the mount "{config.mount}" with the cameras on it.'
        low, high = rad(config.low_deg), rad(config.high_deg)
        self.fields = (Field("tilt", "rad", "angle above the mount's rest, up positive", minimum=low, maximum=high),)

    def apply(self, value: Given) -> None:
        """Go there; the field is required, so it is given."""
        (tilt,) = value
        if tilt is not None:
            self.memory = MountMemory(tilt[0])

    def neutral(self) -> None:
        """Back to rest."""
        self.memory = MountMemory()
