"""One device at all its addresses, from when it is opened until it is closed."""

from __future__ import annotations

import asyncio
import contextlib
import socket

from uwserver.adapter import AdapterContext, Peers, Refusals, address_text, cannot_listen, serve_tcp
from uwserver_adapters.devices.device import Device, DeviceTable, Report, host_and_port
from uwserver_adapters.devices.wires import Address, Desk, SerialWire, TcpWire, UdpWire

RIVAL = "another simulator, or the maker's own tool"


class Station:
    """A device and its peers.

    Args:
        name: of its table.
        table: where it is reached.
        device: what it says.
        context: of the adapter.
        refusals: where it is told what was refused.

    Attributes:
        device: as given.
        addresses: by way, as a user would type them; filled when it is opened.
    """

    def __init__(
        self, name: str, table: DeviceTable, device: Device, context: AdapterContext, refusals: Refusals
    ) -> None:
        self.device = device
        self.addresses: dict[str, str] = {}
        self._table = table
        self._key = f"device.{name}"
        self._context = context
        self._desk = Desk(name, table, device, context, refusals)
        self._peers: Peers[TcpWire] = Peers(table.max_clients, refusals)
        self._udp: UdpWire | None = None
        self._serial: SerialWire | None = None

    async def open(self, stack: contextlib.AsyncExitStack) -> None:
        """Listen until the stack is closed.

        Raises:
            CannotListen: an address cannot be had.
        """
        table = self._table
        if table.tcp_port is not None:
            serving = serve_tcp(
                lambda: TcpWire(self._desk, self._peers), self._peers, table.bind, table.tcp_port,
                key=f"{self._key}.tcp_port", rival=RIVAL,
            )  # fmt: skip
            listener = await stack.enter_async_context(serving)
            self.addresses["tcp"] = address_text(table.bind, listener.port)
        if table.udp_port is not None or table.udp_to:
            await self._open_udp(stack)
        if table.serial is not None:
            self._serial = SerialWire(table.serial, self._desk, self._context)
            stack.callback(self._serial.close)
            self.addresses["serial"] = table.serial
            self._serial.attend()

    async def _open_udp(self, stack: contextlib.AsyncExitStack) -> None:
        table, loop = self._table, asyncio.get_running_loop()
        port = table.udp_port or 0
        try:
            family, _, _, _, own = (await loop.getaddrinfo(table.bind, port, type=socket.SOCK_DGRAM))[0]
            targets: list[Address] = []
            for host, number in map(host_and_port, table.udp_to):
                targets.append((await loop.getaddrinfo(host, number, family=family, type=socket.SOCK_DGRAM))[0][4])
            transport, wire = await loop.create_datagram_endpoint(
                lambda: UdpWire(self._desk, targets, self._peers), local_addr=(str(own[0]), port), family=family
            )
        except OSError as error:
            raise cannot_listen(error, table.bind, port, "udp", key=f"{self._key}.udp_port", rival=RIVAL) from error
        self._udp = wire
        stack.push_async_callback(_ended, wire)
        if table.udp_port is not None:
            self.addresses["udp"] = address_text(table.bind, transport.get_extra_info("sockname")[1])

    @property
    def count(self) -> int:
        """Peers that are there."""
        is_serial = self._serial is not None and self._serial.is_open
        return len(self._peers) + (self._udp.count if self._udp else 0) + is_serial

    def attend(self) -> None:
        """To be called now and then: a serial line may have come."""
        if self._serial is not None:
            self._serial.attend()

    def report(self, message: bytes | Report) -> None:
        """Send to all peers, or to those of the ways that it is for."""
        if isinstance(message, bytes):
            data, by_datagram, by_stream = message, True, True
        else:
            data, by_datagram, by_stream = message.data, message.by_datagram, not message.by_datagram
        if self._udp is not None and by_datagram:
            self._udp.report(data)
        if not by_stream:
            return
        for peer in self._peers:
            peer.report(data)
        if self._serial is not None:
            self._serial.report(data)


async def _ended(wire: UdpWire) -> None:
    wire.close()
    await asyncio.sleep(0)  # its socket is closed with the next turn of the loop
