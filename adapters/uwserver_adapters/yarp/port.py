"""One port of the YARP network: what it stands for in the world, its readers, and its writers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol

from uwserver.adapter import AdapterContext
from uwserver.adapter.pictures import picture_place
from uwserver.ports import Port, Sample, Service, matches
from uwserver_adapters.yarp import codec, wire
from uwserver_adapters.yarp.bottle import Value, Vocab
from uwserver_adapters.yarp.wire import Carrier

CLOCK = "clock"
Role = Literal["sensor", "actuator", "services", "clock"]


class Writer(Protocol):
    """A connection by which another port sends to a port.

    Attributes:
        name: name of the other port.
        carrier: carrier of the connection.
    """

    name: str
    carrier: Carrier

    def close(self) -> None:
        """End the connection."""


class Reader(Writer, Protocol):
    """A connection by which another port hears a port."""

    def send_sample(self, message: bytes) -> None:
        """Send it a message, unless it is too slow."""


class YarpPort:
    """A port.

    Args:
        name: in the network.
        role: what it stands for.
        port: the sensor or actuator of the world.
        services: services of the world, by the name under which they are called.
        is_vector: send a sensor's samples as one row of numbers.
        image_place: index of the only field of a sensor that is sent, as a picture; None to send all fields.

    Attributes:
        name, role, port, services: as given.
        readers, writers: connections, in the order in which they came.
    """

    def __init__(
        self, name: str, role: Role, port: Port | None = None, services: Mapping[str, Service] | None = None,
        is_vector: bool = False, image_place: int | None = None,
    ) -> None:  # fmt: skip
        self.name = name
        self.role: Role = role
        self.port = port
        self.services = services or {}
        self.readers: dict[object, Reader] = {}
        self.writers: dict[object, Writer] = {}
        self._form = codec.vector if is_vector else codec.bottle
        self._image_place = image_place

    @property
    def is_output(self) -> bool:
        """Whether this port sends anything."""
        return self.role in ("sensor", "clock")

    # -- sending --------------------------------------------------------------------------------------------------------------------------

    def tell(self, sample: Sample) -> int:
        """Send a sample to all readers; return how often it was encoded: once for text carriers and once for all others."""
        assert self.port is not None
        command = f"D {codec.envelope(sample)}"
        if self._image_place is not None:
            return self._send_image(command, sample.value[self._image_place])
        return self._send(command, self._form(self.port, sample))

    def tell_time(self, t_ns: int) -> int:
        """Send the time to all readers, as `tell`."""
        return self._send("D", codec.clock(t_ns))

    def _send_image(self, command: str, picture: object) -> int:
        """Send a picture to readers on binary carriers; text carriers have no pictures."""
        readers = [reader for reader in self.readers.values() if not wire.is_text(reader.carrier)]
        body = codec.image(picture) if readers else None
        if body is None:
            return 0
        message = wire.message(False, command, body)
        for reader in readers:
            reader.send_sample(message)
        return 1

    def _send(self, command: str, values: Sequence[Value]) -> int:
        messages: dict[bool, bytes] = {}
        encoded = 0
        for reader in list(self.readers.values()):
            text = wire.is_text(reader.carrier)
            if text not in messages:
                messages[text] = wire.message(text, command, wire.payload(text, values))
                encoded += 1
            reader.send_sample(messages[text])
        return encoded

    # -- connections ----------------------------------------------------------------------------------------------------------------------

    def listed(self, direction: str, name: str) -> list[Value]:
        """Return the answer to ``[list] [out]`` or ``[list] [in]``: names, or the details of the connection that is named."""
        ends: Sequence[Reader | Writer] = [*(self.writers if direction == "in" else self.readers).values()]
        if not name:
            return [end.name for end in ends]
        for end in ends:
            if end.name == name:
                pair = (name, self.name) if direction == "in" else (self.name, name)
                return [["from", pair[0]], ["to", pair[1]], ["carrier", end.carrier]]
        return []

    def disconnect(self, name: str) -> str:
        """End the connections to and from another port; return a text about it, "" if there was none."""
        ended = ""
        for end in [each for each in [*self.readers.values(), *self.writers.values()] if each.name == name]:
            direction = ("to", "Removed") if end in self.readers else ("from", "Removing")
            ended = f"{direction[1]} connection {direction[0]} {name}"
            self.readers.pop(end, None)
            self.writers.pop(end, None)
            end.close()
        return ended

    def close(self) -> None:
        """End all connections."""
        for end in [*self.readers.values(), *self.writers.values()]:
            end.close()


HELP: Sequence[Value] = (
    codec.MANY,
    "[help]                  # give this help",
    "[ver]                   # report protocol version information",
    "[add] $portname         # add an output connection",
    "[add] $portname $car    # add an output with a given protocol",
    "[del] $portname         # remove an input or output connection",
    "[list] [in]             # list input connections",
    "[list] [out]            # list output connections",
    "[list] [in]  $portname  # give details for input",
    "[list] [out] $portname  # give details for output",
)
VERSION: Sequence[Value] = (Vocab("ver"), 1, 2, 3)
"""Version of the administrative commands in YARP 3 and 4."""


def ports_of(context: AdapterContext, prefix: str, chosen: Sequence[str], vectors: Sequence[str]) -> list[YarpPort]:
    """Return all ports that the network should have; the first is the clock.

    Args:
        context: the world.
        prefix: prefix of all names.
        chosen: patterns of the world's ports that are served.
        vectors: patterns of sensors that are sent as vectors.
    """
    found = [YarpPort(f"{prefix}/{CLOCK}", "clock")]
    for path, port in context.ports.items():
        if any(matches(pattern, path) for pattern in chosen):
            if port.direction == "sensor":
                is_vector = any(matches(pattern, path) for pattern in vectors)
                found.append(YarpPort(f"{prefix}/{path}:o", "sensor", port, is_vector=is_vector))
                place = picture_place(port)
                if place is not None:
                    name = f"{prefix}/{path}/{port.fields[place].name}:o"
                    found.append(YarpPort(name, "sensor", port, image_place=place))
            else:
                found.append(YarpPort(f"{prefix}/{path}:i", "actuator", port))
    groups: dict[str, dict[str, Service]] = {}
    for path, service in context.services.items():
        owner, _, name = path.partition("/")
        groups.setdefault(owner, {})[name] = service
    return found + [YarpPort(f"{prefix}/{owner}/rpc:i", "services", services=own) for owner, own in groups.items()]
