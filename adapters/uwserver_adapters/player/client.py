"""One client: it asks which devices there are, opens some, hears their data, commands and asks."""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping
from typing import Any, Protocol

import msgspec

from uwserver.adapter import AdapterContext, Connection, Conversation, Peers, RateMeter
from uwserver.ports import Fault, Refused, Reply
from uwserver_adapters.player import wire
from uwserver_adapters.player.config import PlayerConfig
from uwserver_adapters.player.devices import Device
from uwserver_adapters.player.wire import ACK, CMD, DATA, NACK, OPAQUE, PLAYER, REQ, SYNCH, Message

Address = tuple[int, int]
"""Interface, and number in it."""


class Server(Protocol):
    """The adapter, as its clients see it."""

    context: AdapterContext
    config: PlayerConfig

    @property
    def devices(self) -> Mapping[Address, Device]:
        """All devices, by address."""

    def timestamp(self, t_ns: int | None = None) -> float:
        """Seconds since 1970 of a simulation time, or of the newest there was."""

    def follow(self) -> None:
        """A client hears other devices than before."""

    def complain(self, text: str) -> None:
        """A command was not taken, which Player does not answer."""


class Client(Connection):
    """A client.

    Args:
        server: the adapter.
        peers: all clients.
        name: of this one, for the world.

    Attributes:
        opened_devices: addresses of the devices that it has opened.
    """

    def __init__(self, server: Server, peers: Peers[Any], name: str) -> None:
        super().__init__(peers, server.config.hello_timeout_s)
        self.opened_devices: set[Address] = set()
        self._server = server
        self._name = name
        self._decoder = wire.Decoder()
        self._conversation = Conversation(server.context, name)
        self._rate = RateMeter(server.config.max_requests_per_s)
        self._here = (0, 0)
        self._is_pulled = self._is_asked = False
        self._newest: dict[tuple[int, int, int], bytes] = {}

    # -- Connection -----------------------------------------------------------------------------------------------------------------------

    def opened(self) -> None:
        """A server speaks first."""
        here = self.transport.get_extra_info("sockname")
        if isinstance(here, tuple) and ":" not in here[0]:
            self._here = (struct.unpack("<I", socket.inet_aton(here[0]))[0], here[1])
        self.write(wire.BANNER)

    def refused(self, fault: Fault) -> bytes:
        """Player has no words for it."""
        return b""

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._decoder.receive(data)

    def step(self) -> bool:
        """Take the next message."""
        try:
            message = self._decoder.next_event()
        except Refused as refused:
            self.peers.refusals.note(refused.fault.code, refused.fault.text)
            self.farewell(b"")
            return False
        if message is None or not self.admit():
            return False
        try:
            if not self._rate.take(self.loop.time()):
                raise Refused("overload", f"more than {self._rate.most} messages a second: max_requests_per_s")
            self._take(message)
        except Refused as refused:
            self._refuse(message, refused.fault)
        return True

    def quiet_until(self) -> float:
        """Who floods is not read until its second is over."""
        return self._rate.end if self._rate.is_flooded(self.loop.time()) else 0.0

    def half_closed(self) -> None:
        """On TCP, who has gone looks like who only listens on: what would take long is ended, the rest is still answered."""
        self._conversation.end_calls()

    @property
    def is_owed(self) -> bool:
        """Answers are to come."""
        return self._conversation.owed.count > 0

    def closed(self) -> None:
        """It went. What it commanded stands until the actuator's time-out."""
        self._conversation.close()
        self.opened_devices.clear()
        self._server.follow()

    # -- messages -------------------------------------------------------------------------------------------------------------------------

    def _take(self, message: Message) -> None:
        if message.interface == PLAYER:
            if message.type != REQ:
                raise Refused("invalid_request", "the interface player takes requests")
            self._of_server(message)
            return
        device = self._device(message.interface, message.number)
        if (device.interface, device.number) not in self.opened_devices:
            raise Refused("denied", f"{device.name} is not open: ask for it with PLAYER_PLAYER_REQ_DEV")
        if device.take is None or message.type not in (CMD, REQ):
            raise Refused("denied", f"{device.name} is a sensor: it takes nothing")
        self._carry_out(message, device)

    def _device(self, interface: int, index: int) -> Device:
        device = self._server.devices.get((interface, index))
        if device is None:
            raise Refused("unknown_port", f"there is no device {interface}:{index}")
        return device

    def _carry_out(self, message: Message, device: Device) -> None:
        assert device.take is not None
        ask = device.take(message)

        def answered(reply: Reply) -> None:
            if reply.fault is not None:
                self._refuse(message, reply.fault)
            elif message.type == REQ:
                told = {"result": reply.result} if message.interface == OPAQUE else None
                self._answer(message, b"" if told is None else wire.octets(msgspec.json.encode(told)))
            self.finish_if_done()

        if ask.port:
            self._conversation.command(ask.port, ask.args, answered)
        elif ask.service:
            self._conversation.call(ask.service, ask.args, answered)
            if self.is_half_open:
                self._conversation.end_calls()
        else:
            self._answer(message, b"")

    def _refuse(self, message: Message, fault: Fault) -> None:
        """A request is answered, with the text where it is opaque; a command is not, by Player's rules."""
        if message.type != REQ:
            self._server.complain(f"{self._name}: {fault.text}")
            return
        self._server.context.stats.errors += 1
        self._server.context.stats.last_error = f"{self._name}: {fault.text}"[:300]
        said = {"error": fault.text, "code": fault.code}
        self._answer(message, wire.octets(msgspec.json.encode(said)) if message.interface == OPAQUE else b"", NACK)

    def _answer(self, message: Message, body: bytes, kind: int = ACK) -> None:
        if self.is_closing:
            return
        if self.waiting > self._server.config.queue_bytes:
            self._server.context.stats.last_error = f"{self._name} did not read its answers and was disconnected"
            self.abort()
            return
        head = message._replace(type=kind, body=body, timestamp=self._server.timestamp())
        self.write(wire.encode(head))

    # -- the interface player ---------------------------------------------------------------------------------------------------------------

    def _of_server(self, message: Message) -> None:
        if message.subtype == wire.DEVLIST:
            there = list(self._server.devices)
            self._answer(
                message, wire.u32(len(there), len(there)) + b"".join(wire.address(*self._here, *at) for at in there)
            )
        elif message.subtype == wire.DRIVERINFO:
            device = self._device(wire.read_u32(message.body, 8), wire.read_u32(message.body, 12))
            self._answer(message, self._named(device))
        elif message.subtype == wire.DEV:
            self._have(message)
        elif message.subtype == wire.DATAMODE:
            mode = wire.read_u32(message.body)
            if mode not in (wire.PUSH, wire.PULL):
                raise Refused("bad_argument", f"no mode of delivery {mode}: 1 pushes, 2 pulls")
            self._is_pulled = mode == wire.PULL
            self._answer(message, b"")
        elif message.subtype == wire.PULL_DATA:
            self._answer(message, b"")
            self._is_asked = True
            self.deliver()
        elif (
            message.subtype == wire.ADD_REPLACE_RULE
        ):  # the newest of each kind is all that waits here, as such rules ask
            self._answer(message, b"")
        else:
            raise Refused("unknown_service", f"no request {message.subtype} of the interface player")

    def _named(self, device: Device) -> bytes:
        """Address and driver of a device."""
        name = device.name.encode()[: wire.NAME_BYTES - 1] + b"\0"
        return wire.address(*self._here, device.interface, device.number) + wire.octets(name)

    def _have(self, message: Message) -> None:
        """Open a device, or close it."""
        address = wire.read_u32(message.body, 8), wire.read_u32(message.body, 12)
        access = wire.read_u32(message.body, 16)
        device = self._server.devices.get(address)
        if device is None or access not in (wire.OPEN, wire.CLOSE):
            self._answer(message, message.body[:16] + wire.u32(wire.ERROR, 0, 0), NACK)
            return
        if access == wire.OPEN:
            self.opened_devices.add(address)
        else:
            self.opened_devices.discard(address)
        self._server.follow()
        named = self._named(device)
        self._answer(message, named[:16] + wire.u32(access) + named[16:])

    # -- data -----------------------------------------------------------------------------------------------------------------------------

    def tell(self, device: Device, subtype: int, data: bytes) -> None:
        """Data of a device that it has opened, a whole message; the newest waits for who pulls."""
        if self._is_pulled:
            self._newest[device.interface, device.number, subtype] = data
        else:
            self._send(data)

    def deliver(self) -> None:
        """Where data were asked for and some are there: all of them, then their end."""
        if not (self._is_asked and self._newest) or self.is_closing:
            return
        for data in self._newest.values():
            self._send(data)
        self._newest.clear()
        self._is_asked = False
        self.write(wire.encode(Message(PLAYER, 0, SYNCH, 1, timestamp=self._server.timestamp())))

    def _send(self, data: bytes) -> None:
        stats = self._server.context.stats
        if self.is_closing:
            return
        if self.waiting > self._server.config.queue_bytes:
            stats.dropped += 1
            return
        stats.samples_sent += 1
        stats.bytes_sent += len(data)
        self.write(data)


def data_message(device: Device, subtype: int, body: bytes, timestamp: float) -> bytes:
    """What a device tells, for all who hear it."""
    return wire.encode(Message(device.interface, device.number, DATA, subtype, body, timestamp))
