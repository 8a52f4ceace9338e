"""One copy: its world, the state of that world at the start, and the memory of what its ticks write.

Worlds that are built one after the other lie scattered among Python's objects. A thousand of them would be stepped at a third of the speed,
as the processor waits for memory pages. So all copies have one block of memory, copy after copy: memory in sequence is fetched ahead.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, TypeVar

import numpy as np

from uwserver.autopilot.ports import StateSensor
from uwserver.physics.collision.contacts import NO_IMPULSES
from uwserver.physics.kernel import layout
from uwserver.physics.kernel.arrays import Array, FloatArray, IntArray
from uwserver.physics.kernel.layout import Forms
from uwserver.physics.kernel.team import ALONE
from uwserver.ports import Refused
from uwserver.sensors.base import IdealSensor, Sensor
from uwserver.sensors.compiled import CompiledSensor, SensorKernel
from uwserver.step import rows
from uwserver.step.rows import DONE
from uwserver.step.streams import ENTRY
from uwserver.world.parts.part import Part, State
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.stepping.piloting import Piloting
from uwserver.world.stepping.stepping import next_tick
from uwserver.world.world import World

T = TypeVar("T")

_RUNNING = ("state", "bodies", "thrusters", "wrenches", "servos", "contact_nu_dot", "flows")
"""Arrays of `Hydrodynamics` that change in a run."""
_CONSTANT = ("shapes", "tables", "lags", "foils", "propellers", "weights", "derivatives", "hulls")
"""Arrays of `Hydrodynamics` that never change in a run."""
_SCHEDULE = ("course", "writings", "repeatings", "repeated", "shares", "scheduled", "members")
"""Arrays of a step that change only when other sensors are due."""
_STATELESS = {"world/bodies", "world/samples", "world/autopilots", "world/commands", "world/population"}
"""Parts whose state is only in arrays, or never changes in a batch."""
_NO_ENTRIES, _NO_NUMBERS = np.zeros(0, ENTRY), np.zeros(0)
LINE = 64
"""Bytes of a memory line, which the processor fetches together."""


class Copy:
    """A world that a batch steps. Its arrays may move whenever Python acts in it (`row`).

    Attributes:
        world: as `uwserver.load` gives it; its own `step` is never called.
        kernels: kernels of its sensors.
        params: params of its bodies, as in the scenario.
    """

    def __init__(self, world: World, measured: Collection[str]) -> None:
        """Take a world, in which these sensors measure."""
        self.world = world
        world.subscribe(())
        world.sensing.choose(measured)
        # The threads of a batch share the copies, not the bodies of one copy.
        world.threads.use(1)
        world.hydro.set_team(ALONE, 1)
        sensors = [slot.sensor for slot in world.sensors.values()]
        self.kernels: dict[int, SensorKernel] = {
            id(s.kernel): s.kernel for s in sensors if isinstance(s, CompiledSensor)
        }
        self._stateful = [part for part in world.parts.values() if _stateful(part)]
        self._find_arrays()
        self.params = world.hydro.params
        self.keep()
        self._nominal = self._kept, self._states

    def _find_arrays(self) -> None:
        # As plain bytes, because numpy copies records field by field.
        self._live = [array.reshape(-1).view(np.uint8) for array in self._arrays()]

    def move(self, place: Place) -> None:
        """Move everything that a tick writes to other memory."""
        self.world.hydro.move(place)
        self.world.sensor_arrays.move(place)
        self.world.stepping.given.move(place)
        self._find_arrays()

    @property
    def size(self) -> int:
        """Bytes that `move` needs, with each array in memory lines of its own."""
        sizes: list[int] = []

        def weigh(array: Any) -> Any:
            sizes.append(lines(array.nbytes))
            return array

        self.move(weigh)
        return sum(sizes)

    def constants(self) -> dict[str, Any]:
        """Return copies of the arrays that no tick changes, by name. The caller of `share` must keep them alive."""
        hydro, given = vars(self.world.hydro), self.world.stepping.given.rows
        return {name: hydro[name].copy() for name in _CONSTANT} | {name: given[name].copy() for name in _SCHEDULE}

    def share(self, constants: Mapping[str, Any]) -> None:
        """Read the constant arrays of another copy where they are equal, so that a tick needs less of the caches."""
        hydro, given = self.world.hydro, self.world.stepping.given
        _share(hydro.table, layout.WORLD, _CONSTANT, vars(hydro), constants)
        _share(given.table, rows.FORMS, _SCHEDULE, given.rows, constants)

    def _arrays(self) -> list[Any]:
        hydro, sensor_arrays = self.world.hydro, self.world.sensor_arrays
        arrays = [getattr(hydro, name) for name in _RUNNING]
        arrays += [
            pool.rows
            for pool in (sensor_arrays.heads, sensor_arrays.streams, sensor_arrays.operations, sensor_arrays.voices)
        ]
        arrays += [
            sensor_arrays.numbers.rows,
            *(sensor_arrays.rows_of(kernel).rows for kernel in self.kernels.values()),
        ]
        return arrays

    # -- the start ------------------------------------------------------------------------------------------------------------------

    def keep(self) -> None:
        """Keep the present state, to which `restore` returns."""
        self._kept: list[Array] = [array.copy() for array in self._live]
        self._states: list[tuple[Part, State]] = [(part, part.save()) for part in self._stateful]

    def restore_nominal(self) -> None:
        """Return to the start, with the parameters of the scenario."""
        self._kept, self._states = self._nominal
        self.world.hydro.params = self.params
        self.restore()

    def restore(self) -> None:
        """Return to the start, bit for bit. Callers that wait for the end of a manoeuvre get an answer."""
        self.world.jump(0)
        for part, state in self._states:
            part.load(state)
        self.world.parts["world/commands"].load(None)
        self.world.hydro.touching.keep(NO_IMPULSES)
        self.world.sensor_arrays.put_in_flight(0, _NO_ENTRIES, _NO_NUMBERS)
        for live, kept in zip(self._live, self._kept, strict=True):
            live[:] = kept

    # -- in a run -------------------------------------------------------------------------------------------------------------------

    def act(self, act: Callable[[World], T], why: int = DONE) -> T:
        """Let Python act in the world between two ticks, and return the result. `begin` must follow. `why` is the reason for which its last
        step has stopped."""
        self.world.stepping.end(why)
        return act(self.world)

    def begin(self) -> tuple[int, int]:
        """Prepare the next tick for compiled code. Returns the ticks before which parts act again: those that act first, and those that
        watch."""
        stepping, tick = self.world.stepping, self.world.tick
        stepping.begin(tick, [])
        stepping.ask(tick, tick)
        return next_tick(stepping.schedule.first), next_tick(stepping.schedule.watch)

    @property
    def row(self) -> tuple[int, ...]:
        """Addresses of the arrays now, as `step.rows.COPY`."""
        given, sensor_arrays = self.world.stepping.given, self.world.sensor_arrays
        sensors, values, delivered_values = sensor_arrays.to_deliver()
        tables = given.table, sensors, self.world.hydro.table, values, delivered_values
        return *(table.ctypes.data for table in tables), values.shape[1], *sensor_arrays.room, self.world.tick, DONE


def for_copies(name: str, given: Any, shape: tuple[int, ...], which: IntArray) -> FloatArray:
    """Return a new array (k, *shape) of numbers for k copies.

    Args:
        name: name of what is given, for the error.
        given: an array of this shape, or of the shape of one copy's value, which then holds for all of them.
        shape: shape of one copy's value.
        which: (k) numbers of the copies.

    Raises:
        Refused: these are no numbers, or they have another shape.
    """
    try:
        array = np.array(given, np.float64)
    except (TypeError, ValueError) as error:
        raise Refused("bad_argument", f'"{name}" must be numbers: {error}', name) from None
    wanted = (len(which), *shape)
    if array.shape == shape:
        array = np.broadcast_to(array, wanted).copy()
    if array.shape != wanted:
        text = f'"{name}" has the shape {array.shape}: {wanted} is needed, or {shape} for all copies alike'
        raise Refused("bad_shape", text, name)
    return array


def _share(
    table: IntArray, forms: Forms, names: Collection[str], mine: Mapping[str, Any], others: Mapping[str, Any]
) -> None:
    for k, name in enumerate(forms):
        if name in names and mine[name].tobytes() == others[name].tobytes():
            table[k, 0] = others[name].ctypes.data


def _stateful(part: Part) -> bool:
    """Return whether a part has state that is not in the arrays."""
    if isinstance(part, SensorSlot):
        is_made = any(stream.is_ready_made for stream in part.streams)
        return not isinstance(part.sensor, CompiledSensor) or part.has_loose or is_made
    return part.path not in _STATELESS


# -- memory -----------------------------------------------------------------------------------------------------------------------------


Place = Callable[[Any], Any]
"""Returns a copy of an array in other memory."""


class Memory:
    """The memory of n copies."""

    def __init__(self, n: int, size: int) -> None:
        """Reserve `size` bytes for each of n copies, in whole lines."""
        self._size = size
        raw = np.zeros(n * size + LINE, np.uint8)
        first = -raw.ctypes.data % LINE
        self._bytes = raw[first : first + n * size]

    def of(self, i: int) -> Place:
        """Return a function that places arrays in the memory of copy i, from its beginning. What was there before is lost."""
        free = self._bytes[i * self._size : (i + 1) * self._size]

        def place(array: Any) -> Any:
            nonlocal free
            if array.nbytes > len(free):  # This copy needs more than the others.
                return array.copy()
            there = free[: array.nbytes].view(array.dtype).reshape(array.shape)
            there.reshape(-1).view(np.uint8)[:] = array.reshape(-1).view(np.uint8)
            free = free[lines(array.nbytes) :]
            return there

        return place


def lines(count: int) -> int:
    """Return the bytes of the whole lines that hold `count` bytes."""
    return -(-count // LINE) * LINE


# -- which sensors measure --------------------------------------------------------------------------------------------------------------


def measured_of(world: World, sensors: Collection[str] | None) -> tuple[str, ...]:
    """Return the paths of the sensors that measure in the copies of a world.

    Args:
        world: one of the copies.
        sensors: the sensors that the caller wants; None for all except those that show the state of an autopilot, which is mostly text.
    """
    pilots = [part.pilot for part in world.parts.values() if isinstance(part, Piloting)]
    heard = {port for pilot in pilots for port in (*pilot.spec.inputs.ports, *pilot.spec.inputs.text_ports)}
    found = {
        path
        for path, slot in world.sensors.items()
        if slot.sensor.supplies  # as a battery, which supplies the thrusters
        or any(stream.port.path in heard for stream in slot.streams)
        or (path in sensors if sensors is not None else not isinstance(slot.sensor, StateSensor))
    }
    left = [*found]
    while left:
        path = left.pop()
        vehicle = path.partition("/")[0]
        needed = {f"{vehicle}/{name}" for name in world.sensors[path].sensor.needs} - found
        found |= needed
        left += needed
    return tuple(path for path in world.sensors if path in found)


def draws_in_python(sensor: Sensor) -> bool:
    """Return whether a sensor draws its own random errors in Python."""
    return not (isinstance(sensor, CompiledSensor | IdealSensor | StateSensor) or sensor.repeats)
