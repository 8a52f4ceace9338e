"""Opens one device at all its addresses, and sends its reports there."""

from __future__ import annotations

import asyncio
import contextlib
import socket

from uwserver.adapter import AdapterContext, Peers, Refusals, address_text, cannot_listen, serve_tcp
from uwserver_adapters.devices.device import Device, DeviceTable, Report, host_and_port
from uwserver_adapters.devices.wires import Address, SerialPeer, ServedDevice, TcpPeer, UdpPeers

RIVAL = "another simulator, or the maker's own tool"


class DeviceServer(ServedDevice):
    """A device at its addresses, with its peers.

    Attributes:
        addresses: "tcp", "udp" or "serial" -> address as a user would type it; filled by `open`.
    """

    def __init__(
        self, name: str, table: DeviceTable, device: Device, context: AdapterContext, refusals: Refusals
    ) -> None:
        super().__init__(name, table, device, context, refusals)
        self.addresses: dict[str, str] = {}
        self._key = f"device.{name}"
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
                key=f"{self._key}.tcp_port", rival=RIVAL,
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
            raise cannot_listen(error, table.bind, port, "udp", key=f"{self._key}.udp_port", rival=RIVAL) from error
        # Called in the opposite order: the aborted socket is closed with the next turn of the loop.
        stack.push_async_callback(asyncio.sleep, 0)
        stack.callback(self._udp.close)
        if table.udp_port is not None:
            self.addresses["udp"] = address_text(table.bind, transport.get_extra_info("sockname")[1])

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
