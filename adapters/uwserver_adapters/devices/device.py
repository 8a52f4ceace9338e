"""The contract of a simulated device: bytes from its peers in, bytes for its peers out. Nothing here knows a socket."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Protocol, TypeVar

from msgspec import Meta

from uwserver.adapter import AdapterContext, CannotServe, Lines, TooLong, address_text, port_of
from uwserver.ports import Port, Progress, Refused, Sample, Value
from uwserver.ports import Reply as Answer
from uwserver.table import Count, Name, PortNumber, Table

Reply = Callable[[bytes], None]
"""Sends bytes to the peer that asked, if it is still connected. May be called later."""
REQUESTS_PER_S = 200
"""Messages of one peer that are taken in a second of wall time. The makers' own clients send a few tens."""

T = TypeVar("T")


@dataclass(frozen=True)
class Garbage:
    """Bytes that are no message of the protocol; `text` says why."""

    text: str


@dataclass(frozen=True)
class Report:
    """A message for some peers only, from a device that says different things by TCP and by UDP.

    Attributes:
        data: the message.
        by_datagram: send it by UDP only; otherwise by TCP and serial line only.
    """

    data: bytes
    by_datagram: bool


class Reader(Protocol):
    """Splits the bytes of one peer into messages."""

    def receive(self, data: bytes) -> None:
        """Store bytes, in pieces of any size."""

    def next_event(self) -> object:
        """Return the next message or `Garbage`; None until more bytes come."""


class Device(Protocol):
    """A device. All its peers share its state, as the peers of a real one do.

    Attributes:
        subscriptions: paths of the ports that it reads.
    """

    subscriptions: Collection[str]

    def reader(self) -> Reader:
        """Return a reader for the bytes of a new peer."""

    def take(self, message: Any, reply: Reply) -> str:
        """Carry out a message of a peer.

        Returns:
            Why the device cannot obey, which is counted as an error; "" where it obeys, or has told the peer itself.
        """

    def see(self, sample: Sample) -> Sequence[bytes | Report]:
        """Take a sample of a wanted port. Returns messages for all peers."""

    def reset(self) -> None:
        """Start again: the time of the world was set back."""


class DeviceTable(Table, tag_field="kind", kw_only=True, frozen=True):
    """The keys that the table of every device has. At least one address is needed.

    Attributes:
        bind: address to listen at. Devices know no passwords: whoever reaches another address than loopback commands the device.
        tcp_port: TCP port to listen at; 0 takes a free one.
        udp_port: UDP port to listen at; 0 takes a free one. A peer that sends a datagram there hears the device for `udp_lease_s` after its
            last datagram.
        udp_to: addresses ("127.0.0.1:10110") to which the device sends all its reports by UDP. Addresses of other machines need
            another `bind` too.
        udp_lease_s: wall time, s.
        serial: path of a serial line or pseudo-terminal. Its speed stays as the system has set it.
        max_clients: TCP peers, and likewise UDP peers, at the same time.
        queue_bytes: bytes that may wait for a slow peer; newer reports to it are dropped above that.
    """

    bind: Name = "127.0.0.1"
    tcp_port: PortNumber | None = None
    udp_port: PortNumber | None = None
    udp_to: tuple[Name, ...] = ()
    udp_lease_s: Annotated[float, Meta(gt=0)] = 10.0
    serial: Name | None = None
    max_clients: Count = 8
    queue_bytes: Annotated[int, Meta(ge=1024)] = 1 << 18

    def __post_init__(self) -> None:
        """Raise ValueError where the table has no address, or a wrong one."""
        for address in self.udp_to:
            host_and_port(address)
        if self.tcp_port is None and self.udp_port is None and not self.udp_to and self.serial is None:
            raise ValueError("the device has no address: give tcp_port, udp_port, udp_to or serial")

    def told(self) -> str:
        """Return sensors and addresses as text: ``of rov/gps (gps), rov/ahrs (heading) at tcp 127.0.0.1:10110``."""
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
        """Return the device of this table.

        Raises:
            CannotServe: the table names a sensor that does not exist or does not fit.
        """
        raise NotImplementedError


def host_and_port(address: str) -> tuple[str, int]:
    """Split ``host:port``. Raises ValueError where the text is no such address."""
    host, colon, port = address.rpartition(":")
    if not (host and colon and port.isascii() and port.isdigit() and 0 < int(port) <= 65535):
        raise ValueError(f'udp_to: "{address}" is no address: write host:port, as 127.0.0.1:10110')
    return host.strip("[]"), int(port)


class DeviceInput:
    """A sensor that a key of the table names. Gives the fields of its samples by name.

    Args:
        role: key of the table, for errors.
        path: path of the port, with its vehicle.
        ports: those of the context.
        fields: fields that the sensor must have.
        optional: fields that are read where the sensor has them.

    Attributes:
        path: path of the port.
        rate_hz: rate of the port; 1 where it states none.

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
        if missing := [name for name in fields if name not in places]:
            there = ", ".join(places)
            raise CannotServe(
                f'{role}: "{path}" has no field "{missing[0]}", it has: {there}; name a sensor that has it'
            )
        self.path = port.path
        self.rate_hz = port.rate_hz or 1.0
        self._places = {name: places[name] for name in (*fields, *optional) if name in places}

    def values(self, sample: Sample) -> dict[str, Value]:
        """Return field name -> value; None where the sensor has no value."""
        return {name: sample.value[place] for name, place in self._places.items()}


def set_at_sensor(
    context: AdapterContext, source: DeviceInput, settings: Mapping[str, object], done: Callable[[str], None]
) -> None:
    """Call the service `set` of a sensor.

    Args:
        context: context of the adapter.
        source: the sensor.
        settings: argument name -> value.
        done: gets the text of the fault, or "" once the sensor has taken the settings. May be called before this returns.
    """

    def answered(answer: Answer | Progress) -> None:
        if isinstance(answer, Answer):
            done("" if answer.fault is None else answer.fault.text)

    try:
        context.call(f"{source.path}/set", settings, context.name, answered)
    except Refused as refused:
        done(refused.fault.text)


class LineReader(Generic[T]):
    """Splits a stream into lines of text. A line that is too long is garbage.

    Args:
        limit: longest line, bytes.
        parse: turns a line, without its end, into a message or `Garbage`.
    """

    def __init__(self, limit: int, parse: Callable[[bytes], T]) -> None:
        self._lines = Lines(limit)
        self._parse = parse

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._lines.receive(data)

    def next_event(self) -> T | Garbage | None:
        """Return the next message; None until more bytes come."""
        try:
            line = self._lines.next_line()
        except TooLong as error:
            return Garbage(str(error))
        return None if line is None else self._parse(line)


class BinaryReader(Generic[T]):
    """Splits a stream into binary messages that begin with a fixed mark. Derived classes write `parse`.

    Bytes between messages are garbage, reported once for each piece. After a broken message the search begins again at its second byte.

    Attributes:
        mark: first bytes of each message.
        noun: what the messages are called, for errors.
    """

    mark: bytes
    noun: str

    def __init__(self) -> None:
        self._buffer = bytearray()

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._buffer += data

    def next_event(self) -> T | Garbage | None:
        """Return the next message; None until more bytes come."""
        buffer = self._buffer
        start = buffer.find(self.mark)
        if start < 0:
            # The last byte may be the first one of a mark whose rest has yet to come.
            start = len(buffer) - buffer.endswith(self.mark[:1])
        if start > 0:
            skipped = bytes(buffer[:start])
            del buffer[:start]
            if not self.may_skip(skipped):
                return Garbage(f"{start} bytes are no {self.noun}")
        size, event = self.parse(buffer)
        del buffer[:size]
        return event

    def may_skip(self, data: bytes) -> bool:
        """Return whether such bytes between two messages are no fault."""
        return False

    def parse(self, buffer: bytearray) -> tuple[int, T | Garbage | None]:
        """Read the message at the start of the buffer, which is empty or begins with (a part of) the mark.

        Returns:
            How many bytes to remove, and the message: (0, None) until it is complete, (1, `Garbage`) where it is broken.
        """
        raise NotImplementedError
