"""The adapter's table in a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from msgspec import Meta

from uwserver.adapter import AdapterTable
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
    device: by names of your own: which sensor is served as which device, and where."""

    device: Annotated[dict[Name, AnyDevice], Meta(min_length=1)]

    def parts(self) -> Mapping[str, str]:
        """Each device: its kind, its sensors, its addresses."""
        return {
            f"device.{name}": f"{table.__struct_config__.tag} {table.told()}" for name, table in self.device.items()
        }
