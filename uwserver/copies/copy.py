"""One copy: its world, and where that stood at the start."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, TypeVar

import numpy as np

from uwserver.copies.memory import Place, lines
from uwserver.physics.collision.contacts import NO_IMPULSES
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import Array, IntArray
from uwserver.physics.kernel.layout import Forms
from uwserver.physics.kernel.team import ALONE
from uwserver.sensors.bank import Bank, BankSensor
from uwserver.step import rows
from uwserver.step.rows import DONE
from uwserver.step.streams import ENTRY, NEVER
from uwserver.world.part import Before, Part, State
from uwserver.world.sensor_slot import SensorSlot
from uwserver.world.world import World

T = TypeVar("T")

_RUNNING = ("state", "bodies", "thrusters", "wrenches", "servos", "contact_nu_dot", "flows")
"""Arrays of `Hydrodynamics` that change in a run."""
_CONSTANT = ("shapes", "tables", "lags", "foils", "propellers", "weights", "derivatives", "hulls")
"""And those that no run changes."""
_SCHEDULE = ("course", "writings", "repeatings", "repeated", "shares", "scheduled", "members")
"""Arrays of a step that only change when others are due."""
_FORGETFUL = {"world/bodies", "world/samples", "world/autopilots", "world/commands", "world/population"}
"""Parts whose state stands in arrays alone, or never changes in a batch."""
_NO_ENTRIES, _NO_NUMBERS = np.zeros(0, ENTRY), np.zeros(0)


class Copy:
    """A world that a batch steps. Its arrays may come to lie elsewhere whenever Python acts in it (`row`).

    Attributes:
        world: as `uwserver.load` gives it; its own `step` is never called.
        banks: of its sensors.
        params: of its bodies, as the scenario says.
    """

    def __init__(self, world: World, measured: Collection[str]) -> None:
        """Of a world of which these sensors measure."""
        self.world = world
        world.want(())
        world.sensing.choose(measured)
        # Threads share the copies among them, not the bodies of one.
        world.threads.want(1)
        world.hydro.set_team(ALONE, 1)
        sensors = [slot.sensor for slot in world.sensors.values()]
        self.banks: dict[int, Bank] = {id(s.bank): s.bank for s in sensors if isinstance(s, BankSensor)}
        self._remembers = [part for part in world.parts.values() if _remembers(part)]
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
        self.world.stepping.given.move(place)
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

    def constants(self) -> dict[str, Any]:
        """Copies of what no tick changes, by name; who others `share` with keeps them."""
        hydro, given = vars(self.world.hydro), self.world.stepping.given.rows
        return {name: hydro[name].copy() for name in _CONSTANT} | {name: given[name].copy() for name in _SCHEDULE}

    def share(self, constants: Mapping[str, Any]) -> None:
        """Read there what no tick changes, where it is the same: so much less goes through the caches in a tick."""
        hydro, given = self.world.hydro, self.world.stepping.given
        _share(hydro.table, layout.WORLD, _CONSTANT, vars(hydro), constants)
        _share(given.table, rows.FORMS, _SCHEDULE, given.rows, constants)

    def _arrays(self) -> list[Any]:
        hydro, instruments = self.world.hydro, self.world.instruments
        arrays = [getattr(hydro, name) for name in _RUNNING]
        arrays += [
            pool.rows for pool in (instruments.heads, instruments.streams, instruments.operations, instruments.voices)
        ]
        arrays += [instruments.numbers.rows, *(instruments.rows_of(bank).rows for bank in self.banks.values())]
        return arrays

    # -- the start ------------------------------------------------------------------------------------------------------------------

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
        self.world.parts["world/commands"].load(None)
        self.world.hydro.touching.keep(NO_IMPULSES)
        self.world.instruments.send_on_their_way(0, _NO_ENTRIES, _NO_NUMBERS)
        for live, kept in zip(self._live, self._kept, strict=True):
            live[:] = kept

    # -- in a run -------------------------------------------------------------------------------------------------------------------

    def act(self, act: Callable[[World], T], why: int = DONE) -> T:
        """Let Python act in its world between two ticks, and return what that gives; `begin` follows. `why` its last step has stopped."""
        self.world.stepping.end(why)
        return act(self.world)

    def begin(self) -> tuple[int, int]:
        """The next tick is to be made by compiled code. Returns before which one parts act again that do so first, and those that watch."""
        stepping, tick = self.world.stepping, self.world.tick
        stepping.begin(tick, [])
        stepping.ask(tick, tick)
        return _next(stepping.turns.first), _next(stepping.turns.watch)

    @property
    def row(self) -> tuple[int, ...]:
        """`step.rows.COPY`: where all lies now."""
        given, instruments = self.world.stepping.given, self.world.instruments
        sensors, values, told_values = instruments.to_deliver()
        tables = given.table, sensors, self.world.hydro.table, values, told_values
        return *(table.ctypes.data for table in tables), values.shape[1], *instruments.room, self.world.tick, DONE


def _share(
    table: IntArray, forms: Forms, names: Collection[str], mine: Mapping[str, Any], others: Mapping[str, Any]
) -> None:
    for k, name in enumerate(forms):
        if name in names and mine[name].tobytes() == others[name].tobytes():
            table[k, 0] = others[name].ctypes.data


def _next(turns: Iterable[tuple[Part, Before]]) -> int:
    return min((part.next_tick for part, _ in turns if part.next_tick is not None), default=NEVER)


def _remembers(part: Part) -> bool:
    """Whether its state does not stand in arrays alone."""
    if isinstance(part, SensorSlot):
        is_made = any(stream.is_ready_made for stream in part.streams)
        return not isinstance(part.sensor, BankSensor) or part.is_wordy or is_made
    return part.path not in _FORGETFUL
