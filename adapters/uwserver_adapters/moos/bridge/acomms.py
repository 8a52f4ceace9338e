"""A vehicle's modem behind the variables of MOOS' modem drivers: ACOMMS_TRANSMIT_DEST and _DATA in, ACOMMS_RECEIVED_* out."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from uwserver.ports import Buffer, Port, Refused, Sample

DESTINATION, TEXT, BINARY = "ACOMMS_TRANSMIT_DEST", "ACOMMS_TRANSMIT_DATA", "ACOMMS_TRANSMIT_DATA_BINARY"
SOURCE_ID, DEST_ID, DATA = "ACOMMS_RECEIVED_SOURCE_ID", "ACOMMS_RECEIVED_DEST_ID", "ACOMMS_RECEIVED_DATA"


class Acomms:
    """The acoustic modem of a vehicle. It sends to the last destination that was written, or to all.

    Attributes:
        names: variables that mean something here; none without a modem.
        received, send: paths of the modem's ports; "" without a modem.
    """

    def __init__(self) -> None:
        self._destination: float | None = None
        self.find({}, "")

    def find(self, ports: Mapping[str, Port], vehicle: str) -> None:
        """Look for the first acoustic modem of a vehicle; "" stands for no vehicle."""
        found = [p for p in ports.values() if p.message == "AcousticPacket" and p.path.startswith(f"{vehicle}/")]
        port = next((port for port in found if vehicle and port.direction == "sensor"), None)
        self.names = () if port is None else (DESTINATION, TEXT, BINARY)
        self.received = "" if port is None else port.path
        self.send = "" if port is None else port.path.removesuffix("received") + "send"
        self._fields = () if port is None else tuple([field.name for field in port.fields])

    def hear(self, name: str, value: float | str | bytes) -> dict[str, object] | None:
        """Return the command that a variable causes; None for a destination, which is only kept.

        Raises:
            Refused: a text as destination, or a number as data.
        """
        if name == DESTINATION:
            if not isinstance(value, float | int):
                raise Refused("bad_argument", f"{DESTINATION} must be a number: an address, or -1 for all", name)
            self._destination = None if value < 0 else float(value)
            return None
        if isinstance(value, float | int):
            raise Refused("bad_argument", f"{name} must be a text, not a number: there is nothing to send", name)
        data = value.encode() if isinstance(value, str) else value
        return {"data": data} if self._destination is None else {"data": data, "destination": self._destination}

    def pairs(self, sample: Sample) -> list[tuple[str, float | str]]:
        """Return the variables of a message that was received: the data last, after all that describes them. Bytes that are no printable ASCII text
        become JSON."""
        told = dict(zip(self._fields, sample.value, strict=True))
        data = told["data"]
        if told["event"] != "data" or not isinstance(data, Buffer):
            return []
        text = data.data.decode("latin-1")
        plain = text if text.isascii() and text.isprintable() else msgspec.json.encode(data).decode()
        return [(SOURCE_ID, float(str(told["source"]))), (DEST_ID, float(str(told["destination"]))), (DATA, plain)]
