"""Opens one device at all its addresses, and sends its reports there. TCP, UDP and a serial line carry the same bytes."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Iterator
from typing import cast

from uwserver.adapter import (
    AdapterContext,
    Connection,
    DatagramTurns,
    InputTurns,
    Peers,
    RateMeter,
    Refusals,
    SerialPort,
    address_text,
    cannot_listen,
    host_of,
    serve_tcp,
)
from uwserver_adapters.devices.device import (
    REQUESTS_PER_S,
    Device,
    DeviceTable,
    Garbage,
    Reader,
    Reply,
    Report,
    host_and_port,
)

STRANGERS_PER_S = 1000
"""Datagrams of unknown senders that are read in a second. They count together, because their addresses may be forged."""
RIVAL = "another simulator, or the maker's own tool"
Address = tuple[object, ...]


class TcpPeer(Connection):
    """A peer on TCP. It is admitted at once, because many peers only listen."""

    def __init__(self, served: DeviceServer, peers: Peers[TcpPeer]) -> None:
        super().__init__(peers, stats=served.stats, requests_per_s=REQUESTS_PER_S, queue_bytes=served.table.queue_bytes)
        self._served = served
        self._reader: Reader = served.device.reader()

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._reader.receive(data)

    def step(self) -> bool:
        """Take the next message. Where too many came the rest waits, and nothing more is read of the peer."""
        now = self.loop.time()
        if self._rate.is_full(now):
            return False
        event = self._reader.next_event()
        if event is None:
            return False
        self._rate.take(now)
        self._served.take(event, self.reply)
        return True

    def quiet_until(self) -> float:
        """Return when the next message is taken of a peer that sent too many."""
        return self._rate.end if self._rate.is_full(self.loop.time()) else 0.0

    def reply(self, data: bytes) -> None:
        """Send an answer. A peer that does not read its answers is disconnected."""
        if self.is_closing:
            return
        if self.waiting > self._served.table.queue_bytes:
            self._served.refuse("slow", "a peer does not read its answers and is disconnected")
            self.abort()
            return
        self._served.stats.bytes_sent += len(data)
        self.write(data)

    def report(self, data: bytes) -> None:
        """Send a message for all peers; a slow peer does not get it."""
        if not self.is_stranger:
            self.send_sample(data)


class _UdpSender:
    """An address that sent datagrams lately."""

    def __init__(self, reader: Reader) -> None:
        self.reader = reader
        self.rate = RateMeter(REQUESTS_PER_S)
        self.heard_s = 0.0


class UdpPeers(asyncio.DatagramProtocol):
    """All peers on UDP: addresses that sent lately, and those of the table.

    Args:
        served: the device.
        targets: resolved addresses of the table's `udp_to`.
        peers: the peers on TCP, with which datagrams share their turns.
    """

    def __init__(self, served: DeviceServer, targets: list[Address], peers: Peers[TcpPeer]) -> None:
        self._served = served
        self._targets = targets
        self._loop = asyncio.get_running_loop()
        self._turns = DatagramTurns(peers.turns)
        self._strangers = RateMeter(STRANGERS_PER_S)
        self._senders: dict[Address, _UdpSender] = {}
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin to send."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def connection_lost(self, error: Exception | None) -> None:
        """Send nothing more."""
        self._transport = None
        self._turns.close()

    def error_received(self, error: Exception) -> None:
        """Ignore it: most often nobody listens at a target yet."""

    @property
    def count(self) -> int:
        """Number of senders whose lease lasts."""
        return len(self._senders)

    def datagram_received(self, data: bytes, address: Address) -> None:
        """Take a datagram, in the turn of its sender."""
        now = self._loop.time()
        stats = self._served.stats
        sender = self._senders.get(address)
        if sender is None:
            self._expire(now)
            if not self._strangers.take(now):
                return
            most = self._served.table.max_clients
            if len(self._senders) >= most:
                text = f"{most} senders of datagrams are served: raise max_clients of the device"
                self._served.refuse("max_clients", text)
                return
            sender = self._senders[address] = _UdpSender(self._served.device.reader())
        sender.heard_s = now
        is_allowed = sender.rate.take(now)
        if not is_allowed or not self._turns.put(
            host_of(address), len(data), lambda: self._work(sender.reader, address, data)
        ):
            stats.dropped += 1

    def _work(self, reader: Reader, address: Address, data: bytes) -> Iterator[None]:
        reader.receive(data)
        while (event := reader.next_event()) is not None:
            self._served.take(event, lambda answer: self._send(answer, address))
            yield

    def _expire(self, now: float) -> None:
        lease = self._served.table.udp_lease_s
        self._senders = {a: sender for a, sender in self._senders.items() if now - sender.heard_s <= lease}

    def report(self, data: bytes) -> None:
        """Send a message for all peers."""
        self._expire(self._loop.time())
        for address in (*self._senders, *self._targets):
            self._served.stats.samples_sent += 1
            self._send(data, address)

    def _send(self, data: bytes, address: Address) -> None:
        if self._transport is None:
            return
        # Typeshed gives a datagram transport no such method; those of asyncio and uvloop have it.
        waiting = cast(asyncio.WriteTransport, self._transport).get_write_buffer_size()
        if waiting > self._served.table.queue_bytes:
            self._served.stats.dropped += 1
            return
        self._served.stats.bytes_sent += len(data)
        self._transport.sendto(data, address)

    def close(self) -> None:
        """Close the socket."""
        if self._transport is not None:
            self._transport.abort()


class SerialPeer:
    """The one peer of a serial line, which may come and go.

    Attributes:
        port: the line.
    """

    def __init__(self, path: str, served: DeviceServer, context: AdapterContext) -> None:
        self._served = served
        self.port = SerialPort(path, context, opened=self._begin, received=self._receive, closed=self._end)
        self._turns = InputTurns(self._step, self.port.pause, self.port.resume)
        self._begin()

    def _begin(self) -> None:
        self._reader = self._served.device.reader()

    def _end(self) -> None:
        self._turns.stop()

    def _receive(self, data: bytes) -> None:
        self._reader.receive(data)
        self._turns.begin()

    def _step(self) -> bool:
        """Take the next stored message."""
        event = self._reader.next_event()
        if event is None:
            return False
        self._served.take(event, self._reply)
        return True

    def _reply(self, data: bytes) -> None:
        if not self.port.is_open:
            return
        if self.port.write(data):
            self._served.stats.bytes_sent += len(data)
        else:
            self._served.stats.dropped += 1

    def report(self, data: bytes) -> None:
        """Send a message for all peers; what the line does not take in time is dropped."""
        if self.port.is_open:
            self._served.stats.samples_sent += 1
            self._reply(data)


class DeviceServer:
    """A device at its addresses, with its peers, and the counters that these share.

    Args:
        name: name of the device, for the log.
        table: table of the device.
        device: the device itself.
        context: context of the adapter.
        refusals: tells the log what was refused.

    Attributes:
        device, table: as given.
        stats: stats of the adapter.
        addresses: "tcp", "udp" or "serial" -> address as a user would type it; filled by `open`.
    """

    def __init__(
        self, name: str, table: DeviceTable, device: Device, context: AdapterContext, refusals: Refusals
    ) -> None:
        self.table = table
        self.device = device
        self.stats = context.stats
        self.addresses: dict[str, str] = {}
        self._name = name
        self._refusals = refusals
        self._context = context
        self._peers: Peers[TcpPeer] = Peers(table.max_clients, refusals)
        self._udp: UdpPeers | None = None
        self._serial: SerialPeer | None = None

    async def open(self, stack: contextlib.AsyncExitStack) -> None:
        """Listen until the stack is closed.

        Raises:
            CannotListen: an address cannot be had.
        """
        table = self.table
        if table.tcp_port is not None:
            serving = serve_tcp(
                lambda: TcpPeer(self, self._peers), self._peers, table.bind, table.tcp_port,
                key=f"device.{self._name}.tcp_port", rival=RIVAL,
            )  # fmt: skip
            listener = await stack.enter_async_context(serving)
            self.addresses["tcp"] = address_text(table.bind, listener.port)
        if table.udp_port is not None or table.udp_to:
            await self._open_udp(stack)
        if table.serial is not None:
            self._serial = SerialPeer(table.serial, self, self._context)
            stack.callback(self._serial.port.close)
            self.addresses["serial"] = table.serial
            self.attend()

    async def _open_udp(self, stack: contextlib.AsyncExitStack) -> None:
        table, loop = self.table, asyncio.get_running_loop()
        port = table.udp_port or 0
        try:
            family, _, _, _, own = (await loop.getaddrinfo(table.bind, port, type=socket.SOCK_DGRAM))[0]
            targets: list[Address] = []
            for host, number in map(host_and_port, table.udp_to):
                targets.append((await loop.getaddrinfo(host, number, family=family, type=socket.SOCK_DGRAM))[0][4])
            transport, self._udp = await loop.create_datagram_endpoint(
                lambda: UdpPeers(self, targets, self._peers), local_addr=(str(own[0]), port), family=family
            )
        except OSError as error:
            raise cannot_listen(
                error, table.bind, port, "udp", key=f"device.{self._name}.udp_port", rival=RIVAL
            ) from error
        # Called in the opposite order: the aborted socket is closed with the next turn of the loop.
        stack.push_async_callback(asyncio.sleep, 0)
        stack.callback(self._udp.close)
        if table.udp_port is not None:
            self.addresses["udp"] = address_text(table.bind, transport.get_extra_info("sockname")[1])

    def take(self, event: object, reply: Reply) -> None:
        """Hand a message of a peer to the device, and count what was none."""
        if isinstance(event, Garbage):
            self.refuse("garbage", event.text)
            return
        self.stats.commands += 1
        if reason := self.device.take(event, reply):
            self.refuse("unknown message", reason)

    def refuse(self, cause: str, text: str) -> None:
        """Count a refusal, and log it once a minute."""
        self._refusals.note_error(cause, f"{self._name}: {text}")

    @property
    def count(self) -> int:
        """Number of connected peers."""
        is_serial = self._serial is not None and self._serial.port.is_open
        return len(self._peers) + (self._udp.count if self._udp else 0) + is_serial

    def attend(self) -> None:
        """Open the serial line if it is not open; to be called now and then."""
        if self._serial is not None:
            self._serial.port.attend()

    def report(self, message: bytes | Report) -> None:
        """Send to all peers, or to those for which the message is."""
        data = message if isinstance(message, bytes) else message.data
        if self._udp is not None and (isinstance(message, bytes) or message.by_datagram):
            self._udp.report(data)
        if not isinstance(message, bytes) and message.by_datagram:
            return
        for peer in self._peers:
            peer.report(data)
        if self._serial is not None:
            self._serial.report(data)
