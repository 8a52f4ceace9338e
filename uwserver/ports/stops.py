"""Services that stop something. They overtake earlier requests, and withdraw waiting requests that would undo the stop."""

from __future__ import annotations

from collections.abc import Mapping

from uwserver.ports.values import Call, Command

UNDONE_BY: Mapping[str, str] = {"disarm": "arm", "deactivate": "activate"}
"""Services that stop a vehicle or an actuator, and for each the service that undoes it."""
PAUSE = "world/pause"


def is_stop(service: str) -> bool:
    """Return whether a service stops a vehicle, a component or time."""
    return service == PAUSE or service.rpartition("/")[2] in UNDONE_BY


def is_withdrawn(item: Command | Call, stop: str) -> bool:
    """Return whether a waiting request must not be carried out after a stop that was requested later.

    That is the case for commands to the stopped component (for `disarm`: to any component of the vehicle) and the call that undoes the stop.

    Args:
        item: the waiting request.
        stop: path of a service that stops a vehicle or a component.
    """
    path, _, verb = stop.rpartition("/")
    if isinstance(item, Call):
        return item.service == f"{path}/{UNDONE_BY[verb]}"
    if verb == "disarm":
        return item.port.startswith(f"{path.partition('/')[0]}/")
    return item.port == path
