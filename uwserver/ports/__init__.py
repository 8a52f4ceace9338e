"""The vocabulary of every wall: ports, and the values that travel through them. Imports nothing of ours but units."""

from __future__ import annotations

from uwserver.ports.values import (
    Argument,
    Call,
    Command,
    ErrorCode,
    Event,
    Fault,
    Field,
    Json,
    OnReply,
    Port,
    Progress,
    Refused,
    Reply,
    Sample,
    Scalar,
    Service,
    Value,
    matches,
)

__all__ = [
    "Argument",
    "Call",
    "Command",
    "ErrorCode",
    "Event",
    "Fault",
    "Field",
    "Json",
    "OnReply",
    "Port",
    "Progress",
    "Refused",
    "Reply",
    "Sample",
    "Scalar",
    "Service",
    "Value",
    "matches",
]
