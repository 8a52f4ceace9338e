"""The scenario file: one typed, frozen `Scenario`. Numbers are as in the file: SI, but degrees where a key says `deg`.

Names of vehicles, sensors, actuators, modifiers and adapters are table names that the user chooses; they make the paths on every wire. The keys of
a component's table are declared beside the component (`uwserver.sensors`, `uwserver.actuators`, `uwserver.modifiers`).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, UnsetType, field

from uwserver.scenario.solids.tables import ObjectEntry, Seabed, Structure
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.world.tables import Environment, WorldTable
from uwserver.table import Name, Table
from uwserver.world.faults import FaultConfig


class Server(Table, kw_only=True, frozen=True):
    """Settings of the server.

    Attributes:
        name: name of the server, which it tells its clients.
        metrics_bind, metrics_port: address of ``/health`` and ``/metrics`` (HTTP); port 0 takes a free one.
        metrics: whether to serve them.
        allowed_hosts: host names that requests for them may use, in addition to addresses and localhost; "*" for any. This keeps a web page
            whose name was made to point here (DNS rebinding) from reading them.
        state_folder: folder where clients may save and load world states (``world/save``, ``world/load``), relative to this file; at most 64
            files; default: none.
        recordings: folder where clients may record to (``recording/start``), relative to the folder in which the server was started. It is
            made when it is needed; at most 256 files; "" for none.
        recordings_mb: largest total size of all recordings in that folder, MB.
        web: whether `uwserver run` serves the web view (http://127.0.0.1:7680/, or the next free port) if there is no adapter of kind `web`.
        uvloop: whether to use the event loop of libuv, which answers faster under load; needs the extra `uvloop`.
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
    """A whole scenario file. `adapters` holds the configuration type of each adapter, chosen by its `kind`.

    A file without a table `adapters` is served by `sockets` on TCP port 7600; with an empty table nobody can reach it.

    Attributes:
        start: whether the vehicles are free from the beginning, or "held": each stays exactly where it starts until something on board acts,
            that is until a thruster, propeller, fin, ballast or wrench gets a command that is not neutral, or its autopilot is armed. Its
            sensors read a vehicle at rest meanwhile. Objects, external vehicles and vehicles that are spawned later are always free. A held
            vehicle that something touches is let go too, and so are those for which ``world/let_go`` is called. A reset holds them again.
        extensions: Python files, in the folder of this file or below, that add kinds of sensor, modifier, actuator, current and fault. They are
            run: do not load a scenario that you do not trust.
    """

    schema: Literal[1]
    title: str = ""
    start: Literal["free", "held"] = "free"
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
