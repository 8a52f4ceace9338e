"""Lamps and camera mount of the vehicle in the world: they follow what ground stations tell the payload, where the vehicle has them."""

from __future__ import annotations

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Port, Refused, Reply
from uwserver_adapters.mavlink.vehicle.autopilot import SOURCE
from uwserver_adapters.mavlink.vehicle.payload import Payload
from uwserver_adapters.mavlink.wire.codec import from_degrees


class Fittings:
    """Commands them when something changed, so that others may command them in between. Loop thread.

    All lamps of a vehicle shine as the brighter of ArduSub's two lights: those of a BlueROV hang on one output.
    """

    def __init__(self, context: AdapterContext, vehicle: str, payload: Payload) -> None:
        """context: the world; `vehicle`: its name; `payload`: what was told."""
        self._context, self._root, self._payload = context, f"{vehicle}/", payload
        self._peer = Conversation(context, SOURCE, queue="payload")
        self._level, self._tilt = 0.0, 0.0

    def tick(self) -> None:
        """To be called some twenty times a second of wall time."""
        level, tilt = max(self._payload.lights), self._payload.tilt
        if level != self._level:
            self._level = level
            for port in self._ports("lamps"):
                self._command(port, [level] * port.fields[0].size)
        if tilt != self._tilt:
            self._tilt = tilt
            for port in self._ports("camera_mount"):
                field = port.fields[0]
                angle = from_degrees(tilt)
                self._command(port, min(max(angle, field.minimum or 0.0), field.maximum or 0.0))

    def _ports(self, kind: str) -> list[Port]:
        ports = self._context.ports.values()
        return [port for port in ports if port.kind == kind and port.path.startswith(self._root)]

    def _command(self, port: Port, value: object) -> None:
        try:
            self._peer.command(port.path, {port.fields[0].name: value}, self._told)
        except Refused as refused:
            self._count(refused.fault.text)

    def _told(self, reply: Reply) -> None:
        if reply.fault is not None:
            self._count(reply.fault.text)

    def _count(self, text: str) -> None:
        self._context.stats.errors += 1
        self._context.stats.last_error = text
