"""The adapter `devices`: opens each device of its table, and gives it the samples of its sensors."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Annotated, cast

from msgspec import Meta

from uwserver.adapter import AdapterBase, AdapterContext, AdapterTable, CannotServe, serving
from uwserver.ports import Event, Json, Port, Sample, Service
from uwserver.table import Name
from uwserver_adapters.devices.device_server import DeviceServer
from uwserver_adapters.devices.nmea0183 import Nmea0183Table
from uwserver_adapters.devices.oculus import OculusTable
from uwserver_adapters.devices.ping1d import Ping1DTable
from uwserver_adapters.devices.ping360 import Ping360Table
from uwserver_adapters.devices.seatrac import SeaTracTable
from uwserver_adapters.devices.vectornav import VectorNavTable
from uwserver_adapters.devices.water_linked_a50 import WaterLinkedA50Table
from uwserver_adapters.devices.xsens import XsensTable

AnyDevice = (
    WaterLinkedA50Table
    | Nmea0183Table
    | Ping1DTable
    | Ping360Table
    | VectorNavTable
    | SeaTracTable
    | OculusTable
    | XsensTable
)
ATTEND_S = 0.5
"""Wall time between two attempts to open serial lines, and between two counts of peers."""


class DevicesConfig(AdapterTable, tag="devices", kw_only=True, frozen=True):
    """Attributes:
    device: devices by names of your own: each says which sensor it serves, as which device, and where.
    """

    device: Annotated[dict[Name, AnyDevice], Meta(min_length=1)]

    def faults(
        self, ports: Mapping[str, Port], services: Mapping[str, Service]
    ) -> Iterable[tuple[tuple[str, ...], str]]:
        """Yield the devices whose sensors are not there, or of another kind."""
        # The part of a context that a device reads while it is built.
        offer = SimpleNamespace(ports=ports, services=services)
        for name, table in self.device.items():
            try:
                table.build(cast(AdapterContext, offer))
            except CannotServe as error:
                role, _, text = str(error).partition(": ")
                yield ("device", name, role), text

    def parts(self) -> Mapping[str, str]:
        """Return kind, sensors and addresses of each device."""
        return {
            f"device.{name}": f"{table.__struct_config__.tag} {table.told()}" for name, table in self.device.items()
        }


class DevicesAdapter(AdapterBase[DevicesConfig]):
    """Serves sensors as devices of the market."""

    Config = DevicesConfig

    def __init__(self, config: DevicesConfig, context: AdapterContext) -> None:
        super().__init__(config, context)
        self._servers: dict[str, DeviceServer] = {}
        self._readers: dict[str, list[DeviceServer]] = {}

    @property
    def subscriptions(self) -> Collection[str]:
        """Paths of the ports that the devices read."""
        return self._readers.keys()

    async def run(self, ready: asyncio.Event) -> None:
        """Serve until cancelled.

        Raises:
            CannotListen: an address cannot be had.
            CannotServe: a table names a sensor that does not exist or does not fit.
        """
        self._build()
        async with contextlib.AsyncExitStack() as stack:
            for server in self._servers.values():
                await server.open(stack)
            addresses = {name: cast(Json, server.addresses) for name, server in self._servers.items()}
            self.context.stats.details["devices"] = addresses
            with serving(self.context, self, self._address(), ready):
                while True:
                    for server in self._servers.values():
                        server.attend()
                    self.context.stats.peers = sum(server.count for server in self._servers.values())
                    await asyncio.sleep(ATTEND_S)

    def _build(self) -> None:
        self._servers.clear()
        self._readers.clear()
        for name, table in self.config.device.items():
            try:
                device = table.build(self.context)
            except CannotServe as error:
                raise CannotServe(f"device.{name}.{error}") from None
            server = self._servers[name] = DeviceServer(name, table, device, self.context, self.refusals)
            for path in device.subscriptions:
                self._readers.setdefault(path, []).append(server)

    def _address(self) -> str:
        """Return all addresses. Where there are several, each with the name of its device and its kind."""
        addresses = [
            (f"{name} {way} {text}", text)
            for name, server in self._servers.items()
            for way, text in server.addresses.items()
        ]
        return ", ".join(told for told, _ in addresses) if len(addresses) > 1 else addresses[0][1]

    def put_samples(self, samples: Sequence[Sample]) -> None:
        """Give each sample to the devices that read it, and send their messages."""
        for sample in samples:
            for server in self._readers.get(sample.port, ()):
                for message in server.device.see(sample):
                    server.report(message)

    def put_event(self, event: Event) -> None:
        """After a reset of the world the devices start again."""
        if event.event == "reset":
            for server in self._servers.values():
                server.device.reset()
