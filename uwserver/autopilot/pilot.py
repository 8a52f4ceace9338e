"""The built-in autopilot of one vehicle: from delivered samples and orders to commands of its actuators."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from uwserver.autopilot import route
from uwserver.autopilot.bank import Seat
from uwserver.autopilot.craft import Craft, Held
from uwserver.autopilot.flight import ARRIVED, BEGIN, CONTROL, DONE, FAILSAFE, NOTHING, PROGRESS, READY, STEER, WATCH
from uwserver.autopilot.mission import Item, Waypoint
from uwserver.autopilot.modes import FOLLOWS, REMEDY, Known, known, missing, refuge
from uwserver.autopilot.plausibility import refuse_impossible
from uwserver.autopilot.state import NAN, Mode, Reason, Remembered
from uwserver.autopilot.sticks import enter
from uwserver.physics.kernel.arrays import IntArray
from uwserver.ports import Fault, Json, Refused
from uwserver.ports.crossing import Answers, Later

_LOST: Mapping[str, Reason] = {
    "attitude": "sensor attitude", "heading": "sensor heading", "depth": "sensor depth", "velocity": "sensor velocity",
    "position": "sensor position", "altitude": "sensor altitude",
}  # fmt: skip


class Autopilot:
    """What is rare of flying, on the simulation thread: orders, modes, fail-safes, what is told. The steps themselves run in compiled code (`bank`).

    What it remembers is `estimate`, `memory` and `orders`, which lie in its seat, and one call that waits for its end.

    Attributes:
        craft: its vehicle.
        seat: its rows.
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
        self.craft, self.seat = craft, Seat(craft)
        self.estimate, self.memory, self.orders = self.seat.estimate, self.seat.memory, self.seat.orders
        self.set_points: dict[str, Held] = {}
        self._now, self._say = now, say
        self._errand: Later | None = None
        self._errand_name = ""
        self._answers = answers

    def begin(self) -> None:
        """Once everything is built."""
        self.orders.armed = self.orders.waits = self.craft.armed
        self._take_hold()

    # -- the step -------------------------------------------------------------------------------------------------------------------

    @property
    def t_ns(self) -> int:
        """Simulation time."""
        return self._now()[1]

    @property
    def known(self) -> Known:
        """What of the estimate can be trusted now."""
        return known(self.estimate, self.orders.gains, self.t_ns)

    def attend(self, need: int, world: IntArray, t_ns: int) -> None:
        """A step has stopped and needs this first (`flight`); then it goes on. `world`: the table of the bodies' arrays."""
        while need != NOTHING:
            stage = self._meet(need)
            need = NOTHING if stage is None else self.seat.go_on(world, t_ns, stage)

    def _meet(self, need: int) -> int | None:
        """Do what a step needs; returns the stage from which on it goes on, None where it ends."""
        o, e, craft = self.orders, self.estimate, self.craft
        if need == READY:
            o.waits = False
            self.seat.stay()  # where the sensors say that it is; until now that was anywhere
            self._open_ports()
            return WATCH
        if need == FAILSAFE:
            self._watch(self.known)
            return STEER if o.armed else None  # a fail-safe may have ended a test
        if need == BEGIN:
            route.begin(self.seat, craft.arrival_m, self.known.altitude)
            self._follow_item()
            return STEER
        if need == DONE:
            self._say(f'"{craft.path}" {route.end(o)}')
            self._tell_mission()
        elif need == ARRIVED:
            o.settled = True
            self._end(None)
        elif need == PROGRESS and self._errand is not None:
            self.seat.row["c"]["silence"] = 0.0
            away = route.distance(o, e)
            self._errand.progress(min(1.0, max(0.0, 1.0 - away / o.length)), self.t_ns)
        return CONTROL

    def _follow_item(self) -> None:
        """Compiled code knows of the item under way when it is done."""
        o = self.orders
        if o.items and o.index >= 0:
            c = self.seat.row["c"]
            c["item"], c["lasts"] = route.kind_of(o.items[o.index])

    def _watch(self, now: Known) -> None:
        e, o, craft = self.estimate, self.orders, self.craft
        lost = missing(o.mode, now)
        if lost:
            mode = refuge(o.mode, now)
            self._fail(_LOST[lost], mode, f"{REMEDY[lost]}: {o.mode} -> {mode}")
        if "altitude" in o.given and o.mode in ("guided", "mission") and now.altitude == o.blind:
            self._lose_or_find_bottom(now.altitude)
        if e.leak and o.failsafe != "leak":
            self._fail("leak", "surface" if craft.on_leak == "surface" else o.mode, "leak")
        if e.charge < o.gains.battery_low and o.failsafe not in ("leak", "battery"):
            mode = "surface" if craft.on_low_battery == "surface" else o.mode
            self._fail("battery", mode, f"battery at {100.0 * e.charge:.0f} %")

    def _lose_or_find_bottom(self, sees: bool) -> None:
        """On a way at an altitude. While the bottom is not seen the depth stays as it last was."""
        o = self.orders
        o.blind = not sees
        if not sees:
            self._fail("sensor altitude", o.mode, f"the bottom is not seen: it holds its depth of {o.depth:.1f} m")
            return
        if o.failsafe == "sensor altitude":
            o.failsafe = ""
        self._say(f'"{self.craft.path}" the bottom is seen again: it goes at an altitude of {o.altitude:g} m')

    def _fail(self, reason: Reason, mode: Mode, text: str) -> None:
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
        enter(self.orders, self.memory, mode)
        self.seat.stay()
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
        self.seat.forget()
        self.orders.armed, self.orders.waits = True, False
        self.seat.stay()
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
        self.seat.forget()
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
        enter(self.orders, self.memory, self.orders.mode)
        self.seat.stay()

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
        """Put a mission in; a vehicle on the old one holds where it is.

        Raises:
            Refused: a waypoint's altitude cannot be flown. Nothing has changed then.
        """
        for k, item in enumerate(items):
            if isinstance(item, Waypoint):
                route.check_altitude(item, self.craft, self.orders.gains, f"item {k}: ", f"items[{k}]")
        o = self.orders
        o.items, o.index, o.reached = items, -1, 0
        o.entered, o.waited, o.pace, o.bound = False, 0.0, NAN, NAN
        if o.mode == "mission":
            self.preempt("the mission was replaced")
            self.hold()

    def start_mission(self, index: int) -> None:
        """Fly the mission from this item on.

        Raises:
            Refused: there is none, no such item, not armed, or the mode cannot work.
        """
        self._check_mission(self.orders.items, index)
        self.set_mode("mission")
        o = self.orders
        o.index, o.reached, o.pace, o.bound = index, 0, NAN, NAN

    def _check_mission(self, items: tuple[Item, ...], index: int) -> None:
        if not items:
            raise Refused("denied", self._no_mission, "index")
        if index >= len(items):
            raise Refused("out_of_range", f"the mission has {len(items)} items, from 0 on", "index")
        if not self.orders.armed:
            raise Refused("denied", f"the autopilot is not armed: call {self.craft.path}/arm first", "index")
        if lost := missing("mission", self.known):
            raise Refused("denied", f"mission has {REMEDY[lost]}", "mode")

    def moved(self) -> None:
        """The dead reckoning was corrected: what no command has given stays where the vehicle is."""
        self.seat.stay()

    # -- a call that waits ----------------------------------------------------------------------------------------------------------

    def go(self, where: Waypoint, heading: float | None, speed: float | None, radius: float | None) -> Later:
        """Go to the place of a waypoint, in mode guided; the call is answered when it is reached.

        Raises:
            Refused: not armed, the mode cannot work, or the altitude cannot be flown.
        """
        route.check_altitude(where, self.craft, self.orders.gains, "", "altitude_m")
        if not self.orders.armed:
            raise Refused("denied", f"the autopilot is not armed: call {self.craft.path}/arm first", "goto")
        if self.orders.mode == "guided":
            self.preempt("another goto was called")
        else:
            self.set_mode("guided")
        o, e = self.orders, self.estimate
        near = self.craft.arrival_m if radius is None else radius
        route.go(self.seat, where, heading, speed, near, self.known.altitude)
        o.length = max(route.distance(o, e), 1e-9)
        self._errand, self._errand_name = Later(self._answers), "goto"
        self.seat.row["c"]["errand"], self.seat.row["c"]["silence"] = 1, 0.0
        return self._errand

    def fly(self, items: tuple[Item, ...] | None, index: int) -> Later:
        """Fly a mission from this item on; the call is answered when its last item is done.

        Args:
            items: of the mission; None for the one that is there.
            index: of the first item.

        Raises:
            Refused: see `start_mission`. Nothing has changed then.
        """
        self._check_mission(self.orders.items if items is None else items, index)
        if items is not None:
            self.set_mission(items)
        self.start_mission(index)
        self._errand, self._errand_name = Later(self._answers), "fly_mission"
        return self._errand

    def _tell_mission(self) -> None:
        """An item of a mission is done."""
        o = self.orders
        if self._errand is None or self._errand_name != "fly_mission":
            return
        if o.index < 0:
            self._end(None)
        else:
            self._errand.progress(o.index / len(o.items), self.t_ns)

    def preempt(self, why: str) -> None:
        """End the errand under way, if there is one."""
        if self._errand is not None:
            self._end(Fault("preempted", why, f"{self.craft.path}/{self._errand_name}"))

    def _end(self, fault: Fault | None) -> None:
        errand, self._errand = self._errand, None
        self.seat.row["c"]["errand"] = 0
        assert errand is not None
        tick, t_ns = self._now()
        errand.finish(tick, t_ns, None if fault is not None else self._outcome(), fault)

    def _outcome(self) -> Json:
        if self._errand_name == "fly_mission":
            return {"reached": self.orders.reached}
        away = route.distance(self.orders, self.estimate)
        return None if math.isnan(away) else {"distance_m": away}

    # -- state ----------------------------------------------------------------------------------------------------------------------

    def check(self, kept: Remembered) -> None:
        """Refuse what it was in another place or time, if it cannot have been this vehicle's (ValueError, see `refuse_impossible`)."""
        refuse_impossible(self.craft.path, *self.seat.records(kept))

    def load(self, kept: Remembered) -> None:
        """Go on from there; a call that waits ends."""
        self.preempt("the world was reset or restored")
        is_other = self.seat.load(kept)
        self._follow_item()
        if is_other:
            self._take_hold()
