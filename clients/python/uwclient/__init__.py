"""Client of uwserver: sensors, actuators and services of a simulated underwater vehicle over one TCP connection or zenoh."""

from __future__ import annotations

from uwclient.aio import AsyncClient
from uwclient.buffers import Buffer
from uwclient.errors import CallRefused, ConnectionLost, ProtocolError, Timeout, UwError
from uwclient.link import tls_context
from uwclient.over_zenoh import connect_zenoh, connect_zenoh_async
from uwclient.ports import (
    Ack,
    Argument,
    Description,
    Event,
    Field,
    Port,
    Progress,
    Propulsor,
    Sample,
    Service,
    Subscription,
)
from uwclient.sync import Client

__version__ = "0.1.0"

connect = Client.connect

__all__ = [
    "Ack",
    "Argument",
    "AsyncClient",
    "Buffer",
    "CallRefused",
    "Client",
    "ConnectionLost",
    "Description",
    "Event",
    "Field",
    "Port",
    "Progress",
    "Propulsor",
    "ProtocolError",
    "Sample",
    "Service",
    "Subscription",
    "Timeout",
    "UwError",
    "connect",
    "connect_zenoh",
    "connect_zenoh_async",
    "tls_context",
]
