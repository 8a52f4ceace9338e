"""The `player` adapter: a server of Player's protocol, for clients of libplayerc and others."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping, Sequence

from uwserver.adapter import (
    AdapterContext,
    CannotListen,
    CannotServe,
    Peers,
    Refusals,
    address_text,
    is_loopback,
    serve_tcp,
    serving,
)
from uwserver.ports import Event, Sample
from uwserver_adapters.player import codec
from uwserver_adapters.player.client import Address, Client, data_message
from uwserver_adapters.player.config import PlayerConfig
from uwserver_adapters.player.devices import Device, devices_of


class PlayerAdapter:
    """All devices on one port; a vehicle that comes has devices with numbers of their own, which may change when one goes.

    Attributes:
        config, context: as given.
    """

    Config = PlayerConfig

    def __init__(self, config: PlayerConfig, context: AdapterContext) -> None:
        self.config, self.context = config, context
        self._refusals = Refusals(context.name, context.stats, asyncio.get_running_loop().time)
        self._peers: Peers[Client] = Peers(
            config.max_clients, self._refusals, context.stats, strangers=config.max_strangers
        )
        self._devices: dict[Address, Device] = {}
        self._by_port: dict[str, list[tuple[Device, list[Client]]]] = {}
        self._t_ns = self._epoch_ns = 0
        self._count = 0

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotServe: the table wants what it may not have.
            CannotListen: see there; or the address is not loopback, and the table does not allow it.
        """
        config, context = self.config, self.context
        if not (is_loopback(config.bind) or config.allow_network):
            text = f"Player knows no token: whoever reaches {config.bind} could read and command all"
            raise CannotListen(f"{text}. Say allow_network = true if that is wanted")
        if config.pose == "truth" and not config.truth:
            raise CannotServe('pose = "truth" needs truth = true')
        self._find_devices()
        async with serve_tcp(self._client, self._peers, config.bind, config.port, rival="Player") as server:
            with serving(context, self, address_text(config.bind, server.port), ready):
                await asyncio.Event().wait()

    def _client(self) -> Client:
        self._count += 1
        return Client(self, self._peers, f"player#{self._count}")

    def _find_devices(self) -> None:
        context = self.context
        self._epoch_ns = context.world.epoch_ns
        found = devices_of(context.ports, self._epoch_ns, self.config.pose)
        self._devices = {(device.interface, device.number): device for device in found}
        context.stats.details["devices"] = len(found)

    # -- Server ---------------------------------------------------------------------------------------------------------------------------

    @property
    def devices(self) -> Mapping[Address, Device]:
        """See `Server`."""
        return self._devices

    def timestamp(self, t_ns: int | None = None) -> float:
        """See `Server`."""
        return codec.timestamp(self._epoch_ns + (self._t_ns if t_ns is None else t_ns))

    def follow(self) -> None:
        """See `Server`."""
        by_port: dict[str, list[tuple[Device, list[Client]]]] = {}
        hearers: dict[Address, list[Client]] = {}
        for client in self._peers:
            for address in getattr(client, "opened_devices", ()):  # a peer that was only just accepted has none
                hearers.setdefault(address, []).append(client)
        for address, clients in hearers.items():
            device = self._devices.get(address)
            for path in device.ports if device is not None else ():
                assert device is not None
                by_port.setdefault(path, []).append((device, clients))
        self._by_port = by_port
        self.context.follow_wants()

    def complain(self, text: str) -> None:
        """See `Server`."""
        self.context.stats.errors += 1
        self.context.stats.last_error = text[:300]
        self._refusals.note("not taken", text)

    # -- uwserver.adapter.Subscriber ------------------------------------------------------------------------------------------------------

    @property
    def wanted(self) -> Collection[str]:
        """Ports of the devices that somebody has opened."""
        return self._by_port.keys()

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Samples of one tick."""
        asked: dict[Client, None] = {}
        for sample in samples:
            self._t_ns = max(self._t_ns, sample.t_sent_ns)
            for device, clients in self._by_port.get(sample.port, ()):
                told = device.tell(sample)
                if told is None:
                    continue
                self.context.stats.encoded += 1
                data = data_message(device, *told, self.timestamp(sample.t_ns))
                for client in clients:
                    client.tell(device, told[0], data)
                    asked[client] = None
        for client in asked:
            client.deliver()

    def put_event(self, event: Event) -> None:
        """Other vehicles have other devices; a reset begins the time anew."""
        if event.event == "ports_changed":
            self._find_devices()
            self.follow()
        elif event.event == "reset":
            self._t_ns = 0
