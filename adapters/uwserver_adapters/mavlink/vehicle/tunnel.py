"""The vehicle's modem as TUNNEL messages: what ground stations or companions put in is sent through the water, and what is heard goes to all."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Buffer, Port, Refused, Reply, Sample
from uwserver_adapters.mavlink.vehicle.bridge import WARNING, Bridge
from uwserver_adapters.mavlink.wire.dialect import Fields, Message

ADDRESSED = 32_768
"""Payload types from here on are free for everybody: this plus an address is for that modem, or from it. 0 is for all."""
LONGEST = 128
"""Bytes that a TUNNEL carries."""


class Tunnel:
    """The first acoustic modem of a vehicle. Loop thread."""

    def __init__(self, context: AdapterContext, vehicle: str, bridge: Bridge) -> None:
        """Of one vehicle.

        Args:
            context: the world.
            vehicle: its name.
            bridge: to ground stations.
        """
        self._context, self._vehicle, self._bridge = context, vehicle, bridge
        self._peer = Conversation(context, "ground station")
        self._received: Port | None = None
        self.open_ports()

    def open_ports(self) -> None:
        """Look for the modem again."""
        ports = self._context.ports.values()
        mine = (p for p in ports if p.kind == "acoustic_modem" and p.path.startswith(f"{self._vehicle}/"))
        self._received = next((port for port in mine if port.direction == "sensor"), None)

    @property
    def wanted(self) -> Collection[str]:
        """The port of what it hears; none without a modem."""
        return () if self._received is None else (self._received.path,)

    def hear(self, message: Message) -> None:
        """Send the payload of a TUNNEL; what cannot be sent is told as STATUSTEXT, and counted."""
        if self._received is None:
            self._bridge.counters["tunnel_without_modem"] += 1
            return
        kind, size = message.whole("payload_type"), message.whole("payload_length")
        row = message.row("payload")
        if (kind and kind < ADDRESSED) or size > len(row):  # another protocol's, or no payload as long as it says
            self._bridge.counters["tunnel_type" if size <= len(row) else "tunnel_length"] += 1
            return
        value: dict[str, object] = {"data": bytes(int(entry) for entry in row[:size])}
        if kind:
            value["destination"] = float(kind - ADDRESSED)
        try:
            self._peer.command(self._received.path.removesuffix("received") + "send", value, self._answered)
        except Refused as refused:
            self._refused(refused.fault.text)

    def _answered(self, reply: Reply) -> None:
        if reply.fault is not None:
            self._refused(reply.fault.text)

    def _refused(self, text: str) -> None:
        self._bridge.counters["refused"] += 1
        self._bridge.tell(WARNING, text.replace(f'"{self._vehicle}/', '"'))

    def put(self, samples: Sequence[Sample]) -> None:
        """Tell what was heard, in pieces of 128 bytes."""
        port = self._received
        for sample in samples:
            if port is None or sample.port != port.path:
                continue
            told = dict(zip([field.name for field in port.fields], sample.value, strict=True))
            data = told["data"]
            if told["event"] != "data" or not isinstance(data, Buffer):
                continue
            for k in range(0, len(data.data), LONGEST):
                piece = data.data[k : k + LONGEST]
                fields: Fields = {
                    "target_system": 0, "target_component": 0, "payload_type": ADDRESSED + int(str(told["source"])),
                    "payload_length": len(piece), "payload": tuple(piece.ljust(LONGEST, b"\0")),
                }  # fmt: skip
                self._bridge.send("TUNNEL", fields)
