"""The sending ends of modems, their services, and the medium between them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from uwserver.ports import Argument, Json, Port, Refused, Service
from uwserver.ports.crossing import Later
from uwserver.scenario.load.resolved import Resolved
from uwserver.sensors import ModemTable
from uwserver.sensors.modem import Modem
from uwserver.units import NANOSECONDS
from uwserver.world.modems.medium import Medium
from uwserver.world.modems.send import Send
from uwserver.world.parts.part import Carry
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.stepping.commands import ActuatorSlot
from uwserver.world.world import World


def add_medium(world: World, resolved: Resolved) -> None:
    """Add the medium that carries packets, if a vehicle of the scenario has a modem."""
    if any(isinstance(config, ModemTable) for config in resolved.sensors):
        world.add(Medium(world))


def send_slots(world: World, sensors: Iterable[SensorSlot]) -> list[ActuatorSlot]:
    """Return the actuators that take messages for the modems among some sensors."""
    slots = []
    for slot in sensors:
        modem, medium = slot.sensor, world.parts.get(Medium.path)
        if isinstance(modem, Modem) and isinstance(medium, Medium):
            send = Send(modem, medium.submitter(slot.path), lambda: world.t_ns / NANOSECONDS)
            path = slot.path.removesuffix("/received") + "/send"
            port = Port(path, "actuator", slot.port.kind, send.fields, send.doc)
            slots.append(ActuatorSlot(port, send, world.rate_hz, 0))
    return slots


_LONGEST_WAIT_S = 3600.0


def range_services(world: World, slots: Iterable[ActuatorSlot]) -> Iterator[tuple[Service, Carry]]:
    """Yield ``range`` and ``cancel_range`` of the modems among some actuators, if they answer messages."""
    for slot in slots:
        send, medium = slot.actuator, world.parts.get(Medium.path)
        if isinstance(send, Send) and isinstance(medium, Medium) and send.modem.table.acknowledges:
            base = slot.port.path.removesuffix("/send")
            yield _range_service(base, send), _asking(world, medium, slot, send)
            yield (
                Service(f"{base}/cancel_range", "Stop waiting for the range that was asked for."),
                _cancelling(medium, base),
            )


def _range_service(base: str, send: Send) -> Service:
    doc = (
        "Measure the distance to another modem: a packet goes there, and an answer comes back. The result has range (m), travel_time (there and "
        "back, s), snr, the direction if the modem has an array, and t_s of the arrival. Without an answer in time the call fails as timeout. The "
        "packet can get lost like any other, and is sent only once. Modifiers of the port do not apply."
    )
    arguments = (
        Argument("destination", "int", "address", "1", minimum=0, maximum=send.modem.table.highest_address),
        Argument(
            "timeout_s", "float", "how long to wait after the packet was sent; default: the time of an answer from max_range_m", "s",
            required=False, minimum=1e-3, maximum=_LONGEST_WAIT_S,
        ),
    )  # fmt: skip
    return Service(f"{base}/range", doc, arguments, long_running=True)


def _asking(world: World, medium: Medium, slot: ActuatorSlot, send: Send) -> Carry:
    base = slot.port.path.removesuffix("/send")
    where, received = f"{base}/range", f"{base}/received"

    def ask(args: Mapping[str, Json]) -> Later:
        if not slot.active or not world.sensors[received].active:
            path = received if slot.active else slot.port.path
            raise Refused("denied", f'"{path}" is deactivated: call {path}/activate first', where)
        destination, wait = int(str(args["destination"])), args["timeout_s"]
        fault = send.objection_to_range(destination)
        if fault is not None:
            raise Refused(fault.code, f'"{base}" {fault.text}', where)
        return medium.ask(received, destination, 0.0 if wait is None else float(str(wait)))

    return ask


def _cancelling(medium: Medium, base: str) -> Callable[[Mapping[str, Json]], Json]:
    def cancel(_: Mapping[str, Json]) -> Json:
        medium.cancel(f"{base}/received")
        return None

    return cancel
