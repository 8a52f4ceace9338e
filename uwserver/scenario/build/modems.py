"""The sending ends of modems, and the water between them."""

from __future__ import annotations

from collections.abc import Iterable

from uwserver.ports import Port
from uwserver.scenario.load.resolved import Resolved
from uwserver.sensors import ModemTable
from uwserver.sensors.modem import Modem
from uwserver.units import NANOSECONDS
from uwserver.world.components import ActuatorSlot
from uwserver.world.modems.medium import Medium
from uwserver.world.modems.send import Send
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.world import World


def add_medium(world: World, resolved: Resolved) -> None:
    """Let packets be in the water of a world, where a vehicle of its scenario has a modem."""
    sensors = [config for vehicle in resolved.vehicles.values() for config in vehicle.vehicle.sensors.values()]
    if any(isinstance(config, ModemTable) for config in sensors):
        world.add(Medium(world))


def send_slots(world: World, sensors: Iterable[SensorSlot]) -> list[ActuatorSlot]:
    """Where the modems among some sensors take messages."""
    slots = []
    for slot in sensors:
        modem, medium = slot.sensor, world.parts.get(Medium.path)
        if isinstance(modem, Modem) and isinstance(medium, Medium):
            send = Send(modem, medium.submitter(slot.path), lambda: world.t_ns / NANOSECONDS)
            path = slot.path.removesuffix("/received") + "/send"
            port = Port(path, "actuator", slot.port.kind, send.fields, send.doc)
            slots.append(ActuatorSlot(port, send, world.rate_hz, 0))
    return slots
