"""The bodies of a world with all that belongs to them, and who knows how they are made."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from uwserver.physics.dynamics.params import BodyParams
from uwserver.physics.geometry.shapes import Solid
from uwserver.ports import Service
from uwserver.world.components import ActuatorSlot
from uwserver.world.part import Carry, Part
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.vehicle import Vehicle


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One body of a world with all that belongs to it; it comes and goes as a whole.

    Attributes:
        vehicle: the body, also of a free object.
        sensors, actuators: its components.
        services: those of its components, and what they do.
        solid: its collision shapes; None for none.
        others: whatever else lives and goes with it, as an autopilot.
    """

    vehicle: Vehicle
    sensors: tuple[SensorSlot, ...] = ()
    actuators: tuple[ActuatorSlot, ...] = ()
    services: tuple[tuple[Service, Carry], ...] = ()
    solid: Solid | None = None
    others: tuple[Part, ...] = ()

    @property
    def parts(self) -> tuple[Part, ...]:
        """All that comes and goes with the body."""
        return (*self.sensors, *self.actuators, *self.others)


class Population(Part):
    """Who is in the world: the part that knows how bodies and their components are made."""

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
