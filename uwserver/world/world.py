"""The world: bodies, components and the tick. It has one thread, no input or output, and no wall time."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping
from fractions import Fraction
from typing import TYPE_CHECKING

from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.frames import Vec3
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.kernel.arrays import IntArray
from uwserver.physics.rays.raycast import Geometry, OpenWater
from uwserver.ports import Event, Port, Service
from uwserver.ports.crossing import Answers, Posted, TickOutput
from uwserver.ports.decimation import EVERY_SAMPLE, Decimations
from uwserver.sensors.base import BOTTOM, SEDIMENT, Sight
from uwserver.units import NANOSECONDS
from uwserver.world.bodies.bodies_and_water import Bodies, WaterPart
from uwserver.world.bodies.members import Member, Population, place_solids
from uwserver.world.driving import Diverged, Driven
from uwserver.world.parts.part import Carry, Part, is_awake, schedule_of
from uwserver.world.parts.profile import Profile, Timer, untimed
from uwserver.world.parts.vehicle import Vehicle
from uwserver.world.sensing.sensing import Sensing
from uwserver.world.sensing.sensor_arrays import Around, SensorArrays
from uwserver.world.sensing.sensor_rows import SensorStream
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.stepping.commands import ActuatorSlot, Commands
from uwserver.world.stepping.piloting import Pilots
from uwserver.world.stepping.requests import Requests
from uwserver.world.stepping.step_table import StepTable, Ticks
from uwserver.world.stepping.stepping import Stepping, run_parts
from uwserver.world.stepping.threads import Threads

if TYPE_CHECKING:
    from uwserver.physics.scene import Scene


__all__ = ["Diverged", "World"]

_OPEN_WATER = OpenWater()


def _report(tick: int, t_ns: int, vehicle: Vehicle | None, commands: Commands) -> str:
    """Return the text of the error. `vehicle` is None if the body has been taken out of the world."""
    if vehicle is None:
        return f"a body that is no longer there diverged in tick {tick}"
    t = t_ns / NANOSECONDS
    line = f'body "{vehicle.name}" diverged in tick {tick} (t = {t:.6f} s): p_NB = {vehicle.p_NB}, nu = {vehicle.nu}'
    return "\n".join([line, *commands.newest(vehicle.name)])


class World(Driven):
    """All vehicles and their components, stepped tick by tick.

    `uwserver.scenario.build.world.build` makes one of a scenario; programs in the same process get `uwserver.World`, which holds it. Not
    thread-safe: in a server only the simulation thread uses it.

    Attributes:
        t_ns: simulation time, ns, computed from `tick`.
        ticks: the times of all ticks.
        ports, services: what can be read, commanded and called, by path. Replaced, never changed in place.
        members: all bodies with their components, by name; `vehicles`, `sensors` and `actuators` follow from them.
        vehicles: the bodies by name, free objects too.
        scene: the solids; None if there are none.
        lambert, sediments: (n) backscatter of their materials by number, and the materials as a reflecting bottom.
        water, earth, sight: the environment, the place of N, and what cameras see.
        parts: everything that lives in the world, by path: its own parts and those of the members, sorted. The arrays of the bodies come
            first, as other parts may read them when they load.
        own_parts, population: the parts that belong to no body, and the one that makes bodies.
        identity: tells scenarios apart whose states cannot be exchanged.
        answers: replies of this tick to callers that wait.
        threads, jumps: the threads that step the world, and how often a reset or restore has set the time.
        requests, sensing: the posted requests, and the sensors. `readings_dropped` and `readings_failed` count lost readings of sensors
            that take time, by port.
        stepping, stops: makes the ticks, and counts how often they have needed Python, by reason.
    """

    def __init__(
        self, name: str, rate_hz: Fraction, seed: int, epoch_utc: str, hydro: Hydrodynamics, water: Water
    ) -> None:
        super().__init__()
        self.name, self.rate_hz, self.seed, self.epoch_utc = name, rate_hz, seed, epoch_utc
        self.hydro, self.water = hydro, water
        self.earth, self.lambert, self.sediments = Earth(), SEDIMENT, BOTTOM
        self.sight: Sight | None = None
        self.ticks = Ticks(rate_hz)
        self.tick = self.jumps = 0
        self.vehicles: dict[str, Vehicle] = {}
        self.ports: Mapping[str, Port] = {}
        self.services: Mapping[str, Service] = {}
        self.sensors: dict[str, SensorSlot] = {}
        self.actuators: dict[str, ActuatorSlot] = {}
        self.members: dict[str, Member] = {}
        self.scene: Scene | None = None
        self._solids, self._placed_members = dict[Member, int](), list[Member]()
        self._own_services: dict[str, tuple[Service, Carry]] = {}
        self._events = list[Event]()
        self.answers: Answers = []
        self.population: Population
        self.identity: Callable[[], str] = str
        self.parts, self.own_parts = dict[str, Part](), list[Part]()
        self.sensor_arrays = SensorArrays(hydro, water, self._around)
        self.readings_dropped = self.sensor_arrays.computing.dropped
        self.readings_failed = self.sensor_arrays.computing.failed
        self.sensing = Sensing(self.sensors, self.sensor_arrays)
        self._profile: Profile | None = None
        self._pilots = Pilots(hydro)
        given = StepTable(hydro, water, self.sensor_arrays, self.sensing, self._pilots, rate_hz)
        self.stepping = Stepping(given, self._set_tick, self._has_output)
        self.stops = self.stepping.stops
        self.threads = Threads(hydro, max(16, round(rate_hz / 4)))
        self._timed: Timer = untimed
        self._commands = Commands(self.actuators, rate_hz, self.say)
        self.requests = Requests(
            self._commands, self.carry, lambda: (self._tick, self.t_ns),
            lambda path: None if path in self._own_services else self.services.get(path),
        )  # fmt: skip
        self._carry_out = self.requests.carry_out
        water_parts = Bodies(hydro), WaterPart(water, self.set_current)
        for part in (*water_parts, self._commands, self._pilots, self.sensing):
            self.add(part)

    def _around(self) -> Around:
        return Around(self.vehicles, self.earth, self.geometry, self.lambert, self.sediments, self.sight)

    @property
    def geometry(self) -> Geometry:
        """The solids, as sensors see them."""
        return _OPEN_WATER if self.scene is None else self.scene

    def set_scene(self, scene: Scene) -> None:
        """Give the world its solids, before any body is in it."""
        self.scene = self.hydro.collider = self.stepping.given.scene = scene

    def prepare(self) -> None:
        """Prepare everything that would delay the first tick that needs it. Called before a run that the clock paces."""
        self.stepping.given.refresh()
        if self.scene is not None:
            self.scene.stocks.ways.open()
            self.scene.still()  # makes the surfaces

    def add(self, part: Part) -> None:
        """Add a part of the world's own, with its services.

        Raises:
            ValueError: another part has this path.
        """
        if part.path in self.parts:
            raise ValueError(f'there is a part "{part.path}" already')
        self.own_parts.append(part)
        self.parts[part.path] = part
        for service, carry in part.services:
            self.offer(service, carry)
        self._order_parts()

    def set_members(self, members: Iterable[Member]) -> None:
        """Let these bodies, and no others, be in the world. Their rows exist already; `bind` may have been called before."""
        begun, new = bool(self._placed_members or "world/reset" in self.services), list(members)
        if new != list(self.members.values()):
            self.bind(new)
        if self.scene is not None:
            place_solids(self.scene, self._solids, new)
        there = set(new)
        for part in [part for member in self._placed_members if member not in there for part in member.parts]:
            if self.parts.get(part.path) is not part:
                part.leave("the vehicle was taken out of the world")
        self._placed_members = new
        self._commands.next_tick = self.tick
        if begun:
            self.say("ports_changed", "bodies came or went")

    def dismiss(self, name: str) -> None:
        """Remove a body with its components; its rows stay. All parts drop what they have about it first."""
        for part in self.parts.values():
            part.forget(name)
        self.set_members(member for other, member in self.members.items() if other != name)

    def bind(self, members: Iterable[Member]) -> None:
        """Make the bodies, their components and services known, without any event. This part of `set_members` can be undone."""
        self.members = {member.vehicle.name: member for member in members}
        self.parts = {part.path: part for part in self.own_parts}
        for known in (self.vehicles, self.sensors, self.actuators, self.carry):
            known.clear()
        services = {path: service for path, (service, _) in self._own_services.items()}
        self.carry |= {path: carry for path, (_, carry) in self._own_services.items()}
        for name, member in self.members.items():
            by_path = member.by_path
            self.vehicles[name] = member.vehicle
            self.sensors |= by_path.sensors
            self.actuators |= by_path.actuators
            self.parts |= by_path.parts
            offered = {service.path: service for service in member.offered}
            services |= offered
            self.carry |= zip(offered, member.carry, strict=True)
        self.services = services
        self.refresh()

    def refresh(self) -> None:
        """Publish the ports of the slots as they are now, and find the order of parts again."""
        slots: list[SensorStream | ActuatorSlot] = [stream for slot in self.sensors.values() for stream in slot.streams]
        slots += self.actuators.values()
        self.ports = {slot.port.path: slot.port for slot in slots}
        self.threads.bodies_changed()
        self.sensing.sensors_changed()
        self._order_parts()

    def _order_parts(self) -> None:
        """List the parts that act, in the order of a tick, so that a tick spends no time on parts that do nothing."""
        self.parts = {path: self.parts[path] for path in (Bodies.path, *sorted(self.parts.keys() - {Bodies.path}))}
        awake = [part for part in self.own_parts if is_awake(part)]
        awake += [part for member in self.members.values() for part in member.by_path.awake]
        self.stepping.schedule = schedule_of(awake, self._timed)
        self._pilots.parts_changed(self.parts.values(), self.sensing.numbers)
        self.sensing.set_listeners(self.stepping.schedule.listeners, self._pilots.ports)
        self.sensing.schedule()

    def subscribe(self, ports: Container[str] | None, decimations: Decimations = EVERY_SAMPLE) -> None:
        """Let `step` give samples of these ports only, so that the others cost next to nothing; None, as at first, for all. `decimations` is as
        for `Sensing.subscribe`.

        Samples for parts (`Part.listens_to`) are given too. All sensors measure and count as ever, and `read` returns the newest sample of any
        port.
        """
        self.sensing.subscribe(ports, decimations)

    def watch(self, profile: Profile | None) -> None:
        """Let a profile measure each stage of a tick from the next tick on; None ends it. Called between two ticks."""
        self._profile = self.stepping.profile = profile
        self._timed = untimed if profile is None else profile.timed
        self._carry_out = self._timed("requests", "requests", self.requests.carry_out)
        self.sensing.watch(self._timed)
        self._order_parts()

    @property
    def is_watched(self) -> bool:
        """Whether a profile measures the ticks."""
        return self._profile is not None

    def follow_slots(self, why: str) -> None:
        """Check sensors and watchdogs again after slots were changed. If ports have changed, publish them with an event."""
        self._commands.next_tick = self.tick
        slots: list[SensorSlot | ActuatorSlot] = [*self.sensors.values(), *self.actuators.values()]
        if any(self.ports[slot.port.path] is not slot.port for slot in slots):
            self.refresh()
            self.say("ports_changed", why)
        else:
            self.sensing.schedule()

    def offer(self, service: Service, carry: Carry) -> None:
        """Add a service of the world itself, which runs at the start of a tick."""
        self._own_services[service.path] = service, carry
        self.services = {**self.services, service.path: service}
        self.carry[service.path] = carry

    def set_current(self, velocity: Vec3) -> None:
        """Set the uniform, steady part of the current, m/s in N, from the next tick on."""
        self.water.current = velocity
        self.sensor_arrays.current_changed()
        self.hydro.currents[:] = velocity
        if self.water.sea is not None:
            self.water.sea.hold(self.tick, self.ticks.second(self.tick), velocity)

    @property
    def tick(self) -> int:
        """Ticks done."""
        return self._tick

    @tick.setter
    def tick(self, tick: int) -> None:
        self._tick, self.t_ns = tick, self.ticks.time_of(tick)

    def jump(self, tick: int) -> None:
        """Set the time to that of a tick, and forget samples of other times."""
        self.tick, self.jumps = tick, self.jumps + 1
        self.sensing.forget_newest()

    def __repr__(self) -> str:
        vehicles, ports = ", ".join(self.vehicles), f"{len(self.sensors)} sensors, {len(self.actuators)} actuators"
        return f"<World {self.name} at {self.ticks.second(self.tick):.3f} s (tick {self.tick}): {vehicles or 'no vehicle'}; {ports}>"

    def advance(self, more: Iterable[Posted] = (), most: int = 1, posted: IntArray | None = None) -> TickOutput:
        """Make one tick, or several if none of the later ones needs the work before a tick. Their order is that of `uwserver.step.tick`.

        Args:
            more: requests to carry out before the first tick, after the posted ones (`Requests.carry_out`).
            most: ticks.
            posted: as for `step.tick.step`: the ticks end as soon as another thread posts something; None if no other thread does.

        Raises:
            Diverged: the state of a body is not finite.
        """
        trial = self.threads.trial
        if trial is not None:
            trial.begin_tick()
        output = TickOutput(self._tick, self.t_ns, [])
        if self._profile is not None:
            self._profile.begin()
        self._begin_tick(output, more)
        run_parts(self.stepping.schedule.watch, self._tick, self.t_ns)
        each = trial is not None or self._profile is not None
        before = self._tick
        lost = self.stepping.go_on(before, 1 if each else most, posted, output.made)
        output.ticks = self._tick - before
        self._end_tick(output, lost)
        if self._profile is not None:
            self._profile.end()
        if trial is not None:
            self.threads.end_tick()
        return output

    def _set_tick(self, tick: int) -> None:
        self.tick = tick

    def _has_output(self) -> bool:
        return bool(self._events or self.answers or self.requests.posted)

    def _begin_tick(self, output: TickOutput, more: Iterable[Posted]) -> None:
        jumps = self.jumps
        run_parts(self.stepping.schedule.first, self._tick, self.t_ns)
        if self.requests.posted or more:
            self._carry_out(output, more)
            if self.jumps != jumps:  # The time was set, so other faults are due.
                run_parts(self.stepping.schedule.first, self._tick, self.t_ns)

    def _end_tick(self, output: TickOutput, diverged: int = -1) -> None:
        """Give samples to the parts that listen, and complete the output. `diverged` is the row of the first body whose state is not
        finite."""
        output.batch = self.sensing.take_batch()
        listeners = self.stepping.schedule.listeners
        for sample in output.samples if listeners else ():
            for on_sample in listeners.get(sample.port, ()):
                on_sample(sample, self.t_ns)
        if self.answers:
            output.replies += self.answers
            self.answers.clear()
        output.events, self._events = self._events, []
        output.tick, output.t_ns, output.ports, output.jumps = self._tick, self.t_ns, self.ports, self.jumps
        if diverged >= 0:
            lost = next((vehicle for vehicle in self.vehicles.values() if vehicle.row == diverged), None)
            raise Diverged(_report(self._tick, self.t_ns, lost, self._commands), output)

    def flush(self, more: Iterable[Posted] = ()) -> TickOutput:
        """Carry out the posted requests before a tick, and begin and end the faults that are due then: for a paused world, which must still
        answer calls, and for many ticks in one call. If nothing was posted, nothing is done."""
        output = TickOutput(self.tick, self.t_ns, [])
        if self.requests.posted or more:
            self._begin_tick(output, more)
        self._end_tick(output)
        return output

    def end(self, why: str) -> Answers:
        """Return answers for all callers that still wait, as the run ends."""
        self.threads.end()
        for part in self.parts.values():
            part.leave(why)
        answers = list(self.answers)
        self.answers.clear()
        return answers

    def take_events(self) -> list[Event]:
        """Return the events that were queued since the last tick, and drop them: no client is told of them."""
        events, self._events = self._events, []
        return events

    def say(self, event: str, text: str) -> None:
        """Queue an event for all clients."""
        self._events.append(Event(event, self.tick, self.t_ns, text))  # type: ignore[arg-type]  # callers pass literals
