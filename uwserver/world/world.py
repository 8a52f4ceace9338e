"""The world: bodies, components and the tick. Single-threaded, no input or output, no wall time."""

from __future__ import annotations

import heapq
import logging
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from msgspec import structs

from uwserver.environment.earth import Earth
from uwserver.environment.water import Water
from uwserver.frames import Vec3
from uwserver.physics.bodies import Hydrodynamics
from uwserver.physics.rays.raycast import Geometry, OpenWater
from uwserver.ports import Call, Command, Event, Json, OnReply, Port, Refused, Reply, Sample, Service
from uwserver.ports.checks import checked_args, checked_command, find
from uwserver.ports.crossing import Posted, TickOutput
from uwserver.ports.later import Later
from uwserver.sensors import Compound, Scope
from uwserver.sensors.base import SEDIMENT
from uwserver.units import NANOSECONDS
from uwserver.world.commands import Commands
from uwserver.world.components import ActuatorSlot, Carry, Member, SensorSlot, SideStream
from uwserver.world.faults import Faults
from uwserver.world.pilots import Pilots
from uwserver.world.vehicle import Vehicle

if TYPE_CHECKING:
    from uwserver.physics.scene import Scene

log = logging.getLogger(__name__)


class Diverged(Exception):
    """A body's state is not finite, or absurdly fast. The text names body, tick and the last commands.

    Attributes:
        output: replies to what was carried out at the start of the tick; no samples.
    """

    def __init__(self, text: str, output: TickOutput) -> None:
        super().__init__(text)
        self.output = output


class World:
    """All vehicles and their components, stepped tick by tick.

    Build one with `uwserver.load`. Not thread-safe: in a server only the simulation thread touches it.

    Attributes:
        t_ns: simulation time, ns, computed from `tick`.
        ports, services: what can be read, commanded and called, by path. Replaced, never changed in place.
        members: all bodies with their components, by name; `vehicles`, `sensors` and `actuators` follow from them.
        vehicles: the bodies by name, free objects too.
        scene: solid things; None where nothing is solid.
        geometry: the same, as sensors see it.
        lambert: (n) backscatter of their materials, by number.
        water, earth: the environment, and where N lies.
        faults: of thrusters, sensors and hulls.
        pilots: built-in autopilots.
        jumps: how often a reset or restore has set the time.
    """

    def __init__(
        self, name: str, rate_hz: Fraction, seed: int, epoch_utc: str, hydro: Hydrodynamics, water: Water
    ) -> None:
        self.name = name
        self.rate_hz = rate_hz
        self.seed = seed
        self.epoch_utc = epoch_utc
        self.hydro = hydro
        self.water = water
        self.geometry: Geometry = OpenWater()
        self.earth = Earth()
        self.lambert = SEDIMENT
        self._rate = (rate_hz.numerator, rate_hz.denominator)
        self._double_ns, self._double_rate = 2 * NANOSECONDS * rate_hz.denominator, 2 * rate_hz.numerator
        self.tick = 0
        self.vehicles: dict[str, Vehicle] = {}
        self.ports: Mapping[str, Port] = {}
        self.services: Mapping[str, Service] = {}
        self.sensors: dict[str, SensorSlot] = {}
        self.actuators: dict[str, ActuatorSlot] = {}
        self.members: dict[str, Member] = {}
        self.scene: Scene | None = None
        self._solids: dict[Member, int] = {}
        self._own_services: dict[str, Service] = {}
        self._own_carry: dict[str, Carry] = {}
        self._carry: dict[str, Carry] = {}
        self._due: list[tuple[int, list[SensorSlot]]] = []
        self._listening: list[SensorSlot] = []
        self.pending: list[tuple[int, int, Sample]] = []
        self.pending_order = 0
        self._posted: list[Posted] = []
        self._events: list[Event] = []
        self._last: dict[str, Sample] = {}
        self.commands = Commands(self.actuators, rate_hz, self.say)
        self.jumps = 0
        self.pilots = Pilots()
        self.faults = Faults(
            hydro, water, self.vehicles, self.sensors, self.actuators, rate_hz, lambda text: self.say("fault", text)
        )

    # -- set-up ---------------------------------------------------------------------------------------------------------------------

    def set_scene(self, scene: Scene) -> None:
        """Give the world its solid things; before any body is in it."""
        self.scene = self.hydro.collider = self.geometry = scene

    def set_members(self, members: Iterable[Member]) -> None:
        """Let these bodies, and no others, be in the world. Their rows are there already."""
        begun = bool(self.members)
        self.members = {member.vehicle.name: member for member in members}
        self._set_solids()
        self.pilots.set_members(self.members.values())
        self.vehicles.clear()
        self.sensors.clear()
        self.actuators.clear()
        self._carry = dict(self._own_carry)
        services = dict(self._own_services)
        for name, member in self.members.items():
            self.vehicles[name] = member.vehicle
            self.sensors |= {slot.port.path: slot for slot in member.sensors}
            self.actuators |= {slot.port.path: slot for slot in member.actuators}
            for service, carry in member.services:
                services[service.path], self._carry[service.path] = service, carry
        slots: list[SensorSlot | SideStream | ActuatorSlot] = [*self.sensors.values(), *self.actuators.values()]
        slots += [side for slot in self.sensors.values() for side in slot.sides]
        self.ports = {slot.port.path: slot.port for slot in slots}
        self.services = services
        self.pending = [entry for entry in self.pending if entry[2].port in self.ports]
        heapq.heapify(self.pending)
        self._last = {path: sample for path, sample in self._last.items() if path in self.ports}
        self.commands.watch = self.tick
        self.schedule()
        if begun:
            self.say("ports_changed", "bodies came or went")

    def _set_solids(self) -> None:
        if self.scene is None:
            return
        there = set(self.members.values())
        for member in [member for member in self._solids if member not in there]:
            self.scene.remove(self._solids.pop(member))
        for member in self.members.values():
            if member.solid is not None and member not in self._solids:
                self._solids[member] = self.scene.add_moving(member.solid, member.vehicle.row)

    def set_divisor(self, slot: SensorSlot, divisor: int) -> None:
        """Let a sensor measure every `divisor` ticks, from now on."""
        if slot.divisor == divisor:
            return
        slot.divisor = divisor
        slot.set_interval(float(divisor / self.rate_hz))
        for stream in slot.streams():
            stream.port = self._replaced(structs.replace(stream.port, rate_hz=float(self.rate_hz / divisor)))
        self.schedule()

    def set_timeout(self, slot: ActuatorSlot, ticks: int) -> None:
        """Set an actuator's watchdog; 0 ticks for none."""
        if slot.timeout_ticks == ticks:
            return
        slot.timeout_ticks = ticks
        slot.port = self._replaced(structs.replace(slot.port, timeout_s=float(ticks / self.rate_hz) or None))
        self.commands.watch = self.tick

    def _replaced(self, port: Port) -> Port:
        self.ports = {**self.ports, port.path: port}
        self.say("ports_changed", f'"{port.path}" was changed')
        return port

    def offer(self, service: Service, carry: Carry) -> None:
        """Add a service of the world itself, which runs at the start of a tick."""
        self._own_services[service.path], self._own_carry[service.path] = service, carry
        self.services = {**self.services, service.path: service}
        self._carry[service.path] = carry

    def schedule(self) -> None:
        """Sort the active sensors by how often they are due."""
        groups: dict[tuple[bool, int], list[SensorSlot]] = {}
        for slot in self.sensors.values():
            if slot.active:
                last = isinstance(slot.sensor, Compound)  # it repeats what the others have just measured
                groups.setdefault((last, slot.divisor), []).append(slot)
        self._listening = [slot for slot in self.sensors.values() if slot.active and slot.listens]
        self._due = [(divisor, slots) for (_, divisor), slots in sorted(groups.items(), key=lambda group: group[0])]

    def set_current(self, velocity: Vec3) -> None:
        """Set the uniform, steady part of the current, m/s in N, from the next tick on."""
        self.water.current = velocity
        self.hydro.currents[:] = velocity
        if self.water.sea is not None:
            self.water.sea.hold(self.tick, self._seconds(), velocity)

    # -- time -----------------------------------------------------------------------------------------------------------------------

    def time_of(self, tick: int) -> int:
        """Simulation time of a tick, ns: computed from its number, never accumulated."""
        # In whole numbers (half up), as Fraction arithmetic would cost as much as a sensor.
        return (tick * self._double_ns + self._rate[0]) // self._double_rate

    @property
    def tick(self) -> int:
        """Ticks done."""
        return self._tick

    @tick.setter
    def tick(self, tick: int) -> None:
        self._tick, self.t_ns = tick, self.time_of(tick)

    def jump(self, tick: int) -> None:
        """Set the time to that of a tick; what was read at another time is forgotten."""
        self.tick = tick
        self.jumps += 1
        self._last.clear()

    def _seconds(self) -> float:
        num, den = self._rate
        return self._tick * den / num

    # -- requests -------------------------------------------------------------------------------------------------------------------

    def submit(self, item: Command | Call, on_reply: OnReply | None = None) -> None:
        """Post a checked command or call for the start of the next tick."""
        self._posted.append(Posted(item, on_reply))

    def command(self, port: str, **value: object) -> None:
        """Check and post a command: ``world.command("rov/thrusters", u=[...])``, lists or arrays, texts, bytes. It acts from the next `step` on.

        Raises:
            Refused: unknown port or field, wrong type or shape, not finite, out of range, too large.
        """
        find("port", port, self.ports)
        self.submit(Command(port, checked_command(self.ports[port], value), "in-process"))

    def call(self, service: str, **args: object) -> Json:
        """Carry out a service at once, between two ticks, and return its result; a long-running one is only begun.

        Raises:
            Refused: unknown service or argument, wrong type, out of range, or refused by the service.
        """
        find("service", service, self.services)
        result = self._carry[service](checked_args(self.services[service], args))
        return None if isinstance(result, Later) else result

    # -- the tick -------------------------------------------------------------------------------------------------------------------

    def step(self, n: int = 1) -> list[Sample]:
        """Run n ticks; returns the samples delivered in them.

        Raises:
            Diverged: a body's state is not finite; the world must not be stepped on.
        """
        samples: list[Sample] = []
        for _ in range(n):
            output = self.advance()
            samples += output.samples
            for on_reply, reply in output.replies:
                on_reply(reply)
        return samples

    def read(self, port: str) -> Sample | None:
        """The newest delivered sample of a sensor; None before the first.

        Raises:
            Refused: no such port.
        """
        find("port", port, self.ports)
        return self._last.get(port)

    def advance(self) -> TickOutput:
        """One tick. The order is part of the contract:

        1. faults that begin or end, so that they meet the commands of this tick;
        2. what was posted, so that a command acts in the tick that its reply names;
        3. watchdogs, after the commands that may feed them;
        4. autopilots, after the orders of this tick and with what their sensors had delivered by t;
        5. actuators, bodies and water together in the kernel, from t to t + dt;
        6. delivery of the delayed samples whose time has come, oldest first: they are older than anything measured now;
        7. sensors to which something has come meanwhile that they wait for, as the answer of a beacon;
        8. sensors that are due at t + dt, with their errors, from the new state.
        """
        tick = self._tick
        output = TickOutput(tick, self.t_ns, [])
        if self.faults.next_tick is not None and tick >= self.faults.next_tick:
            self.faults.turn(tick)
        if self._posted:
            self._carry_out(output)
            tick = self._tick  # a restore or reset may have been among it
        if self.commands.watch is not None and tick >= self.commands.watch:
            self.commands.expire(tick)
        if self.pilots:
            output.replies += self.pilots.step(tick, self.t_ns)
        diverged = self.hydro.advance(self._seconds())
        self.tick = tick = tick + 1
        if self.water.sea is not None:
            self.water.sea.move(tick, self._seconds(), self.water.current)
        if diverged >= 0:
            raise Diverged(self._report(diverged), output)
        if self.pending:
            self._deliver(output.samples)
        if self._listening:
            self._measure([slot for slot in self._listening if slot.is_called(self._seconds())], output.samples)
        for divisor, slots in self._due:
            if tick % divisor == 0:
                self._measure(slots, output.samples)
        for sample in output.samples:
            self._last[sample.port] = sample
        if self.pilots:
            self.pilots.hear(output.samples, self.t_ns)
        if self._events:
            output.events, self._events = self._events, []
        output.tick, output.t_ns = tick, self.t_ns
        return output

    def flush(self) -> TickOutput:
        """Carry out what was posted without a tick: for a paused world, where calls must still be answered."""
        output = TickOutput(self.tick, self.t_ns, [])
        self._carry_out(output)
        output.replies += self.pilots.answers()
        output.events, self._events = self._events, []
        output.tick, output.t_ns = self.tick, self.t_ns
        return output

    def say(self, event: str, text: str) -> None:
        """Queue an event for all clients."""
        self._events.append(Event(event, self.tick, self.t_ns, text))  # type: ignore[arg-type]  # callers pass literals

    def _carry_out(self, output: TickOutput) -> None:
        posted, self._posted = self._posted, []
        for entry in posted:
            if isinstance(entry.item, Call):
                # A call may depend on the commands before it.
                self.commands.apply(self.tick)
            reply = self._accept(entry.item) if isinstance(entry.item, Command) else self._run(entry)
            if reply is not None and entry.on_reply is not None:
                output.replies.append((entry.on_reply, reply))
        self.commands.apply(self.tick)

    def _accept(self, command: Command) -> Reply:
        try:
            return Reply(self.tick, self.t_ns, conflict=self.commands.accept(command, self.tick))
        except Refused as refused:
            return Reply(self.tick, self.t_ns, fault=refused.fault)

    def _run(self, entry: Posted) -> Reply | None:
        call, tick, t_ns = entry.item, self.tick, self.t_ns
        assert isinstance(call, Call)
        try:
            if call.service not in self._carry:
                raise Refused("unknown_service", f'"{call.service}" is gone', call.service)
            result = self._carry[call.service](call.args)
            if isinstance(result, Later):
                result.on_reply = entry.on_reply
                return None
            return Reply(tick, t_ns, result)
        except Refused as refused:
            return Reply(tick, t_ns, fault=refused.fault)
        except Exception as error:  # a fault of one service must not end the simulation
            log.exception("%s failed in tick %d", call.service, tick)
            text = f"{call.service} failed by a fault of the server ({type(error).__name__}): please report it with the server's log"
            return Reply(tick, t_ns, fault=Refused("internal", text, call.service).fault)

    def _measure(self, slots: Sequence[SensorSlot], samples: list[Sample]) -> None:
        scopes: dict[int, Scope] = {}
        t_ns = self.t_ns
        rates = self.hydro.rates_of_change(self._seconds()) if any(slot.sensor.needs_rates for slot in slots) else None
        for slot in slots:
            if slot.fault == "silent":
                continue
            scope = scopes.get(slot.row)
            if scope is None:
                x = self.hydro.state[slot.row].tolist()
                scope = scopes[slot.row] = Scope(
                    t_ns, tuple(x[0:3]), tuple(x[3:7]), tuple(x[7:10]), tuple(x[10:13]), self.water,
                    geometry=self.geometry, vehicles=self.vehicles, earth=self.earth, wiring=slot.wiring,
                    lambert=self.lambert,
                )  # fmt: skip
                if rates is not None:
                    scope.nu_dot, scope.tau = (tuple(rate[slot.row].tolist()) for rate in rates)
            for sample in slot.samples(scope):
                if sample.t_sent_ns <= t_ns:
                    samples.append(sample)
                else:
                    self.pending_order += 1
                    heapq.heappush(self.pending, (sample.t_sent_ns, self.pending_order, sample))

    def _deliver(self, samples: list[Sample]) -> None:
        while self.pending and self.pending[0][0] <= self.t_ns:
            samples.append(heapq.heappop(self.pending)[2])

    def _report(self, row: int) -> str:
        vehicle = next(v for v in self.vehicles.values() if v.row == row)
        t = self.t_ns / NANOSECONDS
        line = f'body "{vehicle.name}" diverged in tick {self.tick} (t = {t:.6f} s): p_NB = {vehicle.p_NB}, nu = {vehicle.nu}'
        return "\n".join([line, *self.commands.newest(vehicle.name)])
