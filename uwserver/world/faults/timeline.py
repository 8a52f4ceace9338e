"""Carries faults out: which of them begin and end in a tick, and what that changes in the rows and slots of a world."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, get_args

import msgspec
from msgspec import Meta, Struct, UnsetType, structs

from uwserver.actuators import Thrusters
from uwserver.physics.kernel.layout import FREE, STUCK, STUCK_AT
from uwserver.ports import Argument, Json, Refused, Service
from uwserver.ports.checks import shown
from uwserver.table import with_shared_defaults
from uwserver.world.faults.table import (
    FaultConfig,
    SensorFrozen,
    SensorSilent,
    ThrusterDead,
    ThrusterStuck,
    ThrusterTable,
    ThrusterWeak,
)  # fmt: skip
from uwserver.world.faults.targets import Hull, HullFault, Targets, damaged, refusals
from uwserver.world.parts.part import Carry, Part, Stage, State
from uwserver.world.parts.vehicle import Vehicle
from uwserver.world.world import World

MAX_FAULTS = 256
MAX_NAME = 64
"""Most characters of a fault's name that a client gives."""


class Entry(Struct, frozen=True):
    """One fault. It acts from the start of tick `begin` to that of tick `end` (None: for ever)."""

    name: str
    fault: FaultConfig
    begin: Annotated[int, Meta(ge=0, le=2**62)]
    end: Annotated[int, Meta(ge=0, le=2**62)] | None
    state: Literal["waiting", "active", "over"] = "waiting"


class FaultsState(State, frozen=True):
    """Every fault with its state. Their effects on the bodies stand in the rows of the bodies."""

    entries: Annotated[tuple[Entry, ...], Meta(max_length=MAX_FAULTS)]


class Faults(Part):
    """All faults of a world, by name. Faults of thrusters and sensors are marks in rows and slots; faults of a hull change the parameters
    of the body.

    Attributes:
        entries: in the order in which they were set.
    """

    path = "world/faults"
    state_type = FaultsState
    stage: ClassVar[Stage] = Stage.FAULTS

    def __init__(self, world: World) -> None:
        """Begin without faults, in a world that is still being built."""
        self._world = world
        self.entries: dict[str, Entry] = {}
        self.services = tuple(_services(self))

    def targets(self) -> Targets:
        """Return what can fail in the world now."""
        return Targets(
            {name: self._hull(vehicle) for name, vehicle in self._world.vehicles.items()},
            {path: tuple(rows) for path in self._world.actuators if (rows := self._thrusters(path))},
            tuple(self._world.sensors),
        )

    def set(self, name: str, fault: FaultConfig) -> None:
        """Add a fault, or replace the one of that name. A fault whose time has come acts at once.

        Raises:
            Refused: no such target or member, the fault is over already, there are too many, or a body without mass or buoyancy would be
                left.
        """
        tick, others = self._world.tick, [entry.fault for entry in self.entries.values() if entry.name != name]
        for key, text in refusals(fault, self.targets(), others):
            raise Refused("bad_argument", text, key)
        begin = max(tick, self._world.ticks.at(fault.at_s))
        end = None if isinstance(fault.until_s, UnsetType) else self._world.ticks.at(fault.until_s)
        if end is not None and end <= tick:
            raise Refused("bad_argument", f"{fault.until_s:g} s is over already", "until_s")
        if name not in self.entries and len(self.entries) >= MAX_FAULTS:
            raise Refused("busy", f"there are {MAX_FAULTS} faults already: clear one, or use its name", "name")
        self.clear(name)
        self.entries[name] = Entry(name, with_shared_defaults(fault), begin, end)
        self.before(tick, 0)

    def clear(self, name: str) -> bool:
        """Remove a fault and its effect. Returns False if there is none of that name."""
        entry = self.entries.pop(name, None)
        if entry is None:
            return False
        if entry.state == "active":
            self._carry_out(entry.fault)
            self._world.say("fault", f'fault "{name}" of "{entry.fault.target}" was cleared')
        self._plan()
        return True

    def forget(self, body: str) -> None:
        """Clear the faults of a body."""
        for entry in list(self.entries.values()):
            if entry.fault.target.split("/")[0] == body:
                self.clear(entry.name)

    def before(self, tick: int, t_ns: int) -> None:
        """Begin and end the faults that are due at the start of a tick."""
        for entry in list(self.entries.values()):
            if entry.state != "over" and entry.end is not None and tick >= entry.end:
                self._change(entry, "over", "ended")
            elif entry.state == "waiting" and tick >= entry.begin:
                self._change(entry, "active", "began")
        self._plan()

    def save(self) -> FaultsState:
        """Return all entries."""
        return FaultsState(tuple(self.entries.values()))

    def check(self, state: Any) -> None:
        """Raise ValueError for two faults of one name, and for a fault that is not possible in this world."""
        faults = [entry.fault for entry in state.entries]
        if len({entry.name for entry in state.entries}) < len(faults):
            raise ValueError("two faults of one name")
        targets = self.targets()
        for entry in state.entries:
            # Whether the faults together leave a body any mass shows only while they act: the order in which they were set and cleared is
            # not known here.
            for _, text in refusals(entry.fault, targets, ()):
                raise ValueError(text)

    def load(self, state: FaultsState) -> None:
        """Take over the entries. No event is sent."""
        self.entries = {entry.name: entry for entry in state.entries}
        for slot in self._world.sensors.values():
            slot.fault = ""
        for target in {fault.target for fault in self._active() if isinstance(fault, SensorFrozen | SensorSilent)}:
            self._mark_sensor(target)
        self._plan()

    def _change(self, entry: Entry, state: Literal["active", "over"], verb: str) -> None:
        began_before = entry.state == "active" or state == "active"
        self.entries[entry.name] = structs.replace(entry, state=state)
        if began_before:
            self._carry_out(entry.fault)
            self._world.say("fault", f'fault "{entry.name}" {verb}: {_kind(entry.fault)} of "{entry.fault.target}"')

    def _plan(self) -> None:
        ticks = [entry.begin for entry in self.entries.values() if entry.state == "waiting"]
        ticks += [entry.end for entry in self.entries.values() if entry.state != "over" and entry.end is not None]
        self.next_tick = min(ticks, default=None)

    def _active(self) -> list[FaultConfig]:
        return [entry.fault for entry in self.entries.values() if entry.state == "active"]

    def _carry_out(self, changed: FaultConfig) -> None:
        """Set the target of `changed` to the combined effect of all active faults."""
        if isinstance(changed, ThrusterTable):
            touching = [(fault, self._rows(fault)) for fault in self._active() if isinstance(fault, ThrusterTable)]
            for row in self._rows(changed):
                self._set_thruster(row, [fault for fault, rows in touching if row in rows])
        elif isinstance(changed, HullFault):
            vehicle, water = self._world.vehicles[changed.target], self._world.water
            faults = [f for f in self._active() if isinstance(f, HullFault) and f.target == changed.target]
            body = damaged(
                self._world.hydro.params[vehicle.row], self._hull(vehicle), faults, water.density, water.gravity
            )
            self._world.hydro.change(vehicle.row, body)
        else:
            self._mark_sensor(changed.target)

    def _thrusters(self, path: str) -> Mapping[str, int]:
        actuator = self._world.actuators[path].actuator
        return actuator.rows if isinstance(actuator, Thrusters) else {}

    def _rows(self, fault: ThrusterTable) -> list[int]:
        rows = self._thrusters(fault.target)
        return [rows[name] for name in (rows if isinstance(fault.members, UnsetType) else fault.members)]

    def _set_thruster(self, row: int, faults: Iterable[ThrusterTable]) -> None:
        efficiency, stuck, u = 1.0, FREE, 0.0
        for fault in faults:
            if isinstance(fault, ThrusterDead):
                efficiency = 0.0
            elif isinstance(fault, ThrusterWeak):
                efficiency *= fault.factor
            elif isinstance(fault, ThrusterStuck):
                stuck, u = (STUCK, 0.0) if isinstance(fault.u, UnsetType) else (STUCK_AT, fault.u)
        thruster = self._world.hydro.thrusters[row : row + 1]
        thruster["efficiency"] = efficiency
        if stuck == FREE and thruster["stuck"][0] != FREE:
            thruster["fresh"] = 1  # The newest command holds again.
        thruster["stuck"], thruster["stuck_u"] = stuck, u

    def _mark_sensor(self, path: str) -> None:
        kinds = {type(fault) for fault in self._active() if fault.target == path}
        slot = self._world.sensors[path]
        slot.fault = "silent" if SensorSilent in kinds else "frozen" if SensorFrozen in kinds else ""

    def _hull(self, vehicle: Vehicle) -> Hull:
        body, density = self._world.hydro.params[vehicle.row], self._world.water.density
        return Hull(body.M_RB, body.r_g, (body.displaced or 0.0) / density, density * self._world.water.gravity)


def _kind(fault: FaultConfig) -> str:
    return str(fault.__struct_config__.tag).replace("_", " ")


def _services(faults: Faults) -> Iterator[tuple[Service, Carry]]:
    """Yield the services that set, clear and list faults."""
    kinds = tuple(str(kind.__struct_config__.tag) for kind in get_args(FaultConfig))
    name = Argument("name", "str", "name of the fault")
    kind = Argument("kind", "str", "what fails, and how", choices=kinds)
    target = Argument("target", "str", "<vehicle>/<component>, or a vehicle")
    keys = Argument(
        "parameters", "json", "object: the other keys of the kind, as in a scenario", required=False, default={}
    )

    def set_fault(args: Mapping[str, Json]) -> Json:
        given = args["parameters"]
        if len(str(args["name"])) > MAX_NAME:  # Events bring the name to all clients.
            text = f"the name of a fault has at most {MAX_NAME} characters, not {len(str(args['name']))}"
            raise Refused("out_of_range", text, "name")
        if not isinstance(given, dict):
            raise Refused("bad_argument", "parameters must be an object of keys and values", "parameters")
        try:
            table = {**given, "kind": args["kind"], "target": args["target"]}
            given_fault: FaultConfig = msgspec.convert(table, FaultConfig)
            # Encoded as JSON once, which refuses half a surrogate pair. Only the finished table is encoded, as the other given values may
            # be long.
            fault = msgspec.json.decode(msgspec.json.encode(given_fault), type=FaultConfig)
        except (msgspec.MsgspecError, TypeError, ValueError, RecursionError) as error:
            raise Refused("bad_argument", str(error), "parameters") from None
        faults.set(str(args["name"]), fault)
        return None

    def clear_fault(args: Mapping[str, Json]) -> Json:
        if not faults.clear(str(args["name"])):
            there = ", ".join(faults.entries) or "none"
            raise Refused("bad_argument", f'no fault "{shown(args["name"])}", there are: {there}', "name")
        return None

    def listed(_: Mapping[str, Json]) -> Json:
        entries = faults.entries.values()
        return [{"name": e.name, "state": e.state, **msgspec.to_builtins(e.fault)} for e in entries]

    doc = "Add a fault, now or at its at_s, or replace the one of that name."
    yield Service("world/set_fault", doc, (name, kind, target, keys)), set_fault
    yield Service("world/clear_fault", "Remove a fault and its effect.", (name,)), clear_fault
    yield Service("world/faults", "All faults with their state: waiting, active or over."), listed
