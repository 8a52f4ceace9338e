"""The water between modems: the packets in it, when they reach each modem, and which of them are understood.

A packet begins to arrive at a modem when its sound has travelled to where that modem is by then. While it arrives, it is disturbed by
noise, by its own late arrivals, and by all other packets that arrive at the same time. A modem that sends hears nothing. When the end of
the packet has arrived, it is understood or lost. A random number that depends on the receiver and the packet alone decides that. In ticks
in which nothing begins or ends, nothing is done.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

from msgspec import structs

from uwserver.frames import Quat, Vec3, multiply, rotate
from uwserver.ports import Sample
from uwserver.ports.crossing import Later
from uwserver.sensors.base import Scope, earlier
from uwserver.sensors.modem import MOST_SEEN, Crossing, Modem, ModemReport, Outgoing, Waiting
from uwserver.units import NANOSECONDS
from uwserver.world.modems.hearing import Fading, drawn, is_hidden, report_of, why_lost
from uwserver.world.modems.packets import COMING, MOST_LEGS, MOST_PACKETS, PAST, THERE, Leg, MediumState, Packet
from uwserver.world.modems.send import Ranging
from uwserver.world.parts.part import Part, Stage
from uwserver.world.parts.vehicle import Vehicle
from uwserver.world.sensing.sensor_slot import SensorSlot
from uwserver.world.world import World

_CLOSING = 0.02
"""Sender and receiver approach each other with at most this fraction of the speed of the signal. If they are faster, an arrival is noticed
a little late."""
_FAINTEST = 1e-3
"""A signal weaker than this fraction of the noise is not heard and disturbs nothing."""
_MOST_MET = 8
"""Packets whose path is traced in one tick, as each takes a fifth of a millisecond. The others follow in the next ticks, with the times at
which they arrived."""
_PATIENCE_S = 0.5
"""An answer is awaited for so long after the time at which it must have come."""


class Node(NamedTuple):
    """One modem.

    Attributes:
        path: path of the port at which it reports what it hears.
        slot: slot of that port.
        modem: its sensor.
        vehicle: carries it.
    """

    path: str
    slot: SensorSlot
    modem: Modem
    vehicle: Vehicle

    def pose(self, ago: float = 0.0) -> tuple[Vec3, Quat]:
        """Return p_NS (m) and q_NS, now or `ago` seconds before."""
        p, q = self.vehicle.p_NB, self.vehicle.q_NB
        if ago:
            p, q = earlier(p, q, self.vehicle.nu, ago)
        mount = self.modem.mount
        dx, dy, dz = rotate(q, mount.p)
        return (p[0] + dx, p[1] + dy, p[2] + dz), multiply(q, mount.q)

    def velocity(self) -> Vec3:
        """Return v_NS, m/s."""
        vehicle, (rx, ry, rz) = self.vehicle, self.modem.mount.p
        vx, vy, vz, wx, wy, wz = vehicle.nu
        return rotate(vehicle.q_NB, (vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx))


def nodes_of(sensors: Mapping[str, SensorSlot], vehicles: Mapping[str, Vehicle]) -> dict[str, Node]:
    """Return all modems of a world, by path."""
    return {
        path: Node(path, slot, slot.sensor, vehicles[path.partition("/")[0]])
        for path, slot in sensors.items()
        if isinstance(slot.sensor, Modem)
    }


class Medium(Part):
    """All packets of a world."""

    path = "world/modems"
    state_type = MediumState
    stage: ClassVar[Stage] = Stage.WATER
    order: ClassVar[int] = 1  # after the water of the tick

    def __init__(self, world: World) -> None:
        self._world = world
        self._count = 0
        self._packets: dict[int, Packet] = {}
        self._legs: list[Leg] = []
        self.after_ns = 0
        self._known: tuple[Mapping[str, Any] | None, dict[str, Node]] = (None, {})
        self._fading = Fading(world.seed, self.path)
        self._ranging = Ranging(world.answers, lambda: (world.tick, world.t_ns))

    # -- modems
    # -----------------------------------------------------------------------------------------------------------------------------

    @property
    def _nodes(self) -> dict[str, Node]:
        ports = self._world.ports  # a new object whenever a component is added or removed
        if self._known[0] is not ports:
            self._known = ports, nodes_of(self._world.sensors, self._world.vehicles)
        return self._known[1]

    def _scope(self, node: Node) -> Scope:
        world, vehicle = self._world, node.vehicle
        nu = vehicle.nu
        return Scope(
            world.t_ns, vehicle.p_NB, vehicle.q_NB, (nu[0], nu[1], nu[2]), (nu[3], nu[4], nu[5]), world.water,
            geometry=world.geometry, vehicles=world.vehicles, earth=world.earth, sediments=world.sediments,
        )  # fmt: skip

    @property
    def _now(self) -> float:
        return self._world.t_ns / NANOSECONDS

    # -- sending --------------------------------------------------------------------------------------------------------------------------

    def submitter(self, path: str) -> Callable[[int, bytes, bool], None]:
        """Return a function that sends a message by the modem with this port: address, payload, and whether an answer is wanted."""

        def submit(destination: int, data: bytes, wanted: bool) -> None:
            node = self._nodes.get(path)
            if node is not None and node.slot.active:
                tries = 1 + node.modem.table.retries if wanted else 0
                self._submit(node, Outgoing(self._count + 1, destination, data, False, wanted, self._now, tries))

        return submit

    def _submit(self, node: Node, message: Outgoing) -> None:
        self._count += 1
        node.modem.memory.queue = (*node.modem.memory.queue, message)
        self._send_next(node)
        self.after_ns = 0  # Finding out when something is due takes as long for one message as for many, so it is done once, in `after`.

    def ask(self, path: str, destination: int, patience: float) -> Later:
        """Let the modem with this port ask another one for its distance. The call that is returned gets the distance too.

        Args:
            path: port of a modem that is switched on.
            destination: address.
            patience: how long to wait for the answer, s; 0 for the longest time that one can take.
        """
        number, node = self._count + 1, self._nodes[path]
        later = self._ranging.wait(number, path)
        self._submit(
            node, Outgoing(number, destination, b"", False, True, self._now, 1, patience=patience, ranging=True)
        )
        return later

    def cancel(self, path: str) -> None:
        """Stop waiting for a distance that the modem with this port has asked for."""
        if path in self._nodes:
            memory = self._nodes[path].modem.memory
            memory.queue = tuple([each for each in memory.queue if not each.ranging])
            memory.waiting = tuple([each for each in memory.waiting if not each.message.ranging])
        self._ranging.end("cancelled by the caller", path)

    def _send_next(self, node: Node) -> None:
        """Send the messages that wait and may be sent now. Answers come first, as they are due at a time."""
        memory, now = node.modem.memory, self._now
        while memory.busy <= now:
            ready = [each for each in memory.queue if each.after <= now]
            if not ready:
                return
            message = next((each for each in ready if each.answer), ready[0])
            memory.queue = tuple([each for each in memory.queue if each is not message])
            self._send(node, message)

    def _send(self, node: Node, message: Outgoing) -> None:
        modem, now = node.modem, self._now
        left = max(message.after, modem.memory.busy)
        p, q = node.pose(now - left)
        lasts = modem.duration(message.data)
        modem.memory.busy = left + lasts
        modem.count("sent")
        if message.wanted:
            answered = 2.0 * modem.table.max_range_m / min(modem.speed, 1400.0) + modem.table.turn_around_s
            until = left + lasts + (message.patience or answered + modem.duration(b"") + _PATIENCE_S)
            modem.memory.waiting = (*modem.memory.waiting, Waiting(message, left + lasts, until))
        if self._scope(node).submergence(p) <= 0.0:
            return
        self._count += 1
        held = left - message.heard if message.answer else 0.0
        packet = Packet(
            self._count, message.id, node.path, modem.told_address, message.destination, message.data, message.answer, message.wanted,
            held, left, lasts, p, modem.signal(q), node.velocity(),
        )  # fmt: skip
        self._packets[packet.number] = packet
        for path, other in self._nodes.items():
            if path != node.path and other.modem.overlap(packet.signal) > 0.0:
                soonest = math.dist(p, other.pose()[0]) / other.modem.speed
                self._legs.append(Leg(packet.number, path, left + (1.0 - _CLOSING) * soonest))
        if len(self._packets) > MOST_PACKETS or len(self._legs) > MOST_LEGS:
            for number in list(self._packets)[
                : len(self._packets) // 8 + 1
            ]:  # several at once, as each removal searches the legs
                del self._packets[number]
            self._legs = [leg for leg in self._legs if leg.packet in self._packets][-MOST_LEGS:]

    # -- on the way -----------------------------------------------------------------------------------------------------------------------

    def after(self, tick: int, t_ns: int, samples: list[Sample]) -> None:
        """Carry out what is due: arrivals, then ends, then answers and messages that wait."""
        now, nodes = t_ns / NANOSECONDS, self._nodes
        self._legs = [leg for leg in self._legs if leg.receiver in nodes and nodes[leg.receiver].slot.active]
        behind = self._meet_all(now)
        ended = [leg for leg in self._legs if leg.stage == THERE and leg.over <= now and leg.receiver not in behind]
        if ended:
            there: dict[str, list[Leg]] = {}
            for leg in self._legs:
                if leg.stage != COMING:
                    there.setdefault(leg.receiver, []).append(leg)
            for leg in sorted(ended, key=lambda leg: (leg.over, leg.packet, leg.receiver)):
                self._decide(leg, nodes[leg.receiver], there[leg.receiver])
            done = {id(leg) for leg in ended}
            self._legs = [structs.replace(leg, stage=PAST) if id(leg) in done else leg for leg in self._legs]
        for node in nodes.values():
            self._retry_and_send(node, now)
        self._forget_past(now)
        self._schedule()

    def _meet_all(self, now: float) -> set[str]:
        """Find the positions of packets that may have arrived. Returns the receivers that have more such packets than fit into this tick.
        What has ended at these receivers cannot be decided yet, as the packets that disturb it are not all known."""
        due = sorted((leg.wake, k) for k, leg in enumerate(self._legs) if leg.stage == COMING and leg.wake <= now)
        met = {k: self._meet(self._legs[k], self._nodes[self._legs[k].receiver], now) for _, k in due[:_MOST_MET]}
        behind = {self._legs[k].receiver for _, k in due[_MOST_MET:]}
        if met:
            looked_at = [met.get(k, leg) for k, leg in enumerate(self._legs)]
            self._legs = [leg for leg in looked_at if leg is not None]
        return behind

    def _meet(self, leg: Leg, node: Node, now: float) -> Leg | None:
        """Return a leg in flight as it is a little later: still in flight, or arriving; None if it never arrives."""
        packet, scope = self._packets[leg.packet], self._scope(node)
        p, q = node.pose()
        fading = self._fading.between(packet.sender, node.path, node.modem, packet.left)
        crossing = node.modem.crossing(scope, packet.signal, packet.p, p, q, fading)
        if crossing is None:
            return None
        late = now - packet.left - crossing.time
        if late < 0.0:
            return structs.replace(leg, wake=now - late * (1.0 - _CLOSING))
        # The receiver has met the signal since the last tick. The time of travel changes with the end of the ray by the slowness along it
        # (Fermat).
        approach = _along(crossing.towards, node.velocity())
        ago = late / (1.0 + approach / node.modem.speed_at(scope, p))
        p, q = node.pose(ago)
        overlap = node.modem.overlap(packet.signal)
        signal = crossing.signal * overlap
        if (
            signal < _FAINTEST * crossing.noise
            or scope.submergence(p) <= 0.0
            or is_hidden(self._world.geometry, node.modem, packet.p, p)
        ):
            return None
        begin, (bearing, elevation) = now - ago, self._direction(packet, node, crossing, q)
        return Leg(
            leg.packet, leg.receiver, begin + packet.lasts, THERE, begin, begin + packet.lasts, signal, crossing.noise,
            crossing.late * overlap, crossing.level_db, bearing, elevation, -approach - _along(crossing.leaves, packet.v),
        )  # fmt: skip

    def _direction(
        self, packet: Packet, node: Node, crossing: Crossing, q_NS: tuple[float, float, float, float]
    ) -> tuple[float | None, float | None]:
        exact = node.modem.direction(crossing.towards, q_NS)
        if exact is None:
            return None, None
        _, _, across, up, _ = drawn(node.modem, packet.number)
        sigma = node.modem.direction_sigma
        return exact[0] + sigma * across, exact[1] + sigma * up

    # -- receiving ------------------------------------------------------------------------------------------------------------------------

    def _decide(self, leg: Leg, node: Node, there: Sequence[Leg]) -> None:
        """Decide whether a packet whose end has arrived is understood. `there` has all legs that are or were heard there lately."""
        packet, modem = self._packets[leg.packet], node.modem
        if packet.signal.protocol != modem.table.protocol or not modem.is_for_me(packet.destination):
            return
        own = (each for each in self._packets.values() if each.sender == node.path)
        cause = "" if modem.table.ideal else why_lost(leg, modem, packet, there, own)
        if cause:
            modem.count(cause)
        elif packet.answer:
            self._take_answer(leg, node, packet)
        elif packet.message not in modem.memory.seen:
            modem.memory.seen = (*modem.memory.seen, packet.message)[-MOST_SEEN:]
            modem.count("heard")
            modem.tell(report_of("data", leg, modem, packet))
        if not cause and packet.wanted:
            self._answer(leg, modem, packet)

    def _answer(self, leg: Leg, modem: Modem, packet: Packet) -> None:
        """Answer a message, also one that came before: the first answer may have been lost."""
        if not modem.table.acknowledges:
            return
        memory, after = modem.memory, leg.over + modem.table.turn_around_s
        known = [each for each in memory.queue if not (each.answer and each.id == packet.message)]
        memory.queue = (*known, Outgoing(packet.message, packet.source, b"", True, False, after, 0, leg.over))

    def _take_answer(self, leg: Leg, node: Node, packet: Packet) -> None:
        """Report the answer to a message, once, with the range."""
        modem = node.modem
        asked = next((each for each in modem.memory.waiting if each.message.id == packet.message), None)
        if asked is None:
            return
        modem.memory.waiting = tuple([each for each in modem.memory.waiting if each is not asked])
        travel = leg.begin - asked.over - packet.held
        if not modem.table.ideal:
            travel += math.sqrt(2.0) * modem.jitter(leg.signal / leg.noise) * drawn(modem, packet.number)[1]
        reach = 0.5 * modem.believed(self._scope(node), node.pose()[0]) * travel
        modem.count("heard")
        told = structs.replace(
            report_of("delivered", leg, modem, packet),
            source=modem.settings.address,
            destination=asked.message.destination,
            range=reach,
        )
        modem.tell(told)
        self._ranging.answered(packet.message, told, travel)

    def _retry_and_send(self, node: Node, now: float) -> None:
        """Repeat or give up messages without an answer, and send those that wait."""
        modem, memory = node.modem, node.modem.memory
        if not node.slot.active:
            memory.queue, memory.waiting = (), ()
            self._ranging.end("the modem was switched off", node.path)
            return
        for asked in [each for each in memory.waiting if each.until <= now]:
            memory.waiting = tuple([each for each in memory.waiting if each is not asked])
            message = asked.message
            if message.tries > 1:
                memory.queue = (*memory.queue, structs.replace(message, tries=message.tries - 1, after=asked.until))
                continue
            modem.count("unanswered")
            address = modem.settings.address
            modem.tell(ModemReport("failed", address, message.destination, message.data, asked.until, asked.until))
            waited = asked.until - asked.over
            self._ranging.lost(message.id, f"no answer from {message.destination} came within {waited:.3g} s")
        self._send_next(node)

    def _forget_past(self, now: float) -> None:
        """Drop packets and legs that can no longer disturb anything."""
        hears: dict[str, float] = {}
        for leg in self._legs:
            if leg.stage == THERE:
                hears[leg.receiver] = min(leg.begin, hears.get(leg.receiver, math.inf))
        self._legs = [leg for leg in self._legs if leg.stage != PAST or leg.over > hears.get(leg.receiver, math.inf)]
        needed = {leg.packet for leg in self._legs}
        self._packets = {
            number: packet
            for number, packet in self._packets.items()
            if number in needed or packet.over > min(now, hears.get(packet.sender, math.inf))
        }

    def _schedule(self) -> None:
        """Find the time at which something is due next."""
        wakes = [leg.wake for leg in self._legs if leg.stage != PAST]
        for node in self._nodes.values():
            memory = node.modem.memory
            wakes += [each.until for each in memory.waiting]
            wakes += [max(each.after, memory.busy) for each in memory.queue]
        now = self._now
        wakes += [packet.over for packet in self._packets.values() if packet.over > now]
        self.after_ns = math.ceil(min(wakes) * NANOSECONDS) if wakes else 2**62

    # -- state ----------------------------------------------------------------------------------------------------------------------------

    def forget(self, body: str) -> None:
        """Remove the legs to a vehicle that is about to go. Packets that it has sent stay."""
        self._legs = [leg for leg in self._legs if leg.receiver.partition("/")[0] != body]
        for path in self._nodes:
            if path.partition("/")[0] == body:
                self._ranging.end("the vehicle was taken out of the world", path)

    def leave(self, why: str) -> None:
        """Answer all callers that wait, as the run ends."""
        self._ranging.end(why)

    def save(self) -> MediumState:
        """Return all packets and legs."""
        return MediumState(self._count, tuple(self._packets.values()), tuple(self._legs))

    def check(self, state: Any) -> None:
        """Raise ValueError if a leg has no packet, or two packets have one number."""
        numbers = {packet.number for packet in state.packets}
        if len(numbers) < len(state.packets):
            raise ValueError("two packets have one number")
        if any(leg.packet not in numbers for leg in state.legs):
            raise ValueError("a packet that arrives is missing")

    def load(self, state: MediumState) -> None:
        """Take over packets and legs. Calls that wait for a range are ended, as they were made at another time; the answer is then only
        reported at the port."""
        self._ranging.end("the world was put to another time")
        self._count, self._legs = state.count, list(state.legs)
        self._packets = {packet.number: packet for packet in state.packets}
        self.after_ns = 0  # Modems may have something to do.


def _along(way: tuple[float, float, float], v: tuple[float, float, float]) -> float:
    return math.fsum(u * w for u, w in zip(way, v, strict=True))
