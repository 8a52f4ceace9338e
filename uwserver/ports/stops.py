"""Services that stop something: who calls one waits for nothing that he asked before, and what would undo it is taken back."""

from __future__ import annotations

from collections.abc import Mapping

from uwserver.ports.values import Call, Command

UNDONE_BY: Mapping[str, str] = {"disarm": "arm", "deactivate": "activate"}
"""Name of a service that stops a vehicle or an actuator -> of the one that undoes it."""
PAUSE = "world/pause"


def is_stop(service: str) -> bool:
    """Whether a service stops a vehicle, a component or time."""
    return service == PAUSE or service.rpartition("/")[2] in UNDONE_BY


def is_withdrawn(item: Command | Call, stop: str) -> bool:
    """Whether a request that waits must not be carried out after a stop that was asked for later.

    Args:
        item: commands to what is stopped (of a `disarm`, to anything of the vehicle), and the call that undoes the stop.
        stop: path of a service that stops a vehicle or a component.
    """
    path, _, verb = stop.rpartition("/")
    if isinstance(item, Call):
        return item.service == f"{path}/{UNDONE_BY[verb]}"
    if verb == "disarm":
        return item.port.startswith(f"{path.partition('/')[0]}/")
    return item.port == path
