"""Which scenarios can be copied: what a batch does not act out is refused by its name."""

from __future__ import annotations

from collections.abc import Iterator

from uwserver.actuators.base import Actuator
from uwserver.autopilot.status import StateSensor
from uwserver.ports import Refused
from uwserver.scenario.load.default_adapter import KIND
from uwserver.scenario.load.resolved import Resolved
from uwserver.sensors.bank import BankSensor
from uwserver.world.part import is_awake
from uwserver.world.piloting import Piloting
from uwserver.world.world import World

_OF_EVERY_WORLD = {
    "world/autopilots", "world/bodies", "world/commands", "world/faults", "world/population", "world/samples", "world/water",
}  # fmt: skip


def check(resolved: Resolved, world: World) -> None:
    """Refuse a scenario of which copies would not be what its world is.

    Args:
        resolved: the scenario.
        world: one that was built of it.

    Raises:
        Refused: solid things, adapters that do more than to let clients in, or components in plain Python; the text names all of them.
    """
    faults = [
        (what, names)
        for what, names in (
            ("solid things, which copies do not touch", list(_solid(resolved))),
            ("adapters, which nobody runs here", list(_adapters(resolved))),
            ("components in plain Python, which act in one world alone", list(_in_python(world))),
        )
        if names
    ]
    if faults:
        text = "; ".join(f"{what}: {', '.join(names)}" for what, names in faults)
        raise Refused("denied", f"{resolved.name} cannot be copied: it has {text}. Take them out of the scenario.")


def _solid(resolved: Resolved) -> Iterator[str]:
    if resolved.is_solid:
        yield from resolved.static
        yield from resolved.objects
        if not resolved.static:
            yield from (name for name, vehicle in resolved.vehicles.items() if vehicle.solid is not None)


def _adapters(resolved: Resolved) -> Iterator[str]:
    """All but those of the kinds that are there where a file says nothing: they only let clients in, who have no way into this process."""
    for name, config in resolved.scenario.adapters.items():
        kind = config.__struct_config__.tag
        if kind not in (KIND, "web"):
            yield f"adapters.{name} ({kind})"


def _in_python(world: World) -> Iterator[str]:
    for path, slot in world.sensors.items():
        if isinstance(slot.sensor, StateSensor):
            continue  # shows what an autopilot believes, and changes nothing
        if not isinstance(slot.sensor, BankSensor):
            yield f"{path} ({slot.port.kind})"
        for stream in slot.streams:
            if stream.is_ready_made:
                yield f"{stream.port.path} (a modifier)"
    for path, actuator in world.actuators.items():
        if _is_foreign(actuator.actuator):
            yield f"{path} ({actuator.port.kind})"
    for part in world.own_parts:
        if is_awake(part) and part.path not in _OF_EVERY_WORLD:
            yield part.path
    for part in world.parts.values():
        if isinstance(part, Piloting) and part.hears:
            yield f"{part.path} (hears {', '.join(part.hears)})"


def _is_foreign(actuator: Actuator) -> bool:
    return not type(actuator).__module__.startswith("uwserver.")
