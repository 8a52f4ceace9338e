"""The built-in autopilot of one vehicle: orders, modes, fail-safes, missions, and what it reports. Its steps run in compiled code (`flight`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

from uwserver.autopilot import route
from uwserver.autopilot.arrays import AutopilotRow, refuse_impossible
from uwserver.autopilot.config import Mode
from uwserver.autopilot.flight import ARRIVED, BEGIN, CONTROL, DONE, FAILSAFE, NOTHING, PROGRESS, READY, STEER, WATCH
from uwserver.autopilot.mission import Item, Waypoint
from uwserver.autopilot.modes import FOLLOWS, REMEDY, Known, known, missing, refuge
from uwserver.autopilot.state import Parts, Reason, Remembered, Six
from uwserver.autopilot.sticks import enter
from uwserver.autopilot.vehicle_spec import Held, VehicleSpec
from uwserver.physics.kernel.arrays import IntArray
from uwserver.ports import Fault, Json, Refused
from uwserver.ports.crossing import Answers, Later


class Autopilot:
    """The part of an autopilot that runs in Python, on the simulation thread: all that happens rarely.

    All that it remembers is in `estimate`, `memory` and `orders`, apart from one call that waits for its reply.

    Attributes:
        spec: its vehicle.
        row: its rows.
        estimate, memory, orders: its records, which are in the rows.
        set_points: slots of its own ports, by name, without that of the pilot. They take commands only in some modes.
    """

    def __init__(
        self, spec: VehicleSpec, now: Callable[[], tuple[int, int]], say: Callable[[str], None], answers: Answers
    ) -> None:
        """Make the autopilot of a vehicle.

        Args:
            spec: the vehicle.
            now: returns tick and simulation time (ns).
            say: sends a text to all clients.
            answers: the list for replies of calls that wait.
        """
        self.spec, self.row = spec, AutopilotRow(spec)
        self.estimate, self.memory, self.orders = self.row.estimate, self.row.memory, self.row.orders
        self.set_points: dict[str, Held] = {}
        self._now, self._send = now, say
        self._errand: Later | None = None
        self._errand_name = ""
        self._answers = answers

    def begin(self) -> None:
        """Start, when the world is built."""
        self.orders.armed = self.orders.waits = self.spec.armed
        self._take_hold()

    def _say(self, text: str) -> None:
        self._send(f'"{self.spec.path}" {text}')

    # -- the step -------------------------------------------------------------------------------------------------------------------

    @property
    def t_ns(self) -> int:
        """Simulation time."""
        return self._now()[1]

    @property
    def known(self) -> Known:
        """What is known of the state of the vehicle now."""
        return known(self.estimate, self.orders.gains, self.t_ns)

    def attend(self, need: int, world: IntArray, t_ns: int) -> None:
        """Handle what a step has stopped for (`flight`), and continue it. `world` is the table of the bodies' arrays."""
        while need != NOTHING:
            stage = self._handle(need)
            need = NOTHING if stage is None else self.row.go_on(world, t_ns, stage)

    def _handle(self, need: int) -> int | None:
        """Do what a step needs. Returns the stage at which the step continues; None if it ends."""
        o = self.orders
        if need == READY:
            o.waits = False
            self.row.stay()  # only now the sensors have measured where the vehicle is
            self._open_ports()
            return WATCH
        if need == FAILSAFE:
            self._watch(self.known)
            return STEER if o.armed else None  # a fail-safe ends a test, which disarms
        if need == BEGIN:
            route.begin(o, self.estimate, self.spec.arrival_m, self.known.altitude)
            self._tell_item()
            return STEER
        if need == DONE:
            self._say(route.end(o))
            self._report_mission()
        elif need == ARRIVED:
            o.settled = True
            self._end(None)
        elif need == PROGRESS and self._errand is not None:
            self.row.record["c"]["silence"] = 0.0
            part = 1.0 - route.distance(o, self.estimate) / o.length
            self._errand.progress(min(1.0, max(0.0, part)), self.t_ns)
        return CONTROL

    def _tell_item(self) -> None:
        """Write the present item of the mission into the row, so that compiled code knows when it is done."""
        o, c = self.orders, self.row.record["c"]
        if o.items and o.index >= 0:
            c["item"], c["lasts"] = route.kind_of(o.items[o.index])

    def _watch(self, now: Known) -> None:
        """Carry out the fail-safes that are due."""
        e, o, spec = self.estimate, self.orders, self.spec
        lost = missing(o.mode, now)
        if lost:
            mode = refuge(o.mode, now)
            self._fail(cast("Reason", f"sensor {lost}"), mode, f"{REMEDY[lost]}: {o.mode} -> {mode}")
        if "altitude" in o.given and o.mode in ("guided", "mission") and now.altitude == o.blind:
            o.blind = not now.altitude
            if o.blind:
                self._fail("sensor altitude", o.mode, f"the bottom is not seen: it holds its depth of {o.depth:.1f} m")
            else:
                o.failsafe = "" if o.failsafe == "sensor altitude" else o.failsafe
                self._say(f"the bottom is seen again: it goes at an altitude of {o.altitude:g} m")
        if e.leak and o.failsafe != "leak":
            self._fail("leak", "surface" if spec.on_leak == "surface" else o.mode, "leak")
        if e.charge < o.gains.battery_low and o.failsafe not in ("leak", "battery"):
            mode = "surface" if spec.on_low_battery == "surface" else o.mode
            self._fail("battery", mode, f"battery at {100.0 * e.charge:.0f} %")

    def _fail(self, reason: Reason, mode: Mode, text: str) -> None:
        o = self.orders
        if o.failsafe not in ("leak", "battery") or reason in ("leak", "battery"):
            o.failsafe = reason
        self._say(f"fail-safe: {text}")
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
        if mode == "mission":
            self._check_mission(self.orders.items, "mode")
        # A leak or an empty battery changes the mode only once: then the operator decides.
        if not (self.orders.failsafe == "leak" and self.estimate.leak) and self.orders.failsafe != "battery":
            self.orders.failsafe = ""
        self._enter(mode, f"mode {mode} was set")
        if mode == "mission" and self.orders.index < 0:
            route.start(self.orders, 0)

    def _check_mission(self, items: tuple[Item, ...], key: str) -> None:
        if not items:
            raise Refused("denied", f"there is no mission: call {self.spec.path}/set_mission first", key)

    def _check_armed(self, key: str) -> None:
        if not self.orders.armed:
            raise Refused("denied", f"the autopilot is not armed: call {self.spec.path}/arm first", key)

    def _enter(self, mode: Mode, why: str) -> None:
        before = self.orders.mode
        self.preempt(why)
        enter(self.orders, self.memory, mode)
        self.row.stay()
        self.end_test()
        self._open_ports()
        if before != mode:
            self._say(f"mode {before} -> {mode}")

    def arm(self, force: bool) -> None:
        """Take over the actuators.

        Raises:
            Refused: the mode cannot work, or there is a leak, unless `force` is true.
        """
        o = self.orders
        lost = missing(o.mode, self.known)
        if lost and not force:
            text = f"mode {o.mode} has {REMEDY[lost]}; choose another mode, or arm with force = true"
            raise Refused("denied", text, "force")
        if self.estimate.leak and not force:
            raise Refused("denied", "there is water in the hull; arm with force = true if you must", "force")
        if o.armed:
            return
        self.row.forget()
        o.armed, o.waits = True, False
        self.row.stay()
        self._take_hold()
        self._say(f"armed in mode {o.mode}")

    def disarm(self) -> None:
        """Send the actuators to neutral, and let others command them."""
        if not self.orders.armed:
            return
        self.preempt("the autopilot was disarmed")
        o = self.orders
        o.armed, o.failsafe, o.pilot, o.test = False, "", "", ()
        for slot in self.spec.held:
            slot.actuator.neutral()
        self.row.forget()
        self._take_hold()
        self._say("disarmed")

    def steer(self, u: Six) -> None:
        """Take over the sticks of the pilot, -1..1 in B."""
        o = self.orders
        o.stick, o.pilot = u, "on"
        if o.failsafe == "pilot":
            o.failsafe = ""

    def lose_pilot(self) -> None:
        """Centre the sticks, because the pilot sends no commands any more."""
        o = self.orders
        o.stick = (0.0,) * 6
        if o.pilot == "on" and o.armed and not o.failsafe:
            o.failsafe = "pilot"
            self._say("fail-safe: no command from the pilot, the sticks are neutral")
        o.pilot = "lost"

    def test(self, outputs: Parts) -> None:
        """Give the actuators these commands instead of those of the controllers, as parts of their full commands."""
        self.preempt("the actuators are being tested")
        self.orders.test = outputs
        self.memory.tau = self.memory.lack = (0.0,) * 6

    def end_test(self) -> None:
        """End a test of the actuators. The autopilot is disarmed, because the vehicle may be on deck."""
        if self.orders.test:
            self._say("the test of the actuators is over")
            self.disarm()

    def hold(self) -> None:
        """Stop, and hold where the vehicle is what the mode holds."""
        enter(self.orders, self.memory, self.orders.mode)
        self.row.stay()

    def _take_hold(self) -> None:
        """Refuse the commands of others to the actuators while the autopilot is armed."""
        path = self.spec.path
        text = f"is held by the autopilot while it is armed: call {path}/disarm first, or steer by {path}/pilot"
        for slot in (*self.spec.held, *self.spec.blocked):
            slot.refusal = text if self.orders.armed else ""
            if self.orders.armed:
                slot.last_value = ()
        self._open_ports()

    def _open_ports(self) -> None:
        """Let the ports for set points take commands if the mode follows them."""
        mode = self.orders.mode
        for name, slot in self.set_points.items():
            modes = FOLLOWS[name]
            text = f"is not followed in mode {mode}: call {self.spec.path}/set_mode with {' or '.join(modes)} first"
            slot.refusal = "" if mode in modes else text
        if "test" in self.set_points and (not self.orders.armed or self.orders.waits):
            text = f"works while the autopilot is armed: call {self.spec.path}/arm first"
            self.set_points["test"].refusal = "waits for the sensors of its mode" if self.orders.waits else text

    def set_mission(self, items: tuple[Item, ...]) -> None:
        """Replace the mission. A vehicle that flies the old one stops, and holds where it is.

        Raises:
            Refused: the altitude of a waypoint cannot be flown. Then nothing changes.
        """
        for k, item in enumerate(items):
            if isinstance(item, Waypoint):
                route.check_altitude(item, self.spec, self.orders.gains, f"item {k}: ", f"items[{k}]")
        o = self.orders
        o.items, o.entered, o.waited = items, False, 0.0
        route.start(o, -1)
        if o.mode == "mission":
            self.preempt("the mission was replaced")
            self.hold()

    def start_mission(self, index: int) -> None:
        """Fly the mission from this item on.

        Raises:
            Refused: there is no mission or no such item, the autopilot is not armed, or the mode cannot work.
        """
        self._check_start(self.orders.items, index)
        self.set_mode("mission")
        route.start(self.orders, index)

    def _check_start(self, items: tuple[Item, ...], index: int) -> None:
        self._check_mission(items, "index")
        if index >= len(items):
            raise Refused("out_of_range", f"the mission has {len(items)} items, from 0 on", "index")
        self._check_armed("index")
        if lost := missing("mission", self.known):
            raise Refused("denied", f"mission has {REMEDY[lost]}", "mode")

    # -- calls that wait ------------------------------------------------------------------------------------------------------------

    def go(self, where: Waypoint, heading: float | None, speed: float | None, radius: float | None) -> Later:
        """Go to the place of a waypoint, in mode guided. The call is answered on arrival.

        Args:
            where: the place.
            heading: rad; None: the bow points where the vehicle goes.
            speed: m/s; None: `cruise_mps` of the gains.
            radius: distance at which the vehicle has arrived, m; None: what it can do.

        Raises:
            Refused: the autopilot is not armed, the mode cannot work, or the altitude cannot be flown.
        """
        route.check_altitude(where, self.spec, self.orders.gains, "", "altitude_m")
        self._check_armed("goto")
        if self.orders.mode == "guided":
            self.preempt("another goto was called")
        else:
            self.set_mode("guided")
        o, e = self.orders, self.estimate
        near = self.spec.arrival_m if radius is None else radius
        route.go(o, e, where, heading, speed, near, self.known.altitude)
        o.length = max(route.distance(o, e), 1e-9)
        self.row.record["c"]["errand"], self.row.record["c"]["silence"] = 1, 0.0
        return self._wait("goto")

    def fly(self, items: tuple[Item, ...] | None, index: int) -> Later:
        """Fly a mission from this item on. The call is answered when its last item is done.

        Args:
            items: items of the mission; None for the present mission.
            index: index of the first item.

        Raises:
            Refused: see `start_mission`. Then nothing changes.
        """
        self._check_start(self.orders.items if items is None else items, index)
        if items is not None:
            self.set_mission(items)
        self.start_mission(index)
        return self._wait("fly_mission")

    def _wait(self, name: str) -> Later:
        """Return the reply of a call that waits, for the service `name`."""
        self._errand, self._errand_name = Later(self._answers), name
        return self._errand

    def _report_mission(self) -> None:
        """Report to the caller of fly_mission that an item is done."""
        o = self.orders
        if self._errand is None or self._errand_name != "fly_mission":
            return
        if o.index < 0:
            self._end(None)
        else:
            self._errand.progress(o.index / len(o.items), self.t_ns)

    def preempt(self, why: str) -> None:
        """End the call that waits, if there is one."""
        if self._errand is not None:
            self._end(Fault("preempted", why, f"{self.spec.path}/{self._errand_name}"))

    def _end(self, fault: Fault | None) -> None:
        """Answer the call that waits: with a fault, or with its result."""
        errand, self._errand = self._errand, None
        self.row.record["c"]["errand"] = 0
        assert errand is not None
        result: Json = None
        if fault is None and self._errand_name == "fly_mission":
            result = {"reached": self.orders.reached}
        elif fault is None and not math.isnan(away := route.distance(self.orders, self.estimate)):
            result = {"distance_m": away}
        errand.finish(*self._now(), result, fault)

    # -- state ----------------------------------------------------------------------------------------------------------------------

    def check(self, kept: Remembered) -> None:
        """Check a saved state.

        Raises:
            ValueError: it is not a state of this vehicle, or it is impossible (`refuse_impossible`).
        """
        refuse_impossible(self.spec.path, *self.row.records(kept))

    def load(self, kept: Remembered) -> None:
        """Restore a saved state. A call that waits ends."""
        self.preempt("the world was reset or restored")
        has_changed = self.row.load(kept)
        self._tell_item()
        if has_changed:
            self._take_hold()
