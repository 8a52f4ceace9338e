"""The bodies of a world with everything that belongs to them, and the contract of the part that makes bodies."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Iterable, Sequence
from dataclasses import InitVar, dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import Solid
from uwserver.ports import Service
from uwserver.world.parts.part import Carry, Part, is_awake
from uwserver.world.parts.vehicle import Vehicle
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.stepping.commands import ActuatorSlot

if TYPE_CHECKING:
    from uwserver.physics.scene import Scene


class ByPath(NamedTuple):
    """What belongs to a body, by path. `awake` has those parts that act in a tick or listen to samples."""

    awake: tuple[Part, ...]
    sensors: dict[str, SensorSlot]
    actuators: dict[str, ActuatorSlot]
    parts: dict[str, Part]


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One body of a world with everything that belongs to it. It is added and removed as a whole.

    Attributes:
        vehicle: the body; also that of a free object.
        sensors, actuators: its components.
        solid: its collision shapes; None for none.
        others: other parts that belong to it, such as an autopilot.
        is_object: whether it is a free object and no vehicle, whatever its model is called.
        led: whether it is moved from outside: it pushes others and yields to nothing.
        offered, carry: the services of its components, and the function of each.
        by_path: everything else that belongs to it, by path. Made once, as bodies are added and removed within a tick.

    Args:
        services: services of its components, each with its function.
    """

    vehicle: Vehicle
    sensors: tuple[SensorSlot, ...] = ()
    actuators: tuple[ActuatorSlot, ...] = ()
    services: InitVar[Iterable[tuple[Service, Carry]]] = ()
    solid: Solid | None = None
    others: tuple[Part, ...] = ()
    is_object: bool = False
    led: bool = False
    offered: tuple[Service, ...] = field(init=False, repr=False)
    carry: tuple[Carry, ...] = field(init=False, repr=False)
    by_path: ByPath = field(init=False, repr=False)

    def __post_init__(self, services: Iterable[tuple[Service, Carry]]) -> None:
        # Two tuples instead of pairs or dicts: with a hundred vehicles, there are thousands of services.
        offered, carry = tuple(zip(*services, strict=True)) or ((), ())
        object.__setattr__(self, "offered", offered)
        object.__setattr__(self, "carry", carry)
        by_path = ByPath(
            tuple(part for part in self.parts if is_awake(part)),
            {slot.port.path: slot for slot in self.sensors},
            {slot.port.path: slot for slot in self.actuators},
            {part.path: part for part in self.parts},
        )
        object.__setattr__(self, "by_path", by_path)

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts that belong to the body."""
        return (*self.sensors, *self.actuators, *self.others)


def place_solids(scene: Scene, placed: dict[Member, int], members: Collection[Member]) -> None:
    """Place the solid bodies in a scene, and remove all others.

    Args:
        scene: scene of the world.
        placed: the bodies in the scene, with their ids; is updated.
        members: the bodies of the world.
    """
    there = set(members)
    for member in [member for member in placed if member not in there]:
        scene.remove(placed.pop(member))
    for member in members:
        if member.solid is not None and member not in placed:
            placed[member] = scene.add_moving(member.solid, member.vehicle.row, member.led)


class Population(Part):
    """The bodies in the world: the part that knows how bodies and their components are made."""

    @abstractmethod
    def likes(self) -> dict[str, str]:
        """Return, by name of each body, which body of the scenario it is a copy of."""

    @abstractmethod
    def is_here(self, state: Any) -> bool:
        """Return whether the bodies of a state are those of the world now."""

    @abstractmethod
    def parts_of(self, state: Any) -> set[str]:
        """Return the paths of the parts that the bodies of a checked state have, without making these bodies."""

    @abstractmethod
    def params_of(self, state: Any) -> Sequence[BodyParams]:
        """Return the parameters of all rows of a checked state, also of bodies that are gone, without making these bodies."""

    @abstractmethod
    def members_of(self, state: Any) -> list[Member]:
        """Return the bodies of a checked state. Bodies that are there already stay as they are. All rows are made anew."""

    @abstractmethod
    def admit(self, state: Any, members: Iterable[Member]) -> None:
        """Let the bodies of a state be in the world, and no others."""
