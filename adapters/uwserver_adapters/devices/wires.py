"""How peers reach a device: by TCP, by UDP, by a serial line. The same bytes on each."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import cast

from uwserver.adapter import (
    TURN_S,
    AdapterContext,
    Connection,
    DatagramTurns,
    Peers,
    RateMeter,
    Refusals,
    SerialPort,
    host_of,
)
from uwserver_adapters.devices.device import REQUESTS_PER_S, Device, DeviceTable, Garbage, Reader

REST_S = 0.004
"""Wall time before the next turn of a serial line, once one is used up."""
STRANGERS_PER_S = 1000
"""Datagrams of senders that are not known yet which are read in a second: their addresses may be forged, so they count together."""
Address = tuple[object, ...]


class Desk:
    """What all ways to one device share: the device, and how its peers' messages are counted.

    Args:
        name: of the device, for the log.
        table: of the device.
        device: who is meant.
        context: of the adapter.
        refusals: where it is told what was refused.
    """

    def __init__(
        self, name: str, table: DeviceTable, device: Device, context: AdapterContext, refusals: Refusals
    ) -> None:
        self.name = name
        self.table = table
        self.device = device
        self.stats = context.stats
        self.refusals = refusals

    def take(self, event: object, wire: Wire) -> None:
        """A message of a peer, or what was none."""
        if isinstance(event, Garbage):
            self.refuse("garbage", event.text)
            return
        self.stats.commands += 1
        reason = self.device.take(event, wire.reply)
        if reason:
            self.refuse("unknown message", reason)

    def refuse(self, cause: str, text: str) -> None:
        """Count it, and tell it once a minute."""
        self.stats.errors += 1
        self.stats.last_error = f"{self.name}: {text}"[:300]
        self.refusals.note(cause, f"{self.name}: {text}")


class Wire:
    """To whom an answer goes."""

    def reply(self, data: bytes) -> None:
        """Send an answer."""
        raise NotImplementedError


class TcpWire(Connection, Wire):
    """A peer on TCP. It is admitted as it comes: many only listen."""

    def __init__(self, desk: Desk, peers: Peers[TcpWire]) -> None:
        super().__init__(peers)
        self._desk = desk
        self._reader: Reader = desk.device.reader()
        self._rate = RateMeter(REQUESTS_PER_S)

    def receive(self, data: bytes) -> None:
        """Store bytes."""
        self._reader.receive(data)

    def step(self) -> bool:
        """Take the next message, unless too many came: they wait, and so does their sender."""
        now = self.loop.time()
        if self._rate.is_full(now):
            return False
        event = self._reader.next_event()
        if event is None:
            return False
        self._rate.take(now)
        self._desk.take(event, self)
        return True

    def quiet_until(self) -> float:
        """When the next message is taken of a peer that sent too many."""
        return self._rate.end if self._rate.is_full(self.loop.time()) else 0.0

    def reply(self, data: bytes) -> None:
        """Send an answer; who reads none of them is disconnected."""
        if self.is_closing:
            return
        if self.waiting > self._desk.table.queue_bytes:
            self._desk.refuse("slow", "a peer does not read its answers and is disconnected")
            self.abort()
            return
        self._desk.stats.bytes_sent += len(data)
        self.write(data)

    def report(self, data: bytes) -> None:
        """Send what all peers get, unless this one is slow."""
        stats = self._desk.stats
        if self.is_stranger or self.is_closing:
            return
        if self.waiting > self._desk.table.queue_bytes:
            stats.dropped += 1
            return
        stats.samples_sent += 1
        stats.bytes_sent += len(data)
        self.write(data)


class _Sender(Wire):
    """One address."""

    def __init__(self, wire: UdpWire, address: Address) -> None:
        self.reader = wire.desk.device.reader()
        self.rate = RateMeter(REQUESTS_PER_S)
        self.heard_s = 0.0
        self._wire = wire
        self._address = address

    def reply(self, data: bytes) -> None:
        self._wire.send(data, self._address)


class UdpWire(asyncio.DatagramProtocol):
    """All peers on UDP: whoever sent lately, and whom the table names.

    Args:
        desk: the device.
        targets: resolved addresses of the table's `udp_to`.
    """

    def __init__(self, desk: Desk, targets: list[Address], peers: Peers[TcpWire]) -> None:
        self.desk = desk
        self._targets = targets
        self._loop = asyncio.get_running_loop()
        self._turns = DatagramTurns(peers.turns)
        self._strangers = RateMeter(STRANGERS_PER_S)
        self._senders: dict[Address, _Sender] = {}
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def connection_lost(self, error: Exception | None) -> None:
        """End."""
        self._transport = None
        self._turns.close()

    def error_received(self, error: Exception) -> None:
        """Nobody listens at a target, most often: it may come yet."""

    @property
    def count(self) -> int:
        """Senders whose lease lasts."""
        return len(self._senders)

    def datagram_received(self, data: bytes, address: Address) -> None:
        """Take a datagram in its turn."""
        now = self._loop.time()
        sender = self._senders.get(address)
        if sender is None:
            self._expire(now)
            if not self._strangers.take(now):
                return
            if len(self._senders) >= self.desk.table.max_clients:
                most = self.desk.table.max_clients
                self.desk.refuse(
                    "max_clients", f"{most} senders of datagrams are served: raise max_clients of the device"
                )
                return
            sender = self._senders[address] = _Sender(self, address)
        sender.heard_s = now
        if not sender.rate.take(now):
            self.desk.stats.dropped += 1
            return
        if not self._turns.put(host_of(address), len(data), lambda: self._work(sender, data)):
            self.desk.stats.dropped += 1

    def _work(self, sender: _Sender, data: bytes) -> Iterator[None]:
        sender.reader.receive(data)
        while (event := sender.reader.next_event()) is not None:
            self.desk.take(event, sender)
            yield

    def _expire(self, now: float) -> None:
        lease = self.desk.table.udp_lease_s
        for address in [address for address, sender in self._senders.items() if now - sender.heard_s > lease]:
            del self._senders[address]

    def report(self, data: bytes) -> None:
        """Send what all peers get."""
        self._expire(self._loop.time())
        for address in (*self._senders, *self._targets):
            self.desk.stats.samples_sent += 1
            self.send(data, address)

    def send(self, data: bytes, address: Address) -> None:
        """One datagram; counted where too much waits for the system."""
        if self._transport is None:
            return
        # Typeshed does not know it of datagrams; asyncio and uvloop have it.
        waiting = cast(asyncio.WriteTransport, self._transport).get_write_buffer_size()
        if waiting > self.desk.table.queue_bytes:
            self.desk.stats.dropped += 1
            return
        self.desk.stats.bytes_sent += len(data)
        self._transport.sendto(data, address)

    def close(self) -> None:
        """End it."""
        if self._transport is not None:
            self._transport.abort()


class SerialWire(Wire):
    """The one peer of a serial line that may come and go."""

    def __init__(self, path: str, desk: Desk, context: AdapterContext) -> None:
        self._desk = desk
        self._loop = asyncio.get_running_loop()
        self._reader = desk.device.reader()
        self._turn: asyncio.TimerHandle | None = None
        self._port = SerialPort(path, context, opened=self._begin, received=self._receive, closed=self._end)

    @property
    def is_open(self) -> bool:
        """Whether the line is there."""
        return self._port.is_open

    def attend(self) -> None:
        """Open the line if it is not; to be called now and then."""
        self._port.attend()

    def close(self) -> None:
        """End it."""
        self._port.close()

    def _begin(self) -> None:
        self._reader = self._desk.device.reader()

    def _end(self) -> None:
        if self._turn is not None:
            self._turn.cancel()
            self._turn = None

    def _receive(self, data: bytes) -> None:
        self._reader.receive(data)
        if self._turn is None:
            self._work()

    def _work(self) -> None:
        """Take what is there, for one turn; nothing more is read before the rest had its own."""
        self._turn = None
        end = self._loop.time() + TURN_S
        while (event := self._reader.next_event()) is not None:
            self._desk.take(event, self)
            if not self._port.is_open:
                return
            if self._loop.time() >= end:
                self._port.pause()
                self._turn = self._loop.call_later(REST_S, self._work)
                return
        self._port.resume()

    def reply(self, data: bytes) -> None:
        """Send an answer, or what all peers get; what the line does not take in time is dropped."""
        if not self._port.is_open:
            return
        if self._port.write(data):
            self._desk.stats.bytes_sent += len(data)
        else:
            self._desk.stats.dropped += 1

    def report(self, data: bytes) -> None:
        """Likewise, counted as a sample."""
        if self._port.is_open:
            self._desk.stats.samples_sent += 1
            self.reply(data)
