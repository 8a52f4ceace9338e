"""The built-in autopilot of one vehicle: from delivered samples and orders to commands of its actuators."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from msgspec import Struct, structs

from uwserver.autopilot import route
from uwserver.autopilot.allocation import Given
from uwserver.autopilot.craft import Craft, Held
from uwserver.autopilot.estimator import Known, known
from uwserver.autopilot.mission import Item
from uwserver.autopilot.modes import FOLLOWS, REMEDY, missing, refuge
from uwserver.autopilot.state import NAN, Estimate, Memory, Mode, Orders
from uwserver.autopilot.sticks import enter, stay
from uwserver.ports import Fault, Json, Refused, Sample
from uwserver.ports.crossing import Answers, Later

_PROGRESS_S = 0.5


class Autopilot:
    """Runs on the simulation thread. What it remembers is `estimate`, `memory` and `orders`, and one call that waits for its end.

    Attributes:
        set_points: slots of its own ports, by name, which take commands in some modes only.
    """

    def __init__(
        self, craft: Craft, now: Callable[[], tuple[int, int]], say: Callable[[str], None], answers: Answers
    ) -> None:
        """For a vehicle.

        Args:
            craft: the vehicle.
            now: tick and simulation time (ns).
            say: tells all clients.
            answers: takes what callers that wait are to be told.
        """
        self.craft = craft
        self.divisor = craft.divisor
        self.estimate = craft.estimator.begin()
        self.memory = Memory()
        self.orders = Orders(gains=craft.gains, mode=craft.mode)
        self.set_points: dict[str, Held] = {}
        self._now, self._say = now, say
        self._errand: Later | None = None
        self._told = 0.0
        self._answers = answers

    def begin(self) -> None:
        """Once everything is built."""
        self.orders.armed = self.orders.waits = self.craft.armed
        self._take_hold()

    # -- the step -------------------------------------------------------------------------------------------------------------------

    @property
    def known(self) -> Known:
        """What of the estimate can be trusted now."""
        return known(self.estimate, self.orders.gains, self._now()[1])

    def take(self, sample: Sample, now_ns: int) -> None:
        """A sample of one of its sensors was delivered."""
        self.craft.estimator.update(self.estimate, sample, now_ns)

    def step(self, t_ns: int) -> None:
        """One step: estimate, fail-safes, guidance, control, allocation, commands."""
        e, o, craft = self.estimate, self.orders, self.craft
        now = known(e, o.gains, t_ns)
        craft.estimator.step(e, not now.motion, not now.depth)
        if o.waits and not missing(o.mode, now):
            o.waits = False
            self._open_ports()
        if not o.armed or o.waits:
            stay(o, e)
            return
        self._watch(now)
        if not o.armed:  # a fail-safe has ended a test
            return
        if o.test:
            self._command(craft.outputs.commands(o.test))
            return
        if o.mode == "mission":
            told = route.advance(o, e, craft.dt, craft.flies, craft.up, craft.arrival_m)
            if told:
                self._say(f'"{craft.path}" {told}')
        elif self._errand is not None:
            self._follow_errand()
        self._command(self._control(now))

    def _control(self, now: Known) -> list[Given]:
        e, m, craft = self.estimate, self.memory, self.craft
        tau = craft.helm.demand(e, m, self.orders, now)
        commands, made = craft.allocation.allocate(tau, craft.helm.speed(e, m, now))
        m.tau = tau
        a, b, c, d, f, g = (
            wanted - got if axis in craft.allocation.axes else 0.0
            for axis, (wanted, got) in enumerate(zip(tau, made, strict=True))
        )
        m.lack = (a, b, c, d, f, g)
        return commands

    def _command(self, commands: list[Given]) -> None:
        self.memory.outputs = self.craft.outputs.parts(commands)
        for slot, command in zip(self.craft.held, commands, strict=True):
            if slot.active:
                slot.actuator.apply(command)

    def _watch(self, now: Known) -> None:
        e, o, craft = self.estimate, self.orders, self.craft
        lost = missing(o.mode, now)
        if lost:
            mode = refuge(o.mode, now)
            self._fail(f"sensor {lost}", mode, f"{REMEDY[lost]}: {o.mode} -> {mode}")
        if e.leak and o.failsafe != "leak":
            self._fail("leak", "surface" if craft.on_leak == "surface" else o.mode, "leak")
        if e.charge < o.gains.battery_low and o.failsafe not in ("leak", "battery"):
            mode = "surface" if craft.on_low_battery == "surface" else o.mode
            self._fail("battery", mode, f"battery at {100.0 * e.charge:.0f} %")

    def _fail(self, reason: str, mode: Mode, text: str) -> None:
        o = self.orders
        if o.failsafe not in ("leak", "battery") or reason in ("leak", "battery"):
            o.failsafe = reason
        self._say(f'"{self.craft.path}" fail-safe: {text}')
        if mode != o.mode:
            self._enter(mode, f"fail-safe: {text}")

    # -- orders ---------------------------------------------------------------------------------------------------------------------

    def set_mode(self, mode: Mode) -> None:
        """Begin a mode.

        Raises:
            Refused: a sensor that it needs is missing or invalid, or there is no mission to fly.
        """
        lost = missing(mode, self.known)
        if lost:
            raise Refused("denied", f"{mode} has {REMEDY[lost]}", "mode")
        if mode == "mission" and not self.orders.items:
            raise Refused("denied", self._no_mission, "mode")
        # What a leak or an empty battery leads to happens once: then the operator has the last word.
        if not (self.orders.failsafe == "leak" and self.estimate.leak) and self.orders.failsafe != "battery":
            self.orders.failsafe = ""
        self._enter(mode, f"mode {mode} was set")
        if mode == "mission" and self.orders.items and self.orders.index < 0:
            o = self.orders
            o.index, o.reached, o.pace, o.bound = 0, 0, NAN, NAN

    @property
    def _no_mission(self) -> str:
        return f"there is no mission: call {self.craft.path}/set_mission first"

    def _enter(self, mode: Mode, why: str) -> None:
        before = self.orders.mode
        self.preempt(why)
        enter(self.orders, self.estimate, self.memory, mode)
        self.end_test()
        self._open_ports()
        if before != mode:
            self._say(f'"{self.craft.path}" mode {before} -> {mode}')

    def arm(self, force: bool) -> None:
        """Take the actuators over.

        Raises:
            Refused: the mode cannot work, or there is a leak, and it is not forced.
        """
        lost = missing(self.orders.mode, self.known)
        if lost and not force:
            text = f"mode {self.orders.mode} has {REMEDY[lost]}; choose another mode, or arm with force = true"
            raise Refused("denied", text, "force")
        if self.estimate.leak and not force:
            raise Refused("denied", "there is water in the hull; arm with force = true if you must", "force")
        if self.orders.armed:
            return
        self.memory = Memory()
        self.orders.armed, self.orders.waits = True, False
        stay(self.orders, self.estimate)
        self._take_hold()
        self._say(f'"{self.craft.path}" armed in mode {self.orders.mode}')

    def disarm(self) -> None:
        """Let the actuators go to neutral, and others command them."""
        if not self.orders.armed:
            return
        self.preempt("the autopilot was disarmed")
        o = self.orders
        o.armed, o.failsafe, o.pilot, o.test = False, "", "", ()
        for slot in self.craft.held:
            slot.actuator.neutral()
        self.memory = Memory()
        self._take_hold()
        self._say(f'"{self.craft.path}" disarmed')

    def steer(self, u: Sequence[float]) -> None:
        """The pilot moves the sticks (6), -1..1 in B."""
        o = self.orders
        a, b, c, d, e, f = u
        o.stick = (a, b, c, d, e, f)
        o.pilot = "on"
        if o.failsafe == "pilot":
            o.failsafe = ""

    def lose_pilot(self) -> None:
        """Nobody moves the sticks any more: they spring back."""
        o = self.orders
        o.stick = (0.0,) * 6
        if o.pilot == "on" and o.armed and not o.failsafe:
            o.failsafe = "pilot"
            self._say(f'"{self.craft.path}" fail-safe: no command from the pilot, the sticks are neutral')
        o.pilot = "lost"

    def test(self, outputs: tuple[float, ...]) -> None:
        """Give these parts of full commands to the actuators, instead of control."""
        self.preempt("the actuators are being tested")
        self.orders.test = outputs
        self.memory.tau = self.memory.lack = (0.0,) * 6

    def end_test(self) -> None:
        """Nobody tries the actuators any more: as the vehicle may be on deck, it does not go on by itself."""
        if self.orders.test:
            self._say(f'"{self.craft.path}" the test of the actuators is over')
            self.disarm()

    def hold(self) -> None:
        """Stop following, and hold what the mode holds where the vehicle is now."""
        enter(self.orders, self.estimate, self.memory, self.orders.mode)

    def _take_hold(self) -> None:
        path = self.craft.path
        text = f"is held by the autopilot while it is armed: call {path}/disarm first, or steer by {path}/pilot"
        for slot in (*self.craft.held, *self.craft.blocked):
            slot.refusal = text if self.orders.armed else ""
            if self.orders.armed:
                slot.last_value = ()
        self._open_ports()

    def _open_ports(self) -> None:
        mode = self.orders.mode
        for name, slot in self.set_points.items():
            modes = FOLLOWS[name]
            text = f"is not followed in mode {mode}: call {self.craft.path}/set_mode with {' or '.join(modes)} first"
            slot.refusal = "" if mode in modes else text
        if "test" in self.set_points and (not self.orders.armed or self.orders.waits):
            text = f"works while the autopilot is armed: call {self.craft.path}/arm first"
            self.set_points["test"].refusal = "waits for the sensors of its mode" if self.orders.waits else text

    def set_mission(self, items: tuple[Item, ...]) -> None:
        """Put a mission in; a vehicle on the old one holds where it is."""
        o = self.orders
        o.items, o.index, o.reached = items, -1, 0
        o.entered, o.waited, o.pace, o.bound = False, 0.0, NAN, NAN
        if o.mode == "mission":
            self.hold()

    def start_mission(self, index: int) -> None:
        """Fly the mission from this item on.

        Raises:
            Refused: there is none, no such item, not armed, or the mode cannot work.
        """
        o = self.orders
        if not o.items:
            raise Refused("denied", self._no_mission, "index")
        if index >= len(o.items):
            raise Refused("out_of_range", f"the mission has {len(o.items)} items, from 0 on", "index")
        if not o.armed:
            raise Refused("denied", f"the autopilot is not armed: call {self.craft.path}/arm first", "index")
        self.set_mode("mission")
        o.index, o.reached, o.pace, o.bound = index, 0, NAN, NAN

    def moved(self) -> None:
        """The dead reckoning was corrected: what no command has given stays where the vehicle is."""
        stay(self.orders, self.estimate)

    # -- a call that waits ----------------------------------------------------------------------------------------------------------

    def go(
        self, place: tuple[float, float, float], heading: float | None, speed: float | None, radius: float | None
    ) -> Later:
        """Go to a place, in mode guided; the call is answered when it is reached.

        Raises:
            Refused: not armed, or the mode cannot work.
        """
        if not self.orders.armed:
            raise Refused("denied", f"the autopilot is not armed: call {self.craft.path}/arm first", "goto")
        if self.orders.mode == "guided":
            self.preempt("another goto was called")
        else:
            self.set_mode("guided")
        o, e = self.orders, self.estimate
        route.set_course(o, e, place, heading, speed, self.craft.arrival_m if radius is None else radius)
        o.length = max(route.distance(o, e), 1e-9)
        self._errand, self._told = Later(self._answers), 0.0
        return self._errand

    def _follow_errand(self) -> None:
        o, e, errand = self.orders, self.estimate, self._errand
        assert errand is not None
        away = route.distance(o, e)
        if away <= o.radius:
            o.settled = True
            self._end(None)
            return
        self._told += self.craft.dt
        if self._told >= _PROGRESS_S:
            self._told = 0.0
            errand.progress(min(1.0, max(0.0, 1.0 - away / o.length)), self._now()[1])

    def preempt(self, why: str) -> None:
        """End the errand under way, if there is one."""
        if self._errand is not None:
            self._end(Fault("preempted", why, f"{self.craft.path}/goto"))

    def _end(self, fault: Fault | None) -> None:
        errand, self._errand = self._errand, None
        assert errand is not None
        tick, t_ns = self._now()
        away = route.distance(self.orders, self.estimate)
        result: Json = None if fault is not None or math.isnan(away) else {"distance_m": away}
        errand.finish(tick, t_ns, result, fault)

    # -- state ----------------------------------------------------------------------------------------------------------------------

    def check(self, estimate: Estimate, memory: Memory, orders: Orders) -> None:
        """Refuse what it was in another place or time, if it cannot have been this vehicle's.

        Raises:
            ValueError: attitudes without length, a mission that ends before its item, or parts of other actuators.
        """
        for q in (estimate.q, orders.attitude or estimate.q):
            if not abs(math.hypot(*q) - 1.0) < 1e-3:
                raise ValueError(f'"{self.craft.path}" has an attitude that is no rotation')
        if not -1 <= orders.index < len(orders.items) or not 0 <= orders.reached <= len(orders.items):
            raise ValueError(f'"{self.craft.path}" is at an item that its mission does not have')
        if any(len(parts) not in (0, len(self.craft.outputs.names)) for parts in (memory.outputs, orders.test)):
            raise ValueError(f'"{self.craft.path}" commands other actuators')
        limited = structs.replace(orders, turn_limit=0.0 if orders.turn_limit == math.inf else orders.turn_limit)
        if not all(math.isnan(x) or abs(x) < 1e12 for part in (estimate, memory, limited) for x in _floats(part)):
            raise ValueError(f'"{self.craft.path}" holds a number out of all range')

    def load(self, estimate: Estimate, memory: Memory, orders: Orders) -> None:
        """Go on from there; a call that waits ends."""
        self.preempt("the world was reset or restored")
        before, self.orders = self.orders, orders
        self.estimate, self.memory = estimate, memory
        if (before.mode, before.armed, before.waits) != (orders.mode, orders.armed, orders.waits):
            self._take_hold()


def _floats(value: object) -> Iterator[float]:
    """All numbers with a fraction in a record, however deep."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _floats(item)
    elif isinstance(value, Struct):
        yield from _floats(structs.astuple(value))
