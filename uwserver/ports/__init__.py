"""The vocabulary of every wall: ports, and the values that travel through them. Imports nothing else of ours."""

from __future__ import annotations

from uwserver.ports.buffer import Buffer, Layout, binary_form
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
    "Argument", "Buffer", "Call", "Command", "ErrorCode", "Event", "Fault", "Field", "Item", "Items", "Json", "Layout",
    "OnReply", "Port", "Progress", "Propulsor", "Refused", "Reply", "Sample", "Scalar", "Service", "Value", "binary_form", "matches", "matching",
]  # fmt: skip
