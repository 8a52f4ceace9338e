"""The vocabulary that all parts share: ports, and the values that pass through them. It imports no other part of uwserver."""

from __future__ import annotations

from uwserver.ports.buffer import Buffer, Layout, binary_form
from uwserver.ports.crossing import is_stop
from uwserver.ports.scene import (
    ACHIEVED_FULL,
    NOWHERE_M,
    ActuatorView,
    BeaconView,
    BeamView,
    BodyView,
    EntityList,
    FanView,
    LampView,
    MeshView,
    ModelFileView,
    OriginView,
    Present,
    SceneState,
    SceneView,
    SensorView,
    ShapeView,
    SolidView,
    WaterView,
    WaveView,
)
from uwserver.ports.values import (
    Argument,
    Call,
    Command,
    ErrorCode,
    Event,
    Fault,
    Field,
    Item,
    Items,
    Json,
    OnReply,
    Port,
    Progress,
    Propulsor,
    Refused,
    Reply,
    Sample,
    Scalar,
    Service,
    Value,
    matches,
    matching,
)

__all__ = [
    "ACHIEVED_FULL", "NOWHERE_M", "ActuatorView", "Argument", "BeaconView", "BeamView", "BodyView", "Buffer", "Call", "Command",
    "EntityList", "ErrorCode", "Event", "FanView", "Fault", "Field", "Item", "Items", "Json", "LampView", "Layout", "MeshView", "ModelFileView",
    "OnReply", "OriginView", "Port", "Present", "Progress", "Propulsor", "Refused", "Reply", "Sample", "Scalar", "SceneState", "SceneView",
    "SensorView", "Service", "ShapeView", "SolidView", "Value", "WaterView", "WaveView", "binary_form", "is_stop", "matches", "matching",
]  # fmt: skip
