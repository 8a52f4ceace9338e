"""The result of loading a scenario: all files are read, all references resolved, all checks passed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from msgspec import UnsetType

from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import Solid
from uwserver.scenario.files.errors import Problem
from uwserver.scenario.load.extras import Missing
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.tables import ObjectEntry
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.sensors import SensorConfig
from uwserver.world.external.track import PoseTrack


@dataclass(frozen=True)
class ResolvedVehicle:
    """One vehicle of the scenario.

    Attributes:
        name: name of the vehicle.
        entry: its table in the scenario.
        vehicle: the vehicle file with `override` and the entry's sensors merged in, without disabled components.
        devices: device of each thruster, by the thruster's name.
        solid: collision shapes in B; None for a ghost and if there are no shapes.
        looks: a checked .glb file; b"" without one.
        ghost: collision shapes of a ghost, which viewers draw.
        track: track of an external vehicle that follows a log, in simulation time.
        off: names of its disabled sensors.
    """

    name: str
    entry: VehicleEntry
    vehicle: VehicleFile
    devices: Mapping[str, ThrusterDevice]
    solid: Solid | None = None
    looks: bytes = field(default=b"", repr=False)
    ghost: Solid | None = None
    track: PoseTrack | None = field(default=None, repr=False)
    off: tuple[str, ...] = ()

    @property
    def external_ports(self) -> tuple[str, ...]:
        """Names of the ports of an external vehicle, without those of its truth."""
        if not self.entry.is_external:
            return ()
        compared = () if isinstance(self.entry.compare_with, UnsetType) else ("difference",)
        turns = self.vehicle.thrusters or self.vehicle.fins or self.vehicle.propellers
        commanded = ("pose", "actuators") if turns else ("pose",)
        return ("state", *compared, *(() if self.track is not None else commanded))


@dataclass(frozen=True)
class ResolvedObject:
    """One free object of the scenario: its table, its kernel parameters in the scenario's water, and its shape in B."""

    name: str
    entry: ObjectEntry
    params: BodyParams
    solid: Solid
    looks: bytes = field(default=b"", repr=False)


@dataclass(frozen=True)
class Resolved:
    """A scenario ready to build.

    Attributes:
        name: stem of the file name; the title if it was built in Python.
        scenario: the typed file.
        vehicles: in the order of the file.
        path: path of the file; None if it was built in Python.
        warnings: problems that do not stop the scenario.
        static: seabed and structures, in N, by name.
        objects: free objects, in the order of the file.
        materials: names of the materials, in the order of their numbers.
        looks: checked .glb files of structures, by name.
        missing: packages that are needed but not installed; None if none is missing.
    """

    name: str
    scenario: Scenario
    vehicles: Mapping[str, ResolvedVehicle]
    path: Path | None
    warnings: tuple[Problem, ...]
    static: Mapping[str, Solid] = field(default_factory=dict)
    objects: Mapping[str, ResolvedObject] = field(default_factory=dict)
    materials: tuple[str, ...] = ()
    missing: Missing | None = None
    looks: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    @property
    def sensors(self) -> list[SensorConfig]:
        """Those of all vehicles."""
        return [config for vehicle in self.vehicles.values() for config in vehicle.vehicle.sensors.values()]

    @property
    def is_solid(self) -> bool:
        """Whether anything can touch anything. Bodies that are spawned later do not count."""
        moving = [vehicle.solid for vehicle in self.vehicles.values()] + [body.solid for body in self.objects.values()]
        return bool(self.static) or sum(solid is not None for solid in moving) > 1

    @property
    def solids(self) -> dict[str, Solid]:
        """All collision shapes, those of ghosts too, by table and name."""
        found = {f"static/{name}": solid for name, solid in self.static.items()}
        found |= {f"objects/{name}": body.solid for name, body in self.objects.items()}
        found |= {f"vehicles/{name}": v.solid for name, v in self.vehicles.items() if v.solid is not None}
        return found | {f"ghosts/{name}": v.ghost for name, v in self.vehicles.items() if v.ghost is not None}

    @property
    def tracks(self) -> dict[str, PoseTrack]:
        """Tracks of the external vehicles that follow a log, by name."""
        return {name: v.track for name, v in self.vehicles.items() if v.track is not None}
