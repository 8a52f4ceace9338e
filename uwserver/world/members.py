"""The bodies of a world with all that belongs to them, and who knows how they are made."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Iterable, Sequence
from dataclasses import InitVar, dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import Solid
from uwserver.ports import Service
from uwserver.world.components import ActuatorSlot
from uwserver.world.part import Carry, Part, is_awake
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.vehicle import Vehicle

if TYPE_CHECKING:
    from uwserver.physics.scene import Scene


class ByPath(NamedTuple):
    """What belongs to a body, by path; and those of its parts that act or hear."""

    awake: tuple[Part, ...]
    sensors: dict[str, SensorSlot]
    actuators: dict[str, ActuatorSlot]
    parts: dict[str, Part]


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One body of a world with all that belongs to it; it comes and goes as a whole.

    Attributes:
        vehicle: the body, also of a free object.
        sensors, actuators: its components.
        solid: its collision shapes; None for none.
        others: whatever else lives and goes with it, as an autopilot.
        is_object: it is a free object, not a vehicle, whatever its model is called.
        led: from outside, as one that follows somebody's poses: it pushes others and yields to nothing.
        offered, carry: services of its components, and what each does.
        by_path: all the rest of it; made once, as bodies come and go within a tick.

    Args:
        services: those of its components, and what they do.
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
        """All that comes and goes with the body."""
        return (*self.sensors, *self.actuators, *self.others)


def place_solids(scene: Scene, placed: dict[Member, int], members: Collection[Member]) -> None:
    """Let the solid ones of some bodies, and no others, stand in a scene.

    Args:
        scene: of the world.
        placed: those that stand there, with their ids; follows.
        members: the bodies.
    """
    there = set(members)
    for member in [member for member in placed if member not in there]:
        scene.remove(placed.pop(member))
    for member in members:
        if member.solid is not None and member not in placed:
            placed[member] = scene.add_moving(member.solid, member.vehicle.row, member.led)


class Population(Part):
    """Who is in the world: the part that knows how bodies and their components are made."""

    @abstractmethod
    def likes(self) -> dict[str, str]:
        """What of the scenario each body in the world is a copy of, by name."""

    @abstractmethod
    def is_here(self, state: Any) -> bool:
        """Whether the bodies of a state are those of the world now."""

    @abstractmethod
    def parts_of(self, state: Any) -> set[str]:
        """Paths of the parts that the bodies of a checked state have; makes none of these bodies."""

    @abstractmethod
    def params_of(self, state: Any) -> Sequence[BodyParams]:
        """What their rows are made of, also of those that are gone; likewise."""

    @abstractmethod
    def members_of(self, state: Any) -> list[Member]:
        """The bodies of a checked state, those that are there already as they are. All rows are made anew."""

    @abstractmethod
    def admit(self, state: Any, members: Iterable[Member]) -> None:
        """Let the bodies of a state be in the world, and no others."""
