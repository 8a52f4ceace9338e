"""The scenario file: one typed, frozen `Scenario`. Numbers as in the file: SI, but degrees where a key says `deg`.

Names of vehicles, sensors, actuators, modifiers and adapters are table names chosen by the user; they are the path on every wire. What a
component's table may hold is declared beside the component itself (`uwserver.sensors`, `uwserver.actuators`, `uwserver.modifiers`).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.scenario.solids.tables import ObjectEntry, Seabed, Structure
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.water.tables import Environment
from uwserver.scenario.world.tables import WorldTable
from uwserver.table import Name, Table
from uwserver.world.faults import FaultConfig


class Server(Table, kw_only=True, frozen=True):
    """Attributes:
    name: how the server calls itself.
    metrics_bind, metrics_port: address of ``/health`` and ``/metrics`` (HTTP); port 0 takes a free one.
    metrics: serve them.
    allowed_hosts: names by which these may be asked, beside addresses and localhost; "*" for any. A web page whose name was made to point
        here (DNS rebinding) could read them otherwise.
    state_folder: where clients may save and load states of the world as files (``world/save``, ``world/load``), beside this file unless it
        is absolute; at most 64 of them; default: nowhere.
    recordings: where clients may record to (``recording/start``): a folder, of the one in which the server is started unless it is absolute,
        that is made when it is needed; at most 256 files; "" for nowhere.
    recordings_mb: that all recordings in it may have together, MB.
    web: serve the web view in `uwserver run` (http://127.0.0.1:7680/, or the next free port), unless an adapter of kind `web` says where.
    uvloop: run the event loop of libuv, which answers faster under load; needs the extra `uvloop`.
    """

    name: Name = "uwserver"
    metrics: bool = True
    metrics_bind: str = "127.0.0.1"
    metrics_port: Annotated[int, Meta(ge=0, le=65535)] = 9600
    allowed_hosts: tuple[Name, ...] = ()
    state_folder: str = ""
    recordings: str = "recordings"
    recordings_mb: Annotated[int, Meta(ge=1, le=1_000_000)] = 10_000
    web: bool = True
    uvloop: bool = False


class Scenario(Table, kw_only=True, frozen=True):
    """A whole scenario file. `adapters` holds each adapter's own configuration type, chosen by its `kind`.

    A file without a table `adapters` is served by `sockets` on TCP port 7600; with an empty one nobody can reach it.

    Attributes:
        extensions: Python files, in the folder of this one or below, with further kinds of sensor, modifier, actuator, current and fault. They
            are run: do not load what you do not trust.
    """

    schema: Literal[1]
    title: str = ""
    extensions: tuple[Name, ...] = ()
    seed: Annotated[int, Meta(ge=0)] = 0
    world: WorldTable = WorldTable()
    environment: Environment = Environment()
    seabed: Seabed | UnsetType = UNSET
    structures: dict[str, Structure] = field(default_factory=dict)
    objects: dict[str, ObjectEntry] = field(default_factory=dict)
    vehicles: dict[str, VehicleEntry] = field(default_factory=dict)
    faults: dict[str, FaultConfig] = field(default_factory=dict)
    adapters: dict[str, Any] = field(default_factory=dict)
    server: Server = Server()
