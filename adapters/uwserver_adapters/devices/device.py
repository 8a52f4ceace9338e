"""What a device is here: bytes of its peers in, bytes for its peers out. Knows no socket."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

from msgspec import Meta

from uwserver.adapter import AdapterContext, CannotServe, Lines, TooLong, address_text, port_of
from uwserver.ports import Port, Sample, Value
from uwserver.table import Name, Table

PortNumber = Annotated[int, Meta(ge=0, le=65535)]
Reply = Callable[[bytes], None]
"""Sends to the peer that asked, if it is still there. May be called later."""
REQUESTS_PER_S = 200
"""Messages of one peer that are taken in a second, wall time; the makers' own clients send a few tens."""


@dataclass(frozen=True)
class Garbage:
    """Bytes that are no message of the protocol; `text` says why."""

    text: str


@dataclass(frozen=True)
class Report:
    """What peers of some ways get of a device that says different things by TCP and by UDP.

    Attributes:
        data: the message.
        by_datagram: by UDP alone; otherwise by TCP and serial line alone.
    """

    data: bytes
    by_datagram: bool


class Reader(Protocol):
    """The bytes of one peer, to messages."""

    def receive(self, data: bytes) -> None:
        """Store bytes, in pieces of any size."""

    def next_event(self) -> object:
        """The next message or `Garbage`; None until more bytes come."""


class Device(Protocol):
    """One device: what it knows is shared by all its peers, as those of a real one share it.

    Attributes:
        wanted: paths of the ports that it reads.
    """

    wanted: Collection[str]

    def reader(self) -> Reader:
        """For the bytes of a new peer."""

    def take(self, message: Any, reply: Reply) -> str:
        """A message of a peer. Returns why it cannot be obeyed, which is counted; "" where it is, or where the peer itself was told."""

    def see(self, sample: Sample) -> Sequence[bytes | Report]:
        """A sample of a port that it wants. Returns messages for all peers."""

    def reset(self) -> None:
        """The time of the world begins again."""


class DeviceTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """What the table of any device may hold. A device without an address serves nobody.

    Attributes:
        bind: address to listen at. Devices know no passwords: whoever reaches another address than loopback commands the device.
        tcp_port: TCP port to listen at; 0 takes a free one.
        udp_port: UDP port to listen at; 0 takes a free one. Who sends there hears the device for `udp_lease_s` after its last datagram.
        udp_to: addresses ("127.0.0.1:10110") to which all that the device says of itself is sent by UDP; those of other
            machines need another `bind` too.
        udp_lease_s: wall time.
        serial: path of a serial line or pseudo-terminal; its speed stays as the system has set it.
        max_clients: of each of TCP and UDP.
        queue_bytes: that wait for a slow peer; newer reports are dropped above.
    """

    bind: Name = "127.0.0.1"
    tcp_port: PortNumber | None = None
    udp_port: PortNumber | None = None
    udp_to: tuple[Name, ...] = ()
    udp_lease_s: Annotated[float, Meta(gt=0)] = 10.0
    serial: Name | None = None
    max_clients: Annotated[int, Meta(ge=1)] = 8
    queue_bytes: Annotated[int, Meta(ge=1024)] = 1 << 18

    def __post_init__(self) -> None:
        """ValueError where it has no address, or a wrong one."""
        for address in self.udp_to:
            host_and_port(address)
        if self.tcp_port is None and self.udp_port is None and not self.udp_to and self.serial is None:
            raise ValueError("the device has no address: give tcp_port, udp_port, udp_to or serial")

    def told(self) -> str:
        """Which sensors it serves, and where: ``of rov/gps (gps), rov/ahrs (heading) at tcp 127.0.0.1:10110``."""
        own = (name for name in self.__struct_fields__ if name not in DeviceTable.__struct_fields__)
        said = ((name, getattr(self, name)) for name in own)
        sensors = [f"{value} ({name})" for name, value in said if isinstance(value, str) and "/" in value]
        ways = [
            f"{way} {address_text(self.bind, port) if port else f'{self.bind}, a free port'}"
            for way, port in (("tcp", self.tcp_port), ("udp", self.udp_port))
            if port is not None
        ]
        ways += [f"udp to {address}" for address in self.udp_to]
        ways += [f"serial {self.serial}"] if self.serial is not None else []
        return f"of {', '.join(sensors) or 'no sensor'} at {', '.join(ways)}"

    def build(self, context: AdapterContext) -> Device:
        """The device.

        Raises:
            CannotServe: the table names what is not there.
        """
        raise NotImplementedError


def host_and_port(address: str) -> tuple[str, int]:
    """``host:port`` in two; ValueError where it is none."""
    host, colon, port = address.rpartition(":")
    if not (host and colon and port.isascii() and port.isdigit() and 0 < int(port) <= 65535):
        raise ValueError(f'udp_to: "{address}" is no address: write host:port, as 127.0.0.1:10110')
    return host.strip("[]"), int(port)


class Source:
    """A sensor that a key of the table names, its fields by name.

    Args:
        role: key of the table, for errors.
        path: of the port, with its vehicle.
        ports: those of the context.
        fields: that it must have.
        optional: that it may have.

    Raises:
        CannotServe: there is no such sensor, or it lacks a field.
    """

    def __init__(
        self,
        role: str,
        path: str,
        ports: Mapping[str, Port],
        fields: Sequence[str],
        optional: Sequence[str] = (),
    ) -> None:
        vehicle, _, name = path.partition("/")
        port = port_of(role, name, ports, vehicle, "sensor")
        places = {field.name: place for place, field in enumerate(port.fields)}
        missing = [name for name in fields if name not in places]
        if missing:
            there = ", ".join(places)
            raise CannotServe(
                f'{role}: "{path}" has no field "{missing[0]}", it has: {there}; name a sensor that has it'
            )
        self.path = port.path
        self.rate_hz = port.rate_hz or 1.0
        self._places = {name: places[name] for name in (*fields, *optional) if name in places}

    def values(self, sample: Sample) -> dict[str, Value]:
        """Field name -> value; None where the sensor has none."""
        return {name: sample.value[place] for name, place in self._places.items()}


class LineReader:
    """Lines of text; one that is too long, or holds what is no text, is garbage.

    Args:
        limit: longest line, bytes.
    """

    def __init__(self, limit: int) -> None:
        self._lines = Lines(limit)

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._lines.receive(data)

    def next_event(self) -> bytes | Garbage | None:
        """The next line; None until more bytes come."""
        try:
            return self._lines.next_line()
        except TooLong as error:
            return Garbage(str(error))
