"""The world that a program in the same process gets from `uwserver.load`."""

from __future__ import annotations

import math
import weakref
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from fractions import Fraction
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

from uwserver.adapter import installed_adapters
from uwserver.environment.water import Water
from uwserver.in_process.describing import Description, described
from uwserver.in_process.progress import is_notebook, with_progress
from uwserver.in_process.serving import PAGE, Serving, configured, hosting_time, show_page, wanted_tables
from uwserver.in_process.sketch import world_html
from uwserver.in_process.traces import Traces, chosen
from uwserver.in_process.vehicles import Vehicles
from uwserver.ports import Command, Event, Json, Port, Refused, Service
from uwserver.ports.checks import checked_whole, shown, suggestion
from uwserver.ports.crossing import Posted
from uwserver.ports.sample_batch import Samples
from uwserver.scenario.build.world import build
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.load.scenario import load as load_scenario
from uwserver.server.hosted import Hosted
from uwserver.world import Diverged, snapshot
from uwserver.world import World as Core
from uwserver.world.sensing.reading import Reading

MOST_EVENTS = 4096
"""Events that are kept until `World.events` is called; older ones are dropped."""


class World:
    """A world, stepped by the program that loaded it: ``with uwserver.load("bluerov2_pool") as world: world.step(240)``.

    Nothing happens but in `step`: the same scenario, seed and commands give the same numbers, bit for bit. Not thread-safe. Copies, also by
    `copy`, `copy.deepcopy` and `pickle`, go on as their original does. `describe` says what there is to read, to command and to call::

        world = uwserver.load("bluerov2_pool", seed=7)
        dive = world.record("bluerov2/*")
        for _ in range(100):
            depth = world.read("bluerov2/depth")
            u = 0.0 if depth is None else 2.0 * (3.0 - depth.depth)
            world.command("bluerov2/thrusters", u=[0, 0, 0, 0, *4 * [max(-1, min(1, u))]])
            world.step(seconds=0.05)
        print(world.vehicles["bluerov2"].p_NB, dive["bluerov2/depth"].depth.max())

    Frames and units are those of all of uwserver: SI, radians, N = north-east-down, B = forward-right-down, quaternions w x y z.
    """

    def __init__(self, resolved: Resolved, seed: int | None = None) -> None:
        """Build the world of a loaded scenario at t = 0. `uwserver.load` loads one, and calls this.

        Raises:
            Refused: the seed is no whole number, or negative.
            TypeError: no loaded scenario is given.
        """
        if not isinstance(resolved, Resolved):
            raise TypeError(
                f"uwserver.load({shown(repr(resolved))}) makes a world; World itself takes a scenario that is loaded already"
            )
        self._resolved = resolved
        self._traces: list[Traces] = []
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._is_closed = False
        self._hosted: Hosted | None = None
        self._page: Serving | None = None
        self._in_use: AbstractContextManager[object] = nullcontext()
        self._begin(build(resolved, seed))
        self._vehicles = Vehicles(lambda: self._core)

    def _begin(self, core: Core) -> None:
        self._core, self._jumps = core, core.jumps

    # -- what it is -----------------------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self._core.name

    @property
    def seed(self) -> int:
        """Seed of all random numbers."""
        return self._core.seed

    @property
    def rate_hz(self) -> float:
        """Ticks a second."""
        return float(self._core.rate_hz)

    @property
    def dt_s(self) -> float:
        """Length of a tick, s."""
        return float(1 / self._core.rate_hz)

    @property
    def tick(self) -> int:
        """Ticks since the start."""
        return self._core.tick

    @property
    def t_s(self) -> float:
        """Simulation time, s."""
        return float(self._core.tick / self._core.rate_hz)

    @property
    def t_ns(self) -> int:
        """Simulation time, ns, rounded from `tick`."""
        return self._core.t_ns

    @property
    def vehicles(self) -> Vehicles:
        """The bodies by name, free objects too: ``world.vehicles["rov"].p_NB``."""
        return self._vehicles

    @property
    def water(self) -> Water:
        """The sea water: ``velocity(p, t)`` of currents and waves, m/s in N; ``elevation``, ``pressure``, and the ``column`` of salinity,
        temperature and sound speed."""
        return self._core.water

    @property
    def ports(self) -> Mapping[str, Port]:
        """All ports by path: sensors give samples, actuators take commands. `describe` shows them to people."""
        return MappingProxyType(self._core.ports)

    @property
    def services(self) -> Mapping[str, Service]:
        """All services by path, for `call`."""
        return MappingProxyType(self._core.services)

    @property
    def core(self) -> Core:
        """The world as a server steps it, for extensions and tools that need its insides. It may change from version to version, and is
        another object after `reset` with a new seed."""
        return self._core

    def describe(self, *patterns: str) -> Description:
        """Return what is in the world, to be printed: vehicles, sensors with rate, fields, units and shapes, actuators, and services.

        Args:
            patterns: only what matches one of them: ``describe("rov/imu")``, ``describe("rov/**")``; default: everything.

        Raises:
            Refused: nothing matches.
        """
        return described(self._core, patterns)

    # -- time -----------------------------------------------------------------------------------------------------------------------

    def step(self, n: int = 1, *, seconds: float | None = None) -> Samples:
        """Run n ticks, or some seconds of simulation time. Returns the samples delivered in them, as a list, whose objects are made when
        they are accessed. Recordings (`record`) grow by them.

        Args:
            n: ticks, a whole number above 0.
            seconds: simulation time instead of ticks, s; a whole number of ticks.

        Raises:
            Refused: n or seconds is none of these, or the world is closed; nothing is stepped.
            Diverged: the state of a body is not finite. The world can only be reset then.
        """
        if seconds is not None:
            n = self._ticks_of(n, seconds)
        if self._is_closed:
            raise Refused("shutdown", "the world is closed: load it again")
        return with_progress(self._run, n, self.dt_s)

    def _run(self, n: int) -> Samples:
        """Run n ticks, and record their samples."""
        hosted = self._hosted
        if hosted is not None and hosted.is_over:
            hosted = self._hosted = None
        try:
            step = self._core.step if hosted is None else hosted.stepped.step
            samples = step(n, self._events)
        except Diverged as diverged:
            self._take(diverged.samples)
            raise
        if self._core.jumps != self._jumps:  # a client has set the time
            self._begin_anew()
        if self._traces:
            self._take(samples)
        return samples

    def _take(self, samples: Samples) -> None:
        for traces in self._traces:
            traces.take(samples)

    def _take_events(self) -> None:
        """Keep the events that no step has given yet, and let clients have them too."""
        self._events += self._core.take_events() if self._hosted is None else self._hosted.stepped.take_events()

    def _ticks_of(self, n: object, seconds: object) -> int:
        rate = self._core.rate_hz
        if n != 1:
            raise Refused("bad_argument", f"step takes ticks or seconds, not both: {n} and {seconds}", "seconds")
        if isinstance(seconds, bool) or not isinstance(seconds, Real) or not math.isfinite(seconds):
            raise Refused("bad_argument", f'"seconds" must be a number above 0, not {seconds!r}', "seconds")
        ticks = Fraction(float(seconds)) * rate
        whole = round(ticks)
        if whole < 1 or abs(ticks - whole) > Fraction(1, 10**6):
            near = [f"{float(k / rate):.6g}" for k in sorted({max(1, int(ticks)), max(1, int(ticks) + 1)})]
            text = f"{float(ticks / rate):g} s is no whole number of ticks of {float(1 / rate):.6g} s"
            raise Refused("bad_argument", f"{text}: near it are {' and '.join(near)} s", "seconds")
        return whole

    def reset(self, seed: int | None = None) -> None:
        """Put everything back to the start of the scenario: time, states, random numbers, water, added and removed bodies.

        Recordings of `record` are cleared and begin anew, as they are whenever the time is set: no array runs back in time. A `Trace` that
        was stopped keeps its samples. Commands that have not acted yet are dropped.

        Args:
            seed: seed of all random numbers from now on, a whole number, 0 or more; None for the present one. Snapshots that were kept in memory
                under a name (``world/snapshot``) are gone with another seed.

        Raises:
            Refused: the seed is something else, or the world is closed; nothing has changed.
        """
        if self._is_closed:
            raise Refused("shutdown", "the world is closed: load it again")
        core = self._core
        with self._in_use:
            if seed is not None and checked_whole("seed", seed) != core.seed:
                self._begin(build(self._resolved, seed, like=core))
                core.end("the world was reset with another seed")
                self._core.say("reset", f"the world is at its start, with seed {seed}")
                if self._hosted is not None:
                    self._hosted.follow(self._core)
            else:
                core.requests.posted.clear()
                core.call("world/reset")
            self._take_events()
        self._begin_anew()

    def close(self) -> None:
        """End the threads of the world, and answer what still waits. Called at the end of a ``with`` block; what was read and recorded
        stays. A world that is closed can still be read, but not stepped."""
        if not self._is_closed:
            self._is_closed = True
            if self._hosted is not None:
                self._hosted.close()
            self._core.end("the world was closed")

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- in and out -----------------------------------------------------------------------------------------------------------------

    def read(self, port: str) -> Reading | None:
        """Return the newest delivered sample of a sensor, by field: ``world.read("rov/depth").depth``; None before the first.

        Raises:
            Refused: no such port, or it is an actuator, which gives no samples.
        """
        with self._in_use:
            return self._core.read(port)

    def command(self, port: str, **value: object) -> None:
        """Command an actuator: ``world.command("rov/thrusters", u=[...])``, with lists or arrays, texts, bytes. It acts from the next `step`
        on; the last command to an actuator counts.

        Args:
            port: path of the actuator.
            value: by field, as `describe` lists them.

        Raises:
            Refused: unknown port or field, wrong type or shape, not finite, out of range, too large.
        """
        self._core.command(port, **value)

    def call(self, service: str, **args: object) -> Json:
        """Carry out a service at once, between two ticks, and return its result: ``world.call("rov/autopilot/arm")``. A long-running
        service is only begun, and gives None.

        Raises:
            Refused: unknown service or argument, wrong type, out of range, or refused by the service.
        """
        with self._in_use:
            result = self._core.call(service, **args)
        if self._core.jumps != self._jumps:
            self._begin_anew()
        return result

    def record(self, *patterns: str) -> Traces:
        """Record sensors as arrays, from now on and while `step` runs: ``dive = world.record("rov/*")``, then ``dive["rov/depth"].depth``.

        They begin anew when the time is set, as by `reset`.

        Args:
            patterns: patterns of the paths of sensors: ``*`` stands for one level, ``**`` for any number; default: all sensors.

        Raises:
            Refused: no sensor matches.
        """
        return Traces(chosen(self._core.ports, patterns), self._traces)

    def events(self) -> list[Event]:
        """Return what has happened since the last call, the newest 4096 events: watchdogs, faults, modes, resets, bodies that came or went."""
        self._take_events()
        events = list(self._events)
        self._events.clear()
        return events

    # -- states ---------------------------------------------------------------------------------------------------------------------

    def save(self) -> bytes:
        """Return the whole state as bytes, for `load`, in this process or another one, or for `--from` of the command line.

        Commands that have not acted yet are no part of it.

        Raises:
            Refused: it is larger than 16 MiB.
        """
        with self._in_use:
            return snapshot.to_bytes(self._core, snapshot.take(self._core))

    def load(self, state: bytes) -> None:
        """Go to a saved state, bit for bit. Recordings begin anew.

        Raises:
            Refused: it is of another scenario, seed or version, or is damaged; nothing has changed.
        """
        with self._in_use:
            snapshot.from_bytes(self._core, bytes(state))
        self._core.say("reset", f"the world is at a saved state of tick {self._core.tick}")
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._jumps = self._core.jumps
        for traces in self._traces:
            traces.begin_anew()

    def copy(self) -> World:
        """Return a world in the same state, which goes on as this one does, bit for bit, and which knows nothing of it.

        Commands that have not acted yet come along. Recordings, events, and states kept in memory under a name stay with this one.

        Raises:
            Refused: the state cannot be saved; the text says why.
        """
        return self._restored(self._resolved, *self._saved())

    def _saved(self) -> tuple[int, bytes, list[Command]]:
        posted = [posted.item for posted in self._core.requests.posted if posted.on_reply is None]
        commands = [item for item in posted if isinstance(item, Command)]
        if len(commands) < len(self._core.requests.posted):
            raise Refused(
                "busy", "a call waits for the next tick, and its caller cannot be copied: step once, then copy"
            )
        return self.seed, self.save(), commands

    @classmethod
    def _restored(cls, resolved: Resolved, seed: int, state: bytes, commands: list[Command]) -> World:
        world = cls(resolved, seed)
        core = world.core
        snapshot.from_bytes(core, state)
        core.take_events()
        for command in commands:
            core.post(Posted(command, None, core.ports[command.port].fields))
        world._begin_anew()
        return world

    def __copy__(self) -> World:
        return self.copy()

    def __deepcopy__(self, _: dict[int, Any]) -> World:
        return self.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        resolved = self._resolved
        if not resolved.scenario.extensions:
            return self._restored, (resolved, *self._saved())
        if resolved.path is None:
            text = "the world has components of extensions and comes from no file, so another process cannot load it"
            raise Refused("denied", text, "extensions")
        return self._loaded_anew, (resolved.path.absolute(), *self._saved())

    @classmethod
    def _loaded_anew(cls, file: Path, seed: int, state: bytes, commands: list[Command]) -> World:
        """Load the scenario again, in a process that may not know its extensions yet, and go to a state."""
        return cls._restored(load_scenario(file, adapters=installed_adapters()), seed, state, commands)

    # -- clients --------------------------------------------------------------------------------------------------------------------

    def view(self, *, opens: bool | None = None, speed: float | None = None, **options: object) -> Serving:
        """Show the world on a page in the browser, while the program steps it. Returns at once::

            with world.view(speed=1.0) as view:
                while view.is_running():
                    world.step()

        Pages show what each `step` does, and can steer vehicles, reset the world and pause it (then `step` waits). Watching changes no
        number, and costs nothing while no page is open. If the page is there already, it is opened again.

        Args:
            opens: open the page in the browser of this desktop; default: if there is a desktop, and no notebook, which shows a link instead.
                The address is in `Serving.address`.
            speed: simulated seconds per second of wall time that `step` keeps to; None for as fast as the program steps. It holds for all
                that is served.
            options: keys of ``[adapters.web]``, such as ``port``, ``bind`` and ``read_only``; default: port 7680 or the next free one, on
                this machine only.

        Raises:
            ScenarioError: no such option, or a wrong value.
            Refused: the port is taken, the speed is not possible, or the world is closed.
        """
        page = self._page
        if page is None or options or not page.is_running():
            page = self._page = self._serve({PAGE: {"kind": PAGE, **options}}, speed, is_whole=False)
        elif speed is not None:
            self._host(speed, is_whole=False)
        if opens or (opens is None and not is_notebook()):
            show_page(page.address, is_wanted=bool(opens))
        return page

    def serve(
        self,
        adapters: str | Sequence[str] | Mapping[str, Any] | None = None,
        *,
        port: int = 0,
        speed: float | None = None,
    ) -> Serving:
        """Let clients of any protocol hear and command the world, while the program steps it. Returns at once::

            with world.serve("sockets") as served:
                print(served.address)  # for uwclient.connect
                world.step(seconds=60.0)

        What clients ask for is carried out in `step`, between two ticks. Adapters that grant ticks themselves (``ardupilot_json``,
        ``px4_hil``) do so if they are the scenario's: `step` then waits for them.

        Args:
            adapters: kinds (``"sockets"``, ``["sockets", "ros2"]``), names of the scenario's own, or tables by name as in a scenario file:
                ``{"link": {"kind": "mavlink", "port": 14550}}``; default: those of the scenario.
            port: port of the adapter ``sockets``; 0 takes a free one.
            speed: as for `view`.

        Raises:
            ScenarioError: a table has faults, or a package that it needs is not installed.
            Refused: an adapter of this name is there, one cannot start, the speed is not possible, or the world is closed.
        """
        tables, is_whole = wanted_tables(self._resolved, adapters, port)
        return self._serve(tables, speed, is_whole)

    def _serve(self, tables: Mapping[str, Any], speed: float | None, is_whole: bool) -> Serving:
        if self._is_closed:
            raise Refused("shutdown", "the world is closed: load it again")
        configs, token = configured(self._resolved, tables)
        hosted = self._host(speed, is_whole)
        return Serving(hosted, hosted.start(configs), token, self._sync)

    def _host(self, speed: float | None, is_whole: bool) -> Hosted:
        timing = hosting_time(self._resolved, speed, is_whole)
        if self._hosted is None or self._hosted.is_over:
            hosted = self._hosted = Hosted(self._resolved, self._core, timing)
            self._in_use = hosted.stepped.in_use
            weakref.finalize(self, hosted.shutdown, "the program dropped the world").atexit = False
        elif speed is not None or timing.mode == "lockstep":
            self._hosted.stepped.keep_time(timing)
        return self._hosted

    def _sync(self) -> None:
        if self._hosted is not None:
            for output in self._hosted.stepped.sync():
                self._events += output.events
            if self._core.jumps != self._jumps:
                self._begin_anew()

    # -- at a prompt ----------------------------------------------------------------------------------------------------------------

    def __setattr__(self, name: str, value: object) -> None:
        if not name.startswith("_"):
            raise AttributeError(f'a world\'s "{name}" cannot be assigned{_HOW_ELSE.get(name, "")}')
        object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("_"):
            raise AttributeError(name)
        word = _OTHER_WORDS.get(name)
        if word is None and hasattr(self._core, name):
            word = f"core.{name}, which may change from version to version"
        there = [each for each in dir(type(self)) if not each.startswith("_")]
        hint = f": use {word}" if word else suggestion(name, there) + f"; there are: {', '.join(there)}"
        raise AttributeError(f'a world has no "{name}"{hint}')

    def _repr_html_(self) -> str:
        likes = self._core.population.likes()
        return world_html(self._resolved, self._vehicles, likes, f"{self.name} at {self.t_s:.3f} s (tick {self.tick})")

    def __repr__(self) -> str:
        return repr(self._core)


_HOW_ELSE = {
    "seed": ": reset(seed=...) begins anew with another one",
    "tick": ": step() makes ticks, reset() goes back to the start",
    "t_s": ": step(seconds=...) goes on, reset() goes back to the start",
    "t_ns": ": step(seconds=...) goes on, reset() goes back to the start",
    "rate_hz": ": [world] rate_hz of the scenario sets it",
    "dt_s": ": [world] rate_hz of the scenario sets it",
    "vehicles": ': call("world/spawn", ...) adds one, and vehicles["..."].set_state(...) moves one',
}
_OTHER_WORDS = {
    "t": "t_s", "time": "t_s", "dt": "dt_s", "run": "step", "reset_to": "load", "restore": "load", "state": "save()", "bodies": "vehicles",
    "objects": "vehicles", "sensors": "ports, or describe()", "actuators": "ports, or describe()", "send": "command", "set": "command",
}  # fmt: skip
"""Words that people try, and the one that is right here."""
