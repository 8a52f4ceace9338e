"""One copy: its world, and where that stood at the start."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwserver.copies.memory import Place, lines
from uwserver.physics.kernel.arrays import Array
from uwserver.sensors.bank import Bank, BankSensor
from uwserver.world.components import ActuatorSlot
from uwserver.world.faults import Faults
from uwserver.world.part import Part, State
from uwserver.world.piloting import Piloting
from uwserver.world.surroundings import Flowing
from uwserver.world.world import World

_RUNNING = ("state", "bodies", "thrusters", "wrenches", "servos", "contact_nu_dot", "flows")
"""Arrays of `Hydrodynamics` that change in a run."""
_REMEMBERS = (ActuatorSlot, Faults, Flowing, Piloting)
"""Parts whose state does not stand in arrays alone."""


class Copy:
    """A world that a batch steps: but for `move` its arrays never change places.

    Attributes:
        world: as `uwserver.load` gives it; its own `step` is never called.
        banks: of its sensors.
        pilots: its autopilots.
        faults, commands: parts of it that act at times.
        params: of its bodies, as the scenario says.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        world.want(())
        # Threads share the copies among them, not the bodies of one.
        world.threads.want(1)
        sensors = [slot.sensor for slot in world.sensors.values()]
        self.banks: dict[int, Bank] = {id(s.bank): s.bank for s in sensors if isinstance(s, BankSensor)}
        self.pilots = [part.pilot for part in world.parts.values() if isinstance(part, Piloting)]
        (self.faults,) = (part for part in world.own_parts if isinstance(part, Faults))
        self.commands = world.parts["world/commands"]
        self._remembers: list[Part] = [part for part in world.parts.values() if isinstance(part, _REMEMBERS)]
        self._find()
        self.params = world.hydro.params
        self.keep()
        self._nominal = self._kept, self._states

    def _find(self) -> None:
        # As plain bytes: records are copied field by field.
        self._live = [array.reshape(-1).view(np.uint8) for array in self._arrays()]

    def move(self, place: Place) -> None:
        """Have all that a tick writes lie elsewhere."""
        self.world.hydro.move(place)
        self.world.instruments.move(place)
        self._find()

    @property
    def size(self) -> int:
        """Bytes that `move` finds places for, each array in lines of its own."""
        sizes: list[int] = []

        def weigh(array: Any) -> Any:
            sizes.append(lines(array.nbytes))
            return array

        self.move(weigh)
        return sum(sizes)

    def _arrays(self) -> list[Any]:
        hydro, instruments = self.world.hydro, self.world.instruments
        arrays = [getattr(hydro, name) for name in _RUNNING]
        arrays += [pool.rows for pool in (instruments.heads, instruments.streams, instruments.operations)]
        arrays += [instruments.numbers.rows, *(instruments.rows_of(bank).rows for bank in self.banks.values())]
        return arrays

    def keep(self) -> None:
        """What it is now is what `restore` goes back to."""
        self._kept: list[Array] = [array.copy() for array in self._live]
        self._states: list[tuple[Part, State]] = [(part, part.save()) for part in self._remembers]

    def restore_nominal(self) -> None:
        """Be as at the start, and as the scenario says."""
        self._kept, self._states = self._nominal
        self.world.hydro.params = self.params
        self.restore()

    def restore(self) -> None:
        """Be as at the start, bit for bit; whoever waits for the end of a way is answered."""
        self.world.jump(0)
        for part, state in self._states:
            part.load(state)
        self.commands.load(None)
        for live, kept in zip(self._live, self._kept, strict=True):
            live[:] = kept

    def acts(self, part: Part, tick: int) -> None:
        """Let a part of the world act before the bodies move."""
        self.world.tick = tick
        part.before(tick, self.world.t_ns)

    def fly_on(self, tick: int) -> None:
        """Let the autopilots go on whose steps have stopped for something that is rare."""
        self.world.tick = tick
        for pilot in self.pilots:
            need = int(pilot.seat.row["c"]["need"])
            if need:
                pilot.attend(need, self.world.hydro.table, self.world.t_ns)
