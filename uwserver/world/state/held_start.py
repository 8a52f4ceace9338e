"""The held start: vehicles that stay where the scenario puts them until something on board acts (``start = "held"``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from uwserver.physics.bodies import HELD, Hydrodynamics
from uwserver.physics.kernel.layout import NU
from uwserver.ports import Argument, Json, Refused, Service
from uwserver.ports.checks import shown
from uwserver.world.bodies.members import Member
from uwserver.world.parts.part import Part, Stage, State
from uwserver.world.stepping.piloting import Piloting
from uwserver.world.world import World

LET_GO = Service(
    "world/let_go",
    'Let held vehicles move without a command, to see how they drift (start = "held").',
    (Argument("vehicle", "str", "its name; default: all that are held", required=False, default=""),),
)


class HeldState(State, frozen=True):
    """Names of the vehicles that are still held."""

    names: Annotated[tuple[str, ...], Meta(max_length=65536)]


class _Neutral(NamedTuple):
    """The commands in the rows of a vehicle at its start, and where these rows are: thrusters, servos, wrenches."""

    row: int
    places: tuple[slice, slice, slice]
    commands: tuple[bytes, bytes, bytes]


class HeldStart(Part):
    """Holds the vehicles of a scenario, each until something on board acts: a thruster, a propeller, a fin, a ballast or a wrench is given a
    command that is not the one of the start, or the autopilot is armed. A vehicle that is touched, or given a velocity, is let go too.

    A neutral command changes nothing, so that an autopilot that sends neutral outputs in every frame does not let its vehicle go before somebody
    steers. What exerts no force, such as a lamp or the tilt of a camera, does not count either. The rows decide, not the kinds of actuators.

    A held body is skipped by the kernels (`Hydrodynamics.hold`): its pose keeps every bit, and it reads as a body at rest.
    """

    path = "world/held"
    state_type = HeldState
    stage: ClassVar[Stage] = Stage.WATCHDOGS

    def __init__(self, world: World) -> None:
        """Hold the simulated vehicles that are in a world, which is at its start."""
        self._world = world
        self.services = ((LET_GO, self._let_go),)
        held = [member for member in world.members.values() if not (member.is_object or member.led)]
        self._start = {member.vehicle.name: _neutral(world.hydro, member.vehicle.row) for member in held}
        self._names: tuple[str, ...] = ()
        self._rows: list[int] = []
        self._seen, self._is_told, self._touchable = -1, False, False
        self._hold(tuple(self._start))

    @property
    def names(self) -> tuple[str, ...]:
        """The vehicles that are held."""
        return self._names

    @property
    def next_tick(self) -> int | None:  # type: ignore[override]  # it follows from what others have done
        """0 if something may have been commanded or called since it last looked, if something may touch a held vehicle, or if a held vehicle was
        given a velocity."""
        if not self._names:
            return None
        looks = self._touchable or self._seen != self._world.requests.changes or self._in_motion().any()
        return 0 if looks else None

    def before(self, tick: int, t_ns: int) -> None:
        """Let those vehicles go on which something acts. Commands and calls of this tick have been carried out."""
        self._seen = self._world.requests.changes
        touched = self._touched() if self._touchable else frozenset[int]()
        moving = dict(zip(self._names, self._in_motion().tolist(), strict=True))
        going = {name: why for name in self._names if (why := self._reason(name, touched, moving[name]))}
        if going:
            self._release(going)
        if self._names and not self._is_told:
            self._is_told = True
            self._world.say("held", f"{_listed(self._names)} held until the first command")
        self._keep(self._names)  # again, as bodies may have come, with the first solid one also the scene

    def save(self) -> HeldState:
        """Return who is held."""
        return HeldState(self._names)

    def check(self, state: Any) -> None:
        """Raise ValueError for a vehicle that is not one of the start."""
        for name in state.names:
            there = self._world.vehicles.get(name)
            if name not in self._start or there is None or there.row != self._start[name].row:
                raise ValueError("a vehicle is held that was not there at the start")

    def load(self, state: HeldState) -> None:
        """Hold these vehicles where they are, and no others."""
        self._hold(state.names)

    def forget(self, body: str) -> None:
        """A body is about to go."""
        if body in self._names:
            self._keep(tuple(name for name in self._names if name != body))

    # -- holding --------------------------------------------------------------------------------------------------------------------

    def _hold(self, names: tuple[str, ...]) -> None:
        hydro, flags = self._world.hydro, self._world.hydro.bodies["retired"]
        flags[flags == HELD] = 0
        for name in names:
            hydro.hold(self._start[name].row)
        self._keep(names)
        # Told with the next tick, behind the event of a reset.
        self._seen, self._is_told = -1, False

    def _release(self, going: Mapping[str, str]) -> None:
        for name, why in going.items():
            self._world.hydro.let_go(self._start[name].row)
            self._world.say("held", f'"{name}" is held no longer: {why}')
        self._keep(tuple(name for name in self._names if name not in going))

    def _keep(self, names: tuple[str, ...]) -> None:
        self._names, self._rows = names, [self._start[name].row for name in names]
        if self._world.scene is not None:
            self._world.scene.hold(self._rows)
        self._touchable = self._can_be_touched()

    def _let_go(self, args: Mapping[str, Json]) -> Json:
        wanted = str(args["vehicle"])
        if wanted and wanted not in self._names:
            there = ", ".join(self._names) or "nothing"
            raise Refused("bad_argument", f'"{shown(wanted)}" is not held; held is: {there}', "vehicle")
        self._release(dict.fromkeys((wanted,) if wanted else self._names, "world/let_go was called"))
        return None

    # -- why one is let go ------------------------------------------------------------------------------------------------------------

    def _reason(self, name: str, touched: frozenset[int], is_moving: bool) -> str:
        """Return why a vehicle is to be let go; "" if it is not."""
        member, start = self._world.members[name], self._start[name]
        if any(part.pilot.orders.armed for part in member.others if isinstance(part, Piloting)):
            return "its autopilot is armed"
        if _commands(self._world.hydro, start.places) != start.commands:
            return _commanded(member)
        if start.row in touched:
            return "something touched it"
        return "it was given a velocity" if is_moving else ""

    def _in_motion(self) -> NDArray[np.bool_]:
        """Return which of the held vehicles (n) have a velocity: somebody has set it."""
        found: NDArray[np.bool_] = np.any(self._world.hydro.state[self._rows, NU:], axis=1)
        return found

    def _can_be_touched(self) -> bool:
        """Return whether something solid can move while a solid vehicle is held."""
        if not self._names or self._world.scene is None:
            return False
        solid = [member for member in self._world.members.values() if member.solid is not None and not member.led]
        held = sum(member.vehicle.name in self._names for member in solid)
        return 0 < held < len(solid)

    def _touched(self) -> frozenset[int]:
        """Return the rows of the bodies on which a contact acted in the last tick."""
        contacts, impulse, _ = self._world.hydro.touched
        acts = impulse.any(axis=1)
        return frozenset(contacts.body_a[acts].tolist()) | frozenset(contacts.body_b[acts].tolist())


def _neutral(hydro: Hydrodynamics, row: int) -> _Neutral:
    def rows(kind: str) -> slice:
        first = int(hydro.bodies[f"{kind}_first"][row])
        return slice(first, first + int(hydro.bodies[f"{kind}_count"][row]))

    places = rows("thruster"), rows("servo"), rows("wrench")
    return _Neutral(row, places, _commands(hydro, places))


def _commands(hydro: Hydrodynamics, places: tuple[slice, slice, slice]) -> tuple[bytes, bytes, bytes]:
    thrusters, servos, wrenches = places
    commands = hydro.thrusters["command"][thrusters], hydro.servos["command"][servos], hydro.wrenches["bias"][wrenches]
    # -0.0 is as neutral as 0.0, and has other bytes.
    return tuple(np.ascontiguousarray(command + 0.0).tobytes() for command in commands)  # type: ignore[return-value]  # three of them


def _commanded(member: Member) -> str:
    """Return which actuator of a vehicle was commanded last, in words."""
    slots = [slot for slot in member.actuators if slot.last_value]
    newest = max(slots, key=lambda slot: slot.last_tick, default=None)
    return "something on board acts" if newest is None else f"{newest.path} was commanded by {newest.source}"


def _listed(names: tuple[str, ...]) -> str:
    shown = ", ".join(f'"{name}"' for name in names[:5])
    more = len(names) - 5
    return f"{shown} and {more} more are" if more > 0 else f"{shown} {'is' if len(names) == 1 else 'are'}"
