"""The vehicle's modem as TUNNEL messages: payloads from ground stations go out through the water, and received data goes to all."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Buffer, Port, Sample
from uwserver_adapters.mavlink.vehicle.bridge import WARNING, Bridge, command
from uwserver_adapters.mavlink.wire.dialect import Fields, MavlinkMessage

ADDRESSED = 32_768
"""Payload types from this one on are free for any use. This number plus an address is for that modem, or from it. Type 0 is for all modems."""
LONGEST = 128
"""Bytes that a TUNNEL carries."""


class Tunnel:
    """The first acoustic modem of a vehicle. Runs on the loop thread.

    Args:
        context: the world.
        vehicle: name of the vehicle.
        bridge: the way to ground stations.
    """

    def __init__(self, context: AdapterContext, vehicle: str, bridge: Bridge) -> None:
        self._context, self._vehicle, self._bridge = context, vehicle, bridge
        self._peer = Conversation(context, "ground station")
        self._received: Port | None = None
        self.open_ports()

    def open_ports(self) -> None:
        """Find the modem again."""
        ports = self._context.ports.values()
        mine = (p for p in ports if p.message == "AcousticPacket" and p.path.startswith(f"{self._vehicle}/"))
        self._received = next((port for port in mine if port.direction == "sensor"), None)

    @property
    def subscriptions(self) -> Collection[str]:
        """The port of received data; none without a modem."""
        return () if self._received is None else (self._received.path,)

    def take(self, message: MavlinkMessage) -> None:
        """Send the payload of a TUNNEL through the water. A refusal is counted, and sent as STATUSTEXT."""
        if self._received is None:
            self._bridge.counters["tunnel_without_modem"] += 1
            return
        kind, size = message.integer("payload_type"), message.integer("payload_length")
        row = message.array("payload")
        if (kind and kind < ADDRESSED) or size > len(row):  # another protocol's type, or a payload shorter than it says
            self._bridge.counters["tunnel_type" if size <= len(row) else "tunnel_length"] += 1
            return
        value: dict[str, object] = {"data": bytes(int(entry) for entry in row[:size])}
        if kind:
            value["destination"] = float(kind - ADDRESSED)
        command(self._peer, self._received.path.removesuffix("received") + "send", value, self._answered)

    def _answered(self, reason: str) -> None:
        if reason:
            self._bridge.counters["refused"] += 1
            self._bridge.tell(WARNING, reason.replace(f'"{self._vehicle}/', '"'))

    def put(self, samples: Sequence[Sample]) -> None:
        """Send what was received, in pieces of 128 bytes."""
        port = self._received
        for sample in samples:
            if port is None or sample.port != port.path:
                continue
            values = dict(zip([field.name for field in port.fields], sample.value, strict=True))
            data = values["data"]
            if values["event"] != "data" or not isinstance(data, Buffer):
                continue
            for k in range(0, len(data.data), LONGEST):
                piece = data.data[k : k + LONGEST]
                fields: Fields = {
                    "target_system": 0, "target_component": 0, "payload_type": ADDRESSED + int(str(values["source"])),
                    "payload_length": len(piece), "payload": tuple(piece.ljust(LONGEST, b"\0")),
                }  # fmt: skip
                self._bridge.send("TUNNEL", fields)
