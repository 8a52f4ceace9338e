"""The bodies in a world: those of the scenario at the start, and those that ``world/spawn`` adds and ``world/remove`` removes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

from msgspec import Meta, Struct
from msgspec.structs import replace

from uwserver.frames import IDENTITY, Quat, Vec3
from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.kernel.layout import NU, P, Q
from uwserver.ports import Argument, Json, Refused, Service
from uwserver.ports.checks import shown
from uwserver.scenario.build.members import (
    build_scene,
    external_member,
    object_member,
    survey_structures,
    vehicle_member,
)
from uwserver.scenario.files.convert import NAME
from uwserver.scenario.load.checks import MOST_BODIES
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.solids.shapes import missing_engines
from uwserver.scenario.solids.tables import ObjectEntry
from uwserver.scenario.vehicle.body import params_by_name
from uwserver.scenario.vehicle.entry import VehicleEntry
from uwserver.sensors import Pose
from uwserver.units import rad
from uwserver.world.bodies.members import Member, Population
from uwserver.world.external.body import External, led_params
from uwserver.world.parts.part import State
from uwserver.world.world import World

MAX_BODIES = MOST_BODIES
"""Most rows for bodies. Until a reset, the rows of a body that was removed can only be used by another one built like it."""
BURIED_M = 0.01
"""A spawned body may be this deep inside something, but no deeper."""


class Born(Struct, frozen=True):
    """A body that is or was in the world, built like one of the scenario."""

    like: str
    name: str
    present: bool = True


class PopulationState(State, frozen=True):
    """The present or last body of each row, and the names of the bodies of the scenario."""

    scenario: Annotated[tuple[str, ...], Meta(max_length=65536)]
    born: Annotated[tuple[Born, ...], Meta(max_length=MAX_BODIES)]


class ScenarioPopulation(Population):
    """Puts bodies of a scenario into its world. Their parameters are computed once, and the member that was built for a row is kept.

    A spawn delays its tick, because all ports are announced again: by 1.5 ms in a small world, and by 5 ms for a vehicle with an autopilot and
    navigation among 80 such vehicles.
    """

    path = "world/population"
    state_type = PopulationState

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._world = world
        self._resolved = resolved
        self._engine = resolved.scenario.world.engine
        self._born: tuple[Born, ...] = ()
        self._first_spawned = 0
        self._parts: dict[str, tuple[str, ...]] = {}
        self._made: list[tuple[str, Member | None]] = []  # for each row, like which body it was made, and the member
        vehicles = {name: (each.vehicle, each.devices) for name, each in resolved.vehicles.items()}
        params = params_by_name(vehicles, resolved.scenario.environment)
        self._params: dict[str, BodyParams] = {
            name: led_params() if vehicle.entry.is_external else params[name]
            for name, vehicle in resolved.vehicles.items()
        } | {name: body.params for name, body in resolved.objects.items()}

    def begin(self) -> None:
        """Add the bodies that are there at the start, and offer the services."""
        world, members = self._world, []
        entries: dict[str, VehicleEntry | ObjectEntry] = {}
        entries |= {name: vehicle.entry for name, vehicle in self._resolved.vehicles.items()}
        entries |= {name: body.entry for name, body in self._resolved.objects.items()}
        for name, entry in entries.items():
            if entry.present:
                member = self._member(name, name)
                self._place(member, entry.position_ned_m, Pose.from_degrees(entry.attitude_rpy_deg).q)
                nu = world.hydro.state[member.vehicle.row, NU : NU + 6]
                nu[:3] = entry.velocity_frd_mps
                if isinstance(entry, VehicleEntry):
                    nu[3:] = [rad(rate) for rate in entry.angular_velocity_frd_degps]
                members.append(member)
                self._born += (Born(name, name),)
        self._first_spawned = len(members)
        self._remember(members)
        world.set_members(members)
        self._offer(tuple(entries))

    def spawn(self, name: str, like: str, p_NB: Vec3, q_NB: Quat) -> None:
        """Add a body that is built like one of the scenario, at rest.

        Raises:
            Refused: the name is not allowed or taken, the scenario has no body `like`, there is no room, or the place is taken.
        """
        world = self._world
        if not NAME.fullmatch(name) or name == "world":
            raise Refused("bad_argument", f'"{shown(name)}" cannot be a name: use letters, digits, _ and -', "name")
        if name in world.members:
            raise Refused("bad_argument", f'there is a "{name}" already: choose another name', "name")
        row = self._free_row(like)
        if row is None and len(world.hydro) >= MAX_BODIES:
            text = f"there is room for {MAX_BODIES} bodies, and the rows of removed bodies fit only bodies like them"
            raise Refused("busy", f"{text}: remove one like this, or call world/reset", "name")
        norm = math.hypot(*q_NB)
        if norm == 0.0:
            raise Refused("bad_argument", "a quaternion of zero length is no attitude", "q_NB")
        vehicle = self._resolved.vehicles.get(like)
        missing = (
            missing_engines(self._engine) if world.scene is None and vehicle is not None and vehicle.solid else None
        )
        if missing:
            raise Refused("denied", missing, "like")
        undo = world.hydro.arrays()
        member = self._member(like, name, row)
        self._place(member, p_NB, tuple(c / norm for c in q_NB))  # type: ignore[arg-type]  # four of them
        obstacle = self._obstacle(member)
        if obstacle:
            world.hydro.go_back(undo)
            world.set_current(world.water.current)
            raise Refused("bad_argument", f'"{name}" would begin inside {obstacle}: choose another place', "p_NB")
        row = member.vehicle.row
        self._born = (*self._born[:row], Born(like, name), *self._born[row + 1 :])
        self._remember((member,))
        # Members are in the order of their rows, as after a restore.
        world.set_members(sorted((*world.members.values(), member), key=lambda each: each.vehicle.row))
        world.set_current(world.water.current)
        world.hydro.load_kernels()

    def remove(self, name: str) -> None:
        """Remove a body and its components. Its faults are cleared, and its samples in flight are lost.

        Raises:
            Refused: there is no body of this name.
        """
        world = self._world
        member = world.members.get(name)
        if member is None:
            there = ", ".join(world.members) or "nothing"
            raise Refused("bad_argument", f'no "{shown(name)}" here, there is: {there}', "name")
        world.dismiss(name)
        row = member.vehicle.row
        self._born = (*self._born[:row], replace(self._born[row], present=False), *self._born[row + 1 :])
        world.hydro.retire(row)

    # -- states ---------------------------------------------------------------------------------------------------------------------

    def save(self) -> PopulationState:
        """Return the bodies that are and were there."""
        return PopulationState(tuple(self._params), self._born)

    def likes(self) -> dict[str, str]:
        """See `Population.likes`."""
        return {born.name: born.like for born in self._born if born.present}

    def is_here(self, state: PopulationState) -> bool:
        """See `Population.is_here`."""
        return state.born == self._born and state.scenario == tuple(self._params)

    def parts_of(self, state: PopulationState) -> set[str]:
        """See `Population.parts_of`."""
        kinds = {born.like for born in state.born if born.present}
        parts = {like: self._parts.get(like) or self._part_names_of_new(like) for like in kinds}
        return {f"{born.name}/{part}" for born in state.born if born.present for part in parts[born.like]}

    def params_of(self, state: PopulationState) -> list[BodyParams]:
        """See `Population.params_of`."""
        return [self._params[born.like] for born in state.born]

    def members_of(self, state: PopulationState) -> list[Member]:
        """See `Population.members_of`."""
        self._world.hydro.set_bodies(self.params_of(state))
        same, members = self._count_same_rows(state.born), list[Member]()
        for row, born in enumerate(state.born):
            if born.present:
                known = self._made[row][1] if row < same else None
                is_known = known is not None and known.vehicle.name == born.name
                members.append(known if known is not None and is_known else self._build(born.like, born.name, row))
        return members

    def check(self, state: Any) -> None:
        """Raise ValueError unless each body is like one of the scenario and has a name of its own, and the engines that it needs are installed."""
        if state.scenario != tuple(self._params):
            raise ValueError("the scenario has other vehicles or objects")
        names = [born.name for born in state.born if born.present]
        for born in state.born:
            if born.like not in self._params:
                raise ValueError(f'nothing in the scenario is called "{shown(born.like)}"')
            if not NAME.fullmatch(born.name) or born.name == "world":
                raise ValueError(f'"{shown(born.name)}" cannot be a name')
        if len(set(names)) < len(names):
            raise ValueError("two bodies have the same name")
        missing = missing_engines(self._engine) if self._world.scene is None and self._needs_scene(state.born) else None
        if missing:
            raise ValueError(missing)

    def load(self, state: PopulationState) -> None:
        """Take over which bodies there are. `admit` has already put them into the world."""
        self._born = state.born

    def admit(self, state: PopulationState, members: Iterable[Member]) -> None:
        """Put these bodies into the world, and build the scene if one of them is solid."""
        self._born = state.born
        if self._world.scene is None and self._needs_scene(state.born):
            build_scene(self._world, self._resolved)
        here = list(members)
        self._remember(here)
        self._world.set_members(here)

    def _remember(self, members: Iterable[Member]) -> None:
        """Keep the member of each row, also after it is removed, so that a restore that brings it back only has to load its state."""
        same = self._count_same_rows(self._born)
        if same < len(self._born):
            self._made[same:] = [(born.like, None) for born in self._born[same:]]
        for member in members:
            row = member.vehicle.row
            self._made[row] = self._born[row].like, member

    def _count_same_rows(self, born: Sequence[Born]) -> int:
        """Return how many of the first rows are built like those in `_made`. The rows of a body's thrusters depend on all bodies before it."""
        pairs = enumerate(zip(born, self._made, strict=False))
        return next((row for row, (new, made) in pairs if new.like != made[0]), min(len(born), len(self._made)))

    def _needs_scene(self, born: Sequence[Born]) -> bool:
        """Return whether anything solid was spawned. Bodies that were there at the start have their scene already, if they need one."""
        vehicles = self._resolved.vehicles
        spawned = [each.like for each in born[self._first_spawned :]]
        return any(like not in vehicles or vehicles[like].solid is not None for like in spawned)

    def _free_row(self, like: str) -> int | None:
        """Return the first row of a removed body that was spawned like this one, as its rows in all tables fit. Rows of the start stay reserved."""
        rows = range(self._first_spawned, len(self._born))
        return next((row for row in rows if self._born[row] == Born(like, self._born[row].name, False)), None)

    def _member(self, like: str, name: str, row: int | None = None) -> Member:
        """Return a body with its components, at rest at the origin, in the row of a removed body or in a new one."""
        hydro = self._world.hydro
        if row is None:
            row = hydro.add(self._params[like])
        else:
            hydro.revive(row)
        return self._build(like, name, row)

    def _build(self, like: str, name: str, row: int) -> Member:
        """Return the components of a body whose rows exist."""
        if like in self._resolved.vehicles:
            vehicle = self._resolved.vehicles[like]
            make = external_member if vehicle.entry.is_external else vehicle_member
            member = make(self._world, vehicle, row, name)
            survey_structures(member, vehicle, self._resolved.static)
        else:
            member = object_member(self._world, self._resolved.objects[like], row, name)
        self._parts[like] = tuple(part.path.removeprefix(f"{name}/") for part in member.parts)
        return member

    def _part_names_of_new(self, like: str) -> tuple[str, ...]:
        """Return the names of the parts of a body that was never in the world. One is built for this and discarded."""
        undo = self._world.hydro.arrays()
        self._member(like, like)
        self._world.hydro.go_back(undo)
        return self._parts[like]

    def _place(self, member: Member, p_NB: Vec3, q_NB: Quat) -> None:
        state = self._world.hydro.state[member.vehicle.row]
        state[P : P + 3], state[Q : Q + 4] = p_NB, q_NB
        for part in member.others:
            if isinstance(part, External):  # its source decides where it is
                part.follow_source(self._world.t_ns)

    def _obstacle(self, member: Member) -> str:
        """Return the thing that the member is deep inside of; "" for nothing."""
        world, row = self._world, member.vehicle.row
        if member.solid is None or member.led:
            return ""
        if world.scene is None:
            build_scene(world, self._resolved)
            world.set_members(world.members.values())
        assert world.scene is not None
        solid = world.scene.add_moving(member.solid, row)
        contacts = world.scene.find_contacts(world.hydro.state, world.hydro.dt)
        world.scene.remove(solid)
        mine = (contacts.body_a == row) | (contacts.body_b == row)
        for k in (mine & (contacts.gap < -BURIED_M)).nonzero()[0]:
            other = int(contacts.body_a[k] + contacts.body_b[k]) - row
            names = [m.vehicle.name for m in world.members.values() if m.vehicle.row == other]
            return f'"{names[0]}"' if names else "the seabed or a structure"
        return ""

    def _offer(self, kinds: tuple[str, ...]) -> None:
        def spawn(args: Mapping[str, Json]) -> Json:
            p, q = args["p_NB"], args["q_NB"]
            self.spawn(str(args["name"]), str(args["like"]), tuple(p), tuple(q))  # type: ignore[arg-type]  # checked
            return None

        def remove(args: Mapping[str, Json]) -> Json:
            self.remove(str(args["name"]))
            return None

        name = Argument("name", "str", "name of the body, which is the first level of its paths")
        alike = "a vehicle or object of the scenario, whether or not it is in the world now"
        like = Argument("like", "str", alike, choices=kinds)
        p_NB = Argument("p_NB", "float", "position of its origin in N", "m", shape=(3,), minimum=-1e6, maximum=1e6)
        turned = "attitude, w x y z; normalised"
        q_NB = Argument("q_NB", "float", turned, "1", shape=(4,), required=False, default=list(IDENTITY))
        if kinds:
            add = (
                "Add a body with its components, built like one of the scenario. In real time its tick is some ms late."
            )
            self._world.offer(Service("world/spawn", add, (name, like, p_NB, q_NB)), spawn)
        self._world.offer(Service("world/remove", "Remove a body and its components from the world.", (name,)), remove)
