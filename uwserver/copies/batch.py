"""The batch: n copies of a scenario's world, with arrays in and arrays out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwserver.copies.clocks import carry_on, clocks_of, start
from uwserver.copies.commands import Commands
from uwserver.copies.copy import Copy
from uwserver.copies.description import described
from uwserver.copies.parameters import Parameters
from uwserver.copies.ranges import Ranges
from uwserver.copies.readings import Readings
from uwserver.copies.rounds import Rounds, is_fitted
from uwserver.copies.tables import Tables
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.physics.kernel.layout import STATE_SIZE
from uwserver.ports import Event, Json, Refused
from uwserver.ports.checks import find
from uwserver.sensors.bank import BankSensor
from uwserver.world.world import World

Copies = int | Sequence[int] | NDArray[Any] | None
"""Which copies: numbers, or a mask (n) of truths; None for all."""

_NEVER = np.iinfo(np.int64).max
_MOST_EVENTS = 4096


class Batch:
    """n copies of a world without anything solid, stepped in one call. Build one with `uwserver.batch`; not thread-safe.

    Each copy is what `uwserver.load` gives of the scenario with the copy's seed: stepped with the same commands it has the same states and samples,
    bit for bit. Each has its own clock, which a reset sets to 0, and its own water, whose waves and currents go by that clock.

    Arrays that are returned are the caller's own. States are (n, 13): p_NB (m, in N: north, east, down), q_NB (w x y z), v_NB_B (m/s) and w_NB_B
    (rad/s), both in B.

    Attributes:
        n: how many copies.
        seeds: (n) of the copies; `reset` sets them.
        vehicles: names of the bodies in each.
        ports: sensors that measure, by path; `commands`: what can be commanded.
    """

    def __init__(
        self,
        build: Callable[[int], World],
        seeds: Sequence[int],
        sensors: Collection[str] | None = None,
        parameters: Mapping[str, Any] | None = None,
        threads: int = 1,
    ) -> None:
        """Of a scenario that was found fit (`admission`).

        Args:
            build: makes a world with a seed.
            seeds: of the copies.
            sensors: paths of those that measure; None for all. Batteries, and what an autopilot hears, always do.
            parameters: see `reset`.
            threads: how many step the copies, that of the caller included; they change no number.

        Raises:
            Refused: no such sensor, or as `reset`.
        """
        from uwserver.copies import kernels

        self._kernels, self._build = kernels, build
        self.n, self.seeds = len(seeds), [int(seed) for seed in seeds]
        self._copies = [Copy(build(seed)) for seed in self.seeds]
        world = self._copies[0].world
        for path in sensors or ():
            find("port", path, world.sensors)
        self._tables = Tables(self._copies, threads)
        self._ranges = Ranges(threads)
        self._rounds = Rounds(self._copies, self._tables, self._ranges, sensors)
        self._commands = Commands(self._copies, self._tables)
        self._parameters = Parameters(self.n)
        self.vehicles = tuple(world.vehicles)
        self._streams = {
            stream.port.path: (k, stream.port)
            for slot in world.sensors.values()
            if isinstance(slot.sensor, BankSensor) and slot.path in self._rounds.measured
            for k, stream in zip(slot.stream_numbers, slot.streams, strict=True)
        }
        self.ports = {path: port for path, (_, port) in self._streams.items()}
        self.commands = dict(self._commands.ports)
        self._rate, self.dt = world.rate_hz, world.hydro.dt
        self._advance = kernels.advance_fitted if is_fitted(world.hydro) else kernels.advance
        self._has_sea = world.hydro.sea is not None
        self._clocks = clocks_of(self.n)
        self._lost = np.full(self.n, -1, np.int64)
        self._waiting = np.zeros(self.n, np.int64)
        self._next_faults, self._next_chores = np.empty((2, self.n), np.int64)
        self._events: list[tuple[int, Event]] = []
        self.reset(**(parameters or {}))

    def __len__(self) -> int:
        return self.n

    def __repr__(self) -> str:
        return f"<Batch of {self.n} {self._copies[0].world.name}: {', '.join(self.vehicles)}>"

    @property
    def threads(self) -> int:
        """How many step the copies, that of the caller included."""
        return self._ranges.count

    def close(self) -> None:
        """End the threads but the caller's, which steps the copies alone from now on. They also end with the batch, when nobody has it any longer."""
        self._ranges.close()

    # -- time -----------------------------------------------------------------------------------------------------------------------

    @property
    def ticks(self) -> IntArray:
        """(n) ticks of each copy since its start."""
        return self._clocks.ticks.copy()

    @property
    def t_s(self) -> FloatArray:
        """(n) simulation time of each copy, s."""
        return self._clocks.ts.copy()

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """(n) whether a body of the copy has a state that is not finite, or absurdly fast. Such a copy stands still until it is reset."""
        return self._lost >= 0

    def step(self, ticks: int = 1) -> NDArray[np.bool_]:
        """Carry all copies on by so many ticks, but for those that diverge; returns `diverged`.

        Raises:
            Refused: less than one tick.
        """
        if ticks < 1:
            raise Refused("out_of_range", f"step takes 1 tick or more, not {ticks}", "ticks")
        now = self._clocks.ticks
        goal = now + ticks
        while (going := (self._lost < 0) & (now < goal)).any():
            # Those that had no room lag: they catch up first, so that things happen in the order of single ticks.
            left = goal - now
            behind = int(left[going].max())
            others = left[going & (left < behind)]
            going &= left == behind
            which = np.flatnonzero(going)
            self._before(which, going)
            count = min(self._quiet(which, going), behind - int(others.max(initial=0)))
            self._rounds.make_room(which)
            self._ranges.run(which, partial(self._carry, count=count))
        return self.diverged

    def _before(self, which: IntArray, going: NDArray[np.bool_]) -> None:
        """All that acts before the bodies move, in the order of `uwserver.step.tick`."""
        (ticks, _, t_ns, _), commands = self._clocks, self._commands
        if (self._next_faults <= ticks).any():
            for i in which[self._next_faults[which] <= ticks[which]].tolist():
                self._copies[i].acts(self._copies[i].faults, int(ticks[i]))
                self._settle(i)
        for i in commands.apply(ticks, going):
            self._copies[i].world.tick = int(ticks[i])
            self._settle(i)
        for i, path in commands.watch(ticks, which):
            text = f'no command for "{path}" in {self.commands[path].timeout_s:g} s: it went to neutral'
            self._tell(i, Event("watchdog", int(ticks[i]), int(t_ns[i]), text))
        if (self._next_chores <= ticks).any():
            for i in which[self._next_chores[which] <= ticks[which]].tolist():
                self._copies[i].acts(self._copies[i].commands, int(ticks[i]))
                self._settle(i)
        if self._copies[0].pilots:
            tables, waiting = self._tables, self._waiting
            self._ranges.run(
                which, lambda part, _: self._kernels.fly(part, tables.pilots, tables.worlds, ticks, t_ns, waiting)
            )
            for i in which[self._waiting[which] > 0].tolist():
                self._copies[i].fly_on(int(ticks[i]))
                self._settle(i)

    def _quiet(self, which: IntArray, going: NDArray[np.bool_]) -> int:
        """For how many ticks, one at least, nothing acts on any of these copies before its bodies move."""
        if self._copies[0].pilots:
            return 1
        ticks = self._clocks.ticks
        nexts = np.minimum(self._next_faults, self._next_chores)
        return max(1, min(int((nexts - ticks)[which].min()), self._commands.quiet(ticks, which, going)))

    def _carry(self, which: IntArray, me: int, count: int) -> None:
        """A range of copies, by the thread `me`: bodies, then the water, then sensors and what they deliver; so many ticks, or as many as there
        is room for what is on its way."""
        for _ in range(count):
            if not len(which) or not self._rounds.has_room(which):
                return
            which = self._move(which, me)
            self._rounds.measure(which, self._clocks, me)

    def _move(self, which: IntArray, me: int) -> IntArray:
        """Bodies and the water; returns which copies go on."""
        tables, kernels, clocks = self._tables, self._kernels, self._clocks
        if self._has_sea:
            kernels.fill_flows(which, tables.worlds, tables.nows, clocks.ts, 0.5 * self.dt)
        lost = self._advance(which, tables.worlds, clocks.ts, self.dt, self._lost, me)
        carry_on(which, clocks, self._rate)
        if lost:
            which = which[self._lost[which] < 0]
        if self._has_sea:
            ticks = clocks.ticks
            for k, interval in enumerate(tables.intervals.tolist()):
                for i in which[ticks[which] % interval == 0].tolist():
                    self._copies[i].world.water.sea.drifts[k].move(int(ticks[i]))
            kernels.move_sea(
                which, tables.nows, ticks, clocks.ts, tables.drifts, tables.intervals, tables.steady, self.dt
            )
        return which

    def _settle(self, i: int) -> None:
        """A world was at work in Python: answer, tell, and note when it has to be again."""
        copy = self._copies[i]
        for event in copy.world.flush().events:
            self._tell(i, event)
        self._plan(i)

    def _plan(self, i: int) -> None:
        copy = self._copies[i]
        for ticks, part in ((self._next_faults, copy.faults), (self._next_chores, copy.commands)):
            ticks[i] = _NEVER if part.next_tick is None else part.next_tick

    def _tell(self, i: int, event: Event) -> None:
        self._events.append((i, event))
        del self._events[:-_MOST_EVENTS]

    def events(self) -> list[tuple[int, Event]]:
        """What has happened since this was asked last, with the number of the copy: watchdogs, faults, modes; the newest 4096."""
        events, self._events = self._events, []
        return events

    # -- in and out -----------------------------------------------------------------------------------------------------------------

    def command(self, port: str, copies: Copies = None, **value: Any) -> None:
        """Command an actuator of all copies, or of some: ``batch.command("rov/thrusters", u=array)``. It acts from the next `step` on.

        Args:
            port: path of the actuator, as in one world.
            copies: which; the others keep what they have.
            value: by field: an array (k, *shape of the field) for the k copies in their order, or of the field's shape for all of them.

        Raises:
            Refused: unknown port or field, another shape, not finite, out of range, or held by an autopilot; no copy gets anything.
        """
        self._commands.post(port, value, self._numbers(copies), self._clocks.ticks)

    def call(self, service: str, copies: Copies = None, **args: Any) -> list[Json]:
        """Call a service of an autopilot (``rov/autopilot/arm``) of all copies, or of some, one after the other; returns their results.

        Raises:
            Refused: unknown, no service of an autopilot, or refused by a copy, whose number stands in the text; those before it have been called.
        """
        world = self._copies[0].world
        find("service", service, world.services)
        if not any(service.startswith(f"{pilot.craft.path}/") for pilot in self._copies[0].pilots):
            raise Refused(
                "denied", f'"{service}" is of a whole world: a batch calls those of autopilots alone', service
            )
        results: list[Json] = []
        for i in self._numbers(copies).tolist():
            self._copies[i].world.tick = int(self._clocks.ticks[i])
            try:
                results.append(self._copies[i].world.call(service, **args))
            except Refused as refused:
                raise Refused(refused.fault.code, f"copy {i}: {refused.fault.text}", refused.fault.where) from None
            finally:
                self._settle(i)
        return results

    def states(self, vehicle: str | None = None, out: FloatArray | None = None) -> FloatArray:
        """(n, 13) states of a vehicle, of the first one by default: p_NB, q_NB, v_NB_B, w_NB_B.

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
        self._kernels.copy_states(self._tables.worlds, self._copies[0].world.vehicles[name].row, out)
        return out

    def read(self, port: str, out: Readings | None = None) -> Readings:
        """The newest delivered samples of a sensor, by field.

        Args:
            port: path of a sensor that measures, or of one of its streams.
            out: readings of this port from before, to be filled and returned instead of new ones.

        Raises:
            Refused: no such port.
            ValueError: `out` is of another port.
        """
        find("port", port, self.ports)
        if out is None:
            out = Readings(self.ports[port], self.n)
        elif out.port is not self.ports[port] or len(out.packed) != self.n:
            raise ValueError(f'out has readings of "{out.port.path}", not of "{port}" of this batch')
        self._kernels.copy_newest(self._tables.senses, self._streams[port][0], out.packed, out.stamps)
        return out

    def describe(self) -> dict[str, Any]:
        """Everything that goes in and out: names, shapes, units, frames and what they mean, as plain values."""
        return described(self.n, float(self._rate), self.vehicles, self.ports, self.commands)

    @property
    def parameters(self) -> dict[str, FloatArray]:
        """(n, *shape) each, by name: what the copies have now."""
        return {name: values.copy() for name, values in self._parameters.values.items()}

    # -- the start ------------------------------------------------------------------------------------------------------------------

    def reset(self, copies: Copies = None, *, seeds: int | Sequence[int] | None = None, **parameters: Any) -> None:
        """Put all copies, or some, to their start: t = 0, the states of the scenario, and the random numbers of their seeds from the first on.

        The other copies go on as if nothing had happened. Commands that have not acted yet are dropped.

        Args:
            copies: which.
            seeds: other ones, one for all (which are then alike) or one each; this builds their worlds anew, some ms each.
            parameters: see `describe`; what is not given stays as it was set before.

        Raises:
            Refused: no such copy or parameter, another shape, or out of range; nothing has changed.
        """
        which = self._numbers(copies)
        given = None if seeds is None else _seeds(seeds, which)
        self._parameters.set(parameters, which)
        for k, i in enumerate(which.tolist()):
            if given is not None and given[k] != self.seeds[i]:
                self.seeds[i] = given[k]
                self._copies[i] = Copy(self._build(given[k]))
                self._tables.lay(i, self._copies[i])
            self._begin(i, bool(parameters) or given is not None)
        start(which, self._clocks, self._rate)
        self._lost[which] = -1
        self._rounds.forget(which)
        self._commands.forget(which)
        self._commands.delay[which] = np.rint(self._parameters.values["command_latency"][which] * float(self._rate))

    def _begin(self, i: int, anew: bool) -> None:
        copy = self._copies[i]
        if anew:
            copy.restore_nominal()
            if not self._parameters.is_nominal(i):
                self._parameters.apply(copy, i)
            copy.keep()
        copy.restore()
        copy.world.flush()
        self._tables.forget(i, copy)
        self._plan(i)

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


def _seeds(seeds: int | Sequence[int], which: IntArray) -> list[int]:
    given = [seeds] * len(which) if isinstance(seeds, int) else [int(seed) for seed in seeds]
    if len(given) != len(which):
        raise Refused("bad_shape", f"{len(given)} seeds for {len(which)} copies", "seeds")
    return given
