"""The table of the adapter `devices` in a scenario."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import SimpleNamespace
from typing import Annotated, cast

from msgspec import Meta

from uwserver.adapter import AdapterContext, AdapterTable, CannotServe
from uwserver.ports import Port, Service
from uwserver.table import Name
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
