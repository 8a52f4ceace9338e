"""Client of uwserver: sensors, actuators and services of simulated underwater vehicles, over one TCP connection or over zenoh."""

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


def __getattr__(name: str) -> str:
    """Return `__version__` of the installed distribution. It is looked up on demand, because that takes longer than all other imports."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("uwclient")
    except PackageNotFoundError as error:
        raise AttributeError("uwclient is not installed, so it has no version: pip install ./clients/python") from error
