"""The adapter `player`: a server of Player's protocol, for clients of libplayerc and others."""

from __future__ import annotations

import asyncio
import itertools
import socket
import struct
from collections.abc import Collection, Sequence
from typing import Literal

import msgspec

from uwserver.adapter import (
    STRANGERS,
    AdapterBase,
    AdapterContext,
    CannotServe,
    Connection,
    Conversation,
    OpenTable,
    Peers,
    address_text,
    serve_tcp,
    serving,
)
from uwserver.ports import Event, Fault, Refused, Reply, Sample
from uwserver.table import Count, PortNumber, Positive
from uwserver_adapters.player import codec, wire
from uwserver_adapters.player.codec import Ask, Device, devices_of
from uwserver_adapters.player.wire import ACK, CMD, DATA, NACK, OPAQUE, PLAYER, REQ, SYNCH, PlayerMessage


class PlayerConfig(OpenTable, tag="player", kw_only=True, frozen=True):
    """Attributes:
    port: TCP port; 0 takes a free one.
    pose: source of position3d: the autopilot's "estimate", or the "truth" (with truth = true).
    queue_bytes: bytes that may wait for a slow client; data are dropped above that.
    max_requests_per_s: messages of one client in a second; more are not read until the second is over.
    max_clients: connections.
    max_strangers: further connections that have said nothing valid yet.
    hello_timeout_s: wall time in which a client must have asked for something.
    """

    port: PortNumber = 6665
    pose: Literal["estimate", "truth"] = "estimate"
    queue_bytes: Count = 1 << 20
    max_requests_per_s: Count = 2000
    max_clients: Count = 64
    max_strangers: Count = STRANGERS
    hello_timeout_s: Positive = 10.0


Address = tuple[int, int]
"""Address of a device: interface, and number in it."""


class Server:
    """All devices, and the clients that have opened them. Devices of a new vehicle get new numbers, which may change when a vehicle is removed.

    Args:
        config: config of the adapter.
        context: the world.
        peers: all clients.

    Attributes:
        config, context, peers: as given.
        devices: all devices, by address.
    """

    def __init__(self, config: PlayerConfig, context: AdapterContext, peers: Peers[Client]) -> None:
        self.config, self.context, self.peers = config, context, peers
        self._by_port: dict[str, list[tuple[Device, list[Client]]]] = {}
        self._t_ns = 0
        self._find_devices()

    def _find_devices(self) -> None:
        self._epoch_ns = self.context.world.epoch_ns
        found = devices_of(self.context.ports, self._epoch_ns, self.config.pose)
        self.devices: dict[Address, Device] = {(device.interface, device.number): device for device in found}
        self.context.stats.details["devices"] = len(found)

    def timestamp(self, t_ns: int | None = None) -> float:
        """Return a simulation time, by default the newest one, as seconds since 1970."""
        return codec.timestamp(self._epoch_ns + (self._t_ns if t_ns is None else t_ns))

    def follow(self) -> None:
        """Find out again which clients get the samples of which port: a client has opened or closed a device, or devices have changed."""
        self._by_port = {}
        for address, device in self.devices.items():
            clients = [client for client in self.peers if address in client.opened_devices]
            for path in device.ports if clients else ():
                self._by_port.setdefault(path, []).append((device, clients))
        self.context.subscriptions_changed()

    def complain(self, text: str) -> None:
        """Log that a command was not taken, as Player does not answer commands."""
        self.peers.refusals.note_error("not taken", text)

    # -- uwserver.adapter.Subscriber ------------------------------------------------------------------------------------------------------

    @property
    def subscriptions(self) -> Collection[str]:
        """Paths of the ports of all devices that a client has opened."""
        return self._by_port.keys()

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Send samples of a tick to the clients."""
        asked: dict[Client, None] = {}
        for sample in samples:
            self._t_ns = max(self._t_ns, sample.t_sent_ns)
            for device, clients in self._by_port.get(sample.port, ()):
                told = device.tell(sample)
                if told is None:
                    continue
                subtype, body = told
                self.context.stats.encoded += 1
                message = PlayerMessage(
                    device.interface, device.number, DATA, subtype, body, self.timestamp(sample.t_ns)
                )
                data = wire.encode(message)
                for client in clients:
                    client.tell(message, data)
                    asked[client] = None
        for client in asked:
            client.deliver()

    def put_event(self, event: Event) -> None:
        """Follow vehicles that come and go, and a reset of the world."""
        if event.event == "ports_changed":
            self._find_devices()
            self.follow()
        elif event.event == "reset":
            self._t_ns = 0


class Client(Connection):
    """A client.

    Args:
        server: the devices.
        name: name of the client, for the world.

    Attributes:
        opened_devices: addresses of the devices that it has opened.
    """

    def __init__(self, server: Server, name: str) -> None:
        config = server.config
        self._conversation = Conversation(server.context, name)
        super().__init__(
            server.peers,
            config.hello_timeout_s,
            stats=server.context.stats,
            requests_per_s=config.max_requests_per_s,
            queue_bytes=config.queue_bytes,
            conversation=self._conversation,
        )
        self.opened_devices: set[Address] = set()
        self._server = server
        self._name = name
        self._decoder = wire.Decoder()
        self._here = (0, 0)  # our address and port, as the client sees them
        self._is_pulled = self._is_asked = False
        self._newest: dict[tuple[int, int, int], bytes] = {}

    # -- Connection -----------------------------------------------------------------------------------------------------------------------

    def opened(self) -> None:
        """Send the banner: a server speaks first."""
        here = self.transport.get_extra_info("sockname")
        if isinstance(here, tuple) and ":" not in here[0]:
            self._here = (struct.unpack("<I", socket.inet_aton(here[0]))[0], here[1])
        self.write(wire.BANNER)

    def refused(self, fault: Fault) -> bytes:
        """Send nothing: the protocol has no message for it."""
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

    def closed(self) -> None:
        """Forget the client. What it commanded stands until the actuator's time-out."""
        self.opened_devices.clear()
        self._server.follow()

    # -- messages -------------------------------------------------------------------------------------------------------------------------

    def _take(self, message: PlayerMessage) -> None:
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
        self._carry_out(message, device.take(message))

    def _device(self, interface: int, index: int) -> Device:
        device = self._server.devices.get((interface, index))
        if device is None:
            raise Refused("unknown_port", f"there is no device {interface}:{index}")
        return device

    def _carry_out(self, message: PlayerMessage, ask: Ask) -> None:
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
        else:
            self._answer(message, b"")

    def _refuse(self, message: PlayerMessage, fault: Fault) -> None:
        """Refuse a message. A request is answered, with the text where it is opaque; a command is not, by Player's rules."""
        if message.type != REQ:
            self._server.complain(f"{self._name}: {fault.text}")
            return
        self._stats.count_error(f"{self._name}: {fault.text}")
        said = {"error": fault.text, "code": fault.code}
        self._answer(message, wire.octets(msgspec.json.encode(said)) if message.interface == OPAQUE else b"", NACK)

    def _answer(self, message: PlayerMessage, body: bytes, kind: int = ACK) -> None:
        head = message._replace(type=kind, body=body, timestamp=self._server.timestamp())
        self.send_answer(wire.encode(head), self._name)

    # -- the interface player ---------------------------------------------------------------------------------------------------------------

    def _of_server(self, message: PlayerMessage) -> None:
        """Answer a request of the interface `PLAYER`."""
        body = message.body
        if message.subtype == wire.DEVLIST:
            there = list(self._server.devices)
            addresses = b"".join(wire.u32(*self._here, *at) for at in there)
            self._answer(message, wire.u32(len(there), len(there)) + addresses)
        elif message.subtype == wire.DRIVERINFO:
            device = self._device(wire.read_u32(body, 8), wire.read_u32(body, 12))
            self._answer(message, self._named(device))
        elif message.subtype == wire.DEV:
            self._open_or_close(message)
        elif message.subtype == wire.DATAMODE:
            mode = wire.read_u32(body)
            if mode not in (wire.PUSH, wire.PULL):
                raise Refused("bad_argument", f"no mode of delivery {mode}: 1 pushes, 2 pulls")
            self._is_pulled = mode == wire.PULL
            self._answer(message, b"")
        elif message.subtype == wire.PULL_DATA:
            self._answer(message, b"")
            self._is_asked = True
            self.deliver()
        elif message.subtype == wire.ADD_REPLACE_RULE:
            # Such rules ask to keep only the newest message of each kind, and nothing else is kept here.
            self._answer(message, b"")
        else:
            raise Refused("unknown_service", f"no request {message.subtype} of the interface player")

    def _named(self, device: Device) -> bytes:
        """Return address and driver of a device, as messages have them."""
        name = device.name.encode()[: wire.NAME_BYTES - 1] + b"\0"
        return wire.u32(*self._here, device.interface, device.number) + wire.octets(name)

    def _open_or_close(self, message: PlayerMessage) -> None:
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

    def tell(self, message: PlayerMessage, data: bytes) -> None:
        """Send data of a device that the client has opened, or keep the newest for a client that pulls.

        Args:
            message: the message.
            data: the same, encoded.
        """
        if self._is_pulled:
            self._newest[message.interface, message.number, message.subtype] = data
        else:
            self.send_sample(data)

    def deliver(self) -> None:
        """Send all kept data, and the mark of their end, if the client has asked for data and there are some."""
        if not (self._is_asked and self._newest) or self.is_closing:
            return
        for data in self._newest.values():
            self.send_sample(data)
        self._newest.clear()
        self._is_asked = False
        self.write(wire.encode(PlayerMessage(PLAYER, 0, SYNCH, 1, timestamp=self._server.timestamp())))


class PlayerAdapter(AdapterBase[PlayerConfig]):
    """Serves all devices on one port."""

    Config = PlayerConfig

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: the table wants ground truth without `truth = true`.
            CannotListen: the address cannot be had, or it is not loopback and the table does not allow that.
        """
        config, context = self.config, self.context
        config.check_bind("Player")
        if config.pose == "truth" and not config.truth:
            raise CannotServe('pose = "truth" needs truth = true')
        peers: Peers[Client] = Peers(config.max_clients, self.refusals, context.stats, strangers=config.max_strangers)
        server, numbers = Server(config, context, peers), itertools.count(1)

        def connected() -> Client:
            return Client(server, f"player#{next(numbers)}")

        async with serve_tcp(connected, peers, config.bind, config.port, rival="Player") as listener:
            with serving(context, server, address_text(config.bind, listener.port), ready):
                await asyncio.Event().wait()
