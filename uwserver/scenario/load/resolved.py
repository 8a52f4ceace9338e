"""What loading a scenario gives: every file read, every reference followed, every check passed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from msgspec import UnsetType

from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import Solid
from uwserver.scenario.files.errors import Problem
from uwserver.scenario.load.tables import Scenario
from uwserver.scenario.solids.tables import ObjectEntry
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.scenario.vehicle.tables import ThrusterDevice, VehicleFile
from uwserver.world.external.track import PoseTrack


@dataclass(frozen=True)
class ResolvedVehicle:
    """One vehicle of the scenario.

    Attributes:
        name: its table name.
        entry: its table in the scenario.
        vehicle: the vehicle file with `override` and the entry's sensors merged in, disabled components taken out.
        devices: device of each thruster, by the thruster's name.
        solid: its collision shapes in B; None without any, and of a ghost.
        looks: a checked .glb file; b"" without one.
        ghost: collision shapes of a ghost, by which viewers draw it.
        track: of an external vehicle that follows a log, in simulation time.
        off: names of its sensors that are not enabled.
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
        """Names of the ports of an external vehicle, beside its truth."""
        if not self.entry.is_external:
            return ()
        compared = () if isinstance(self.entry.compare_with, UnsetType) else ("difference",)
        return ("state", *compared, *(() if self.track is not None else self._commanded))

    @property
    def _commanded(self) -> tuple[str, ...]:
        file = self.vehicle
        return ("pose", "actuators") if file.thrusters or file.fins or file.propellers else ("pose",)


@dataclass(frozen=True)
class ResolvedObject:
    """One free object of the scenario: its table, its body in the scenario's water, and its shape in B."""

    name: str
    entry: ObjectEntry
    params: BodyParams
    solid: Solid
    looks: bytes = field(default=b"", repr=False)


@dataclass(frozen=True)
class Resolved:
    """A scenario ready to build.

    Attributes:
        name: file stem, or the name given by the builder.
        scenario: the typed file.
        vehicles: in the order of the file.
        path: the file; None for one built in Python.
        warnings: what a user should know, though the scenario runs.
        static: seabed and structures, in N, by name.
        objects: free objects, in the order of the file.
        materials: name of each material's number.
        looks: checked .glb files of structures, by name.
        missing: packages that a server of it needs and that are not installed, and what to type; "" where nothing is missing.
    """

    name: str
    scenario: Scenario
    vehicles: Mapping[str, ResolvedVehicle]
    path: Path | None
    warnings: tuple[Problem, ...]
    static: Mapping[str, Solid] = field(default_factory=dict)
    objects: Mapping[str, ResolvedObject] = field(default_factory=dict)
    materials: tuple[str, ...] = ()
    missing: str = ""
    looks: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    @property
    def is_solid(self) -> bool:
        """Whether anything can touch anything; what is spawned later does not count."""
        moving = [vehicle.solid for vehicle in self.vehicles.values()] + [body.solid for body in self.objects.values()]
        return bool(self.static) or sum(solid is not None for solid in moving) > 1

    @property
    def solids(self) -> dict[str, Solid]:
        """All collision shapes, also of ghosts, by table and name."""
        found = {f"static/{name}": solid for name, solid in self.static.items()}
        found |= {f"objects/{name}": body.solid for name, body in self.objects.items()}
        found |= {f"vehicles/{name}": v.solid for name, v in self.vehicles.items() if v.solid is not None}
        return found | {f"ghosts/{name}": v.ghost for name, v in self.vehicles.items() if v.ghost is not None}

    @property
    def tracks(self) -> dict[str, PoseTrack]:
        """What external vehicles follow, by name; of those that follow a log."""
        return {name: v.track for name, v in self.vehicles.items() if v.track is not None}
