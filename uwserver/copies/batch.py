"""The batch: n copies of a scenario's world, with arrays in and arrays out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from uwserver.copies.commands import Commands
from uwserver.copies.copy import Copy, Memory, draws_in_python, measured_of
from uwserver.copies.parameters import Parameters
from uwserver.copies.readings import Readings, described
from uwserver.copies.steps import Steps
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import STATE_SIZE
from uwserver.ports import Event, Json, Refused
from uwserver.ports.checks import checked_seed, checked_whole, find
from uwserver.step import rows
from uwserver.step.streams import NEVER
from uwserver.world.state.held_start import HeldStart
from uwserver.world.stepping.piloting import Piloting
from uwserver.world.stepping.stepping import run_parts
from uwserver.world.world import World

T = TypeVar("T")

Copies = int | Sequence[int] | NDArray[Any] | None
"""Copies, as numbers or as a mask (n) of truths; None for all."""

_MOST_EVENTS = 4096
_EXACT = 2**53
"""Whole numbers below this are exact as floats."""


class Batch:
    """n copies of a world, stepped in one call. Build one with `uwserver.batch`; not thread-safe.

    Each copy is the world that `uwserver.load` gives for the scenario with the copy's seed. Stepped with the same commands, it has the same
    states and samples, bit for bit. Each has its own clock, which a reset sets to 0, and its own water, whose waves and currents follow
    that clock.

    Returned arrays belong to the caller. States are (n, 13): p_NB (m, in N: north, east, down), q_NB (w x y z), v_NB_B (m/s) and w_NB_B
    (rad/s), both in B.

    Attributes:
        n: number of copies.
        seeds: (n) seeds of the copies; `reset` sets them.
        vehicles: names of the bodies in each copy.
        ports, commands: by path, the sensors that measure, and the actuators.
    """

    def __init__(
        self,
        build: Callable[[int], World],
        seeds: Sequence[int],
        sensors: Collection[str] | None = None,
        parameters: Mapping[str, Any] | None = None,
        threads: int = 1,
    ) -> None:
        """Make the copies of a scenario that `copies.start.check` has accepted.

        Args:
            build: makes a world with a seed.
            seeds: seeds of the copies.
            sensors: paths of the sensors that measure; None for all. Batteries, and sensors that an autopilot uses, always measure.
            parameters: see `reset`.
            threads: number of threads that step the copies, that of the caller included; the results do not depend on it.

        Raises:
            Refused: no such sensor, or as `reset`.
        """
        self._build = build
        self.n, self.seeds = len(seeds), list(seeds)
        worlds = [build(seed) for seed in self.seeds]
        world = worlds[0]
        for path in sensors or ():
            find("port", path, world.sensors)
        self._measured = measured_of(world, sensors)
        self._copies = [Copy(each, self._measured) for each in worlds]
        self._memory = Memory(self.n, self._copies[0].size)
        self._steps = Steps(self._copies, threads)
        self._commands = Commands(self._copies, self._steps.rows)
        unscaled = [path for path in self._measured if draws_in_python(world.sensors[path].sensor)]
        self._parameters = Parameters(self.n, unscaled)
        self.vehicles = tuple(world.vehicles)
        self._streams = {
            stream.port.path: (k, stream.port)
            for slot in world.sensors.values()
            if slot.path in self._measured
            for k, stream in zip(slot.stream_numbers, slot.streams, strict=True)
        }
        self.ports = {path: port for path, (_, port) in self._streams.items()}
        self.commands = dict(self._commands.ports)
        self._services = tuple(f"{part.path}/" for part in world.parts.values() if isinstance(part, Piloting))
        self._time_of = world.ticks.time_of
        self._rate, self.dt, self._last = world.rate_hz, world.hydro.dt, world.stepping.given.last
        self._next_faults, self._next_watch = np.full((2, self.n), NEVER, np.int64)
        self._held: NDArray[np.bool_] = np.zeros(self.n, np.bool_)
        self._events: list[tuple[int, Event]] = []
        self._copies[0].move(self._memory.of(0))
        self._constants = self._copies[0].constants()  # copied, as that copy may be replaced
        for i, copy in enumerate(self._copies):
            self._place(i, copy)
        self.reset(**(parameters or {}))

    def __len__(self) -> int:
        return self.n

    def __repr__(self) -> str:
        return f"<Batch of {self.n} {self._copies[0].world.name}: {', '.join(self.vehicles)}>"

    @property
    def threads(self) -> int:
        """Number of threads that step the copies, that of the caller included."""
        return self._steps.ranges.count

    def close(self) -> None:
        """End the other threads; the caller's thread alone steps the copies from now on. They also end when the batch is dropped."""
        self._steps.ranges.close()

    # -- time -----------------------------------------------------------------------------------------------------------------------

    @property
    def ticks(self) -> IntArray:
        """(n) ticks of each copy since its start."""
        return self._steps.ticks

    @property
    def t_s(self) -> FloatArray:
        """(n) simulation time of each copy, s."""
        ticks, num, den = self.ticks, self._rate.numerator, self._rate.denominator
        if int(ticks.max()) * den < _EXACT:
            return np.asarray(ticks * den / num)
        return np.array([tick * den / num for tick in ticks.tolist()])

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """(n) whether the state of a body of the copy is not finite, or absurdly fast. Such a copy stands still until it is reset."""
        return self._steps.lost >= 0

    def step(self, ticks: int = 1) -> NDArray[np.bool_]:
        """Make `ticks` ticks in all copies, except those that diverge. Returns `diverged`.

        Raises:
            Refused: less than one tick, or no whole number of them.
        """
        if type(ticks) is not int or ticks < 1:
            ticks = checked_whole("ticks", ticks, 1, "step takes a whole number of ticks, 1 or more")
        begin, told = self.ticks, len(self._events)
        now, goal = begin, begin + ticks
        while (going := (self._steps.lost < 0) & (now < goal)).any():
            # A copy that had an event lags behind. The copies that lag most are stepped first.
            left = goal - now
            behind = int(left[going].max())
            others = left[going & (left < behind)]
            going &= left == behind
            which = np.flatnonzero(going)
            self._act_before(which, going, now)
            ticks = min(self._undisturbed_ticks(which, going, now), behind - int(others.max(initial=0)))
            for i in self._steps.carry(which, ticks):
                self._act(i, _do_nothing, self._steps.why(i))
            now = self.ticks
        # In the order in which single ticks of all copies would have given them.
        self._events[told:] = sorted(
            self._events[told:], key=lambda item: (item[1].tick - int(begin[item[0]]), item[0])
        )
        del self._events[:-_MOST_EVENTS]
        return self.diverged

    def _act_before(self, which: IntArray, going: NDArray[np.bool_], ticks: IntArray) -> None:
        """Do everything that acts before a tick, in the order of `World.advance`."""
        commands = self._commands
        for i in _due(self._next_faults <= ticks, which):
            self._act(i, lambda world: run_parts(world.stepping.schedule.first, world.tick, world.t_ns))
        for i, path, value in commands.apply(ticks, going):
            self._act(i, lambda world, path=path, value=value: world.command(path, **value))  # type: ignore[misc]
        for i in np.flatnonzero(self._held & commands.written).tolist():
            self._act(i, _tell_of_commands)
        commands.written[:] = False
        for i, path in commands.watch(ticks, which):
            text = f'no command for "{path}" in {self.commands[path].timeout_s:g} s: it went to neutral'
            tick = int(ticks[i])
            self._events.append((i, Event("watchdog", tick, self._time_of(tick), text)))
        for i in _due(self._next_watch <= ticks, which):
            self._act(i, lambda world: run_parts(world.stepping.schedule.watch, world.tick, world.t_ns))
        for i in _due(ticks > self._last, which):
            self._act(i, _do_nothing)  # Python gives the times of these ticks (`StepTable.begin_at`).

    def _undisturbed_ticks(self, which: IntArray, going: NDArray[np.bool_], ticks: IntArray) -> int:
        """Return for how many ticks, at least one, nothing acts before a tick of any of these copies."""
        nexts = np.minimum(np.minimum(self._next_faults, self._next_watch), self._last)
        return max(1, min(int((nexts - ticks)[which].min()), self._commands.quiet(ticks, which, going)))

    def _act(self, i: int, act: Callable[[World], T], why: int = rows.DONE) -> T:
        """Let Python act in a copy between two ticks, then collect its events and note when Python is needed again. `why` is the reason for
        which its last step has stopped."""
        try:
            return self._copies[i].act(act, why)
        finally:
            self._collect(i)

    def _collect(self, i: int) -> None:
        copy = self._copies[i]
        self._events += [(i, event) for event in copy.world.flush().events]
        self._next_faults[i], self._next_watch[i] = copy.begin()
        held = copy.world.parts.get(HeldStart.path)
        self._held[i] = isinstance(held, HeldStart) and bool(held.names)
        self._steps.find(i)

    def events(self) -> list[tuple[int, Event]]:
        """Return what has happened since the last call, with the number of the copy: watchdogs, faults, modes; the newest 4096 events."""
        events, self._events = self._events, []
        return events

    # -- in and out -----------------------------------------------------------------------------------------------------------------

    def command(self, port: str, copies: Copies = None, **value: Any) -> None:
        """Command an actuator of all copies, or of some: ``batch.command("rov/thrusters", u=array)``. It acts from the next `step` on.

        Args:
            port: path of the actuator, as in one world.
            copies: which copies; the others keep their command.
            value: by field: an array (k, *shape of the field) for the k copies in their order, or an array of the field's shape for all of
                them.

        Raises:
            Refused: unknown port or field, another shape, not finite, out of range, or held by an autopilot; no copy gets a command.
        """
        self._commands.post(port, value, self._numbers(copies), self.ticks)

    def call(self, service: str, copies: Copies = None, **args: Any) -> list[Json]:
        """Call a service of an autopilot (``rov/autopilot/arm``) of all copies, or of some, one after the other. Returns their results.

        Raises:
            Refused: unknown service, no service of an autopilot, or refused by a copy, whose number is in the text; the copies before it
                have been called.
        """
        world = self._copies[0].world
        find("service", service, world.services)
        if not service.startswith(self._services):
            raise Refused(
                "denied",
                f'"{service}" is a service of a whole world: a batch calls only services of autopilots',
                service,
            )
        results: list[Json] = []
        for i in self._numbers(copies).tolist():
            try:
                results.append(self._act(i, lambda world: world.call(service, **args)))
            except Refused as refused:
                raise Refused(refused.fault.code, f"copy {i}: {refused.fault.text}", refused.fault.where) from None
        return results

    def states(self, vehicle: str | None = None, out: FloatArray | None = None) -> FloatArray:
        """Return the states (n, 13) of a vehicle, by default of the first one: p_NB, q_NB, v_NB_B, w_NB_B.

        Args:
            vehicle: its name.
            out: (n, 13) float64, C-contiguous, to be filled and returned instead of a new array.

        Raises:
            Refused: no such vehicle.
            ValueError: `out` is another kind of array.
        """
        name = self.vehicles[0] if vehicle is None else vehicle
        find("vehicle", name, self._copies[0].world.vehicles)
        if out is None:
            out = np.empty((self.n, STATE_SIZE))
        elif out.shape != (self.n, STATE_SIZE) or out.dtype != np.float64 or not out.flags.c_contiguous:
            raise ValueError(f"out must be float64 ({self.n}, {STATE_SIZE}), C-contiguous, not {out.dtype} {out.shape}")
        self._steps.kernels.copy_states(self._steps.rows, self._copies[0].world.vehicles[name].row, out)
        return out

    def read(self, port: str, out: Readings | None = None) -> Readings:
        """Return the newest delivered samples of a sensor, by field.

        Args:
            port: path of a sensor that measures, or of one of its streams.
            out: earlier readings of this port, to be filled and returned instead of new ones.

        Raises:
            Refused: no such port.
            ValueError: `out` is of another port.
        """
        find("port", port, self.ports)
        if out is None:
            out = Readings(self.ports[port], self.n)
        elif out.port is not self.ports[port] or len(out.packed) != self.n:
            raise ValueError(f'out has readings of "{out.port.path}", not of "{port}" of this batch')
        self._steps.kernels.copy_newest(self._steps.rows, self._streams[port][0], out.packed, out.stamps)
        return out

    def describe(self) -> dict[str, Any]:
        """Return a description of all inputs and outputs as plain values: names, shapes, units, frames and meanings."""
        return described(self.n, float(self._rate), self.vehicles, self.ports, self.commands)

    @property
    def parameters(self) -> dict[str, FloatArray]:
        """Present values (n, *shape) of each parameter, by name."""
        return {name: values.copy() for name, values in self._parameters.values.items()}

    # -- the start ------------------------------------------------------------------------------------------------------------------

    def reset(self, copies: Copies = None, *, seeds: int | Sequence[int] | None = None, **parameters: Any) -> None:
        """Put all copies, or some, to their start: t = 0, the states of the scenario, and the random numbers of their seeds from the first
        one on.

        The other copies go on as if nothing had happened. Commands that have not acted yet are dropped.

        Args:
            copies: which copies.
            seeds: new seeds, one for all (which are then alike) or one for each. Their worlds are built anew, in some ms each.
            parameters: see `describe`; a parameter that is not given keeps its value.

        Raises:
            Refused: no such copy or parameter, another shape, or out of range; nothing has changed.
        """
        which = self._numbers(copies)
        given = None if seeds is None else seeds_of(seeds, [0] * len(which))
        self._parameters.set(parameters, which)
        for k, i in enumerate(which.tolist()):
            if given is not None and given[k] != self.seeds[i]:
                self.seeds[i] = given[k]
                self._copies[i] = Copy(self._build(given[k]), self._measured)
                self._place(i, self._copies[i])
            self._begin(i, bool(parameters) or given is not None)
        self._steps.lost[which] = -1
        self._commands.forget(which)
        self._commands.delay[which] = np.rint(self._parameters.values["command_latency"][which] * float(self._rate))

    def _place(self, i: int, copy: Copy) -> None:
        """Place what the ticks of a copy write beside that of the other copies, and share what they only read."""
        copy.move(self._memory.of(i))
        copy.share(self._constants)

    def _begin(self, i: int, anew: bool) -> None:
        copy = self._copies[i]
        if anew:
            copy.restore_nominal()
            if not self._parameters.is_nominal(i):
                self._parameters.apply(copy, i)
            copy.keep()
        copy.restore()
        copy.world.flush()
        self._collect(i)

    def _numbers(self, copies: Copies) -> IntArray:
        if copies is None:
            return np.arange(self.n)
        given = np.atleast_1d(np.asarray(copies))
        if not given.size:
            return np.zeros(0, np.int64)
        if given.dtype == np.bool_ and given.shape == (self.n,):
            return np.flatnonzero(given)
        if given.ndim != 1 or given.dtype.kind not in "iu":
            text = f"copies are numbers from 0 to {self.n - 1}, or a mask of {self.n} truths, not {given.dtype} {given.shape}"
            raise Refused("bad_shape", text, "copies")
        if len(given) and (given.min() < 0 or given.max() >= self.n or len(np.unique(given)) < len(given)):
            raise Refused("out_of_range", f"copies have numbers from 0 to {self.n - 1}, each named once", "copies")
        return given.astype(np.int64)


def _due(are: NDArray[np.bool_], which: IntArray) -> list[int]:
    """Return those of `which` that the mask `are` holds."""
    due: list[int] = which[are[which]].tolist() if are.any() else []
    return due


def _tell_of_commands(world: World) -> None:
    """Let a world know that commands were written into its rows, which may let a held vehicle go."""
    world.requests.changes += 1


def _do_nothing(world: World) -> None:
    """Do nothing in a world. `Batch._act` collects its events nevertheless."""


def seeds_of(seeds: int | Sequence[int], counts: Iterable[int]) -> list[int]:
    """Return a seed for each copy.

    Args:
        seeds: one for each, or a single one.
        counts: for each copy, what is added to a single seed.

    Raises:
        Refused: another number of seeds, or one that is no whole number, or is negative.
    """
    added = list(counts)
    if not hasattr(seeds, "__len__"):
        first = checked_seed(seeds)
        return [checked_seed(first + more) for more in added]
    given = [checked_seed(seed) for seed in seeds]  # type: ignore[union-attr]  # only a sequence has a length
    if len(given) != len(added):
        raise Refused("bad_shape", f"{len(given)} seeds for {len(added)} copies", "seeds")
    return given
