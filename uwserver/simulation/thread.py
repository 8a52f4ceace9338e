"""The simulation thread: a world, its clock, and the services that control time. It carries them out between two ticks."""

from __future__ import annotations

import gc
import logging
import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Literal

from uwserver.logs import place_of
from uwserver.ports import Argument, Call, Event, Json, OnReply, Progress, Refused, Reply, Service
from uwserver.ports.crossing import PAUSE, Posted, TickOutput
from uwserver.simulation.bus import MAX_TICKS, Bus
from uwserver.simulation.clock import Lateness, Pace, Time, Timing
from uwserver.simulation.goal import Goal, Goals
from uwserver.simulation.intake import BEGIN, Intake, Observer
from uwserver.simulation.lockstep import Lockstep
from uwserver.simulation.mailbox import Mailbox, Steering
from uwserver.simulation.readers import Readers
from uwserver.units import NANOSECONDS
from uwserver.world.parts.profile import Profile, untimed
from uwserver.world.state.saving import in_one_piece
from uwserver.world.world import Diverged, World

CLOCK_SERVICES = (
    Service("world/pause", "Stop time. Calls are still answered."),
    Service("world/resume", "Let time run on."),
    Service(
        "world/step",
        "Paused: run n ticks as fast as possible, then reply. Lockstep: grant n ticks for this client, reply when they are done.",
        (Argument("n", "int", "ticks", required=False, default=1, minimum=1, maximum=1e9),),
        long_running=True,
    ),
    Service(
        "world/run_until",
        "Reply in the first tick whose time is t_s or later (or 1 ns earlier, for floats); a paused world runs until then and is paused again.",
        (Argument("t_s", "float", "simulation time", "s", minimum=0.0, maximum=1e9),),
        long_running=True,
    ),
    Service(
        "world/run_until_tick",
        "Reply when the world stands at this tick; a paused world runs until then and is paused again.",
        (Argument("tick", "int", "number of the tick", minimum=0, maximum=1e15),),
        long_running=True,
    ),
    Service(
        "world/set_speed",
        "Simulated seconds per second of the wall clock (mode realtime).",
        (Argument("speed", "float", "speed factor", minimum=1e-3, maximum=1000.0),),
    ),
)


log = logging.getLogger(__name__)

STEERING_NS = NANOSECONDS // 4000
"""Wall time between two ticks for services of the clock, in real time. The rest waits for the next tick."""
MAX_GOALS = 256
"""Most steps and runs at a time, as each gets progress reports."""
_POLL_S = 0.0005
"""How long a world that is ahead of the loop sleeps before it checks again."""
_IDLE_S = 0.25
"""How long a paused or waiting world sleeps at most before it checks again; a request wakes it at once."""


class Simulation:
    """Steps a world until it is stopped. `run` runs in the simulation thread; everything else here is called from the loop.

    Attributes:
        world: used by the simulation thread only, except its immutable ports and services.
        failure: text of the fault that ended the run; "" while all is well.
        readers: gives samples and the state of the scene to readers.
        until_tick: `run` ends at this tick, or at a fault before it; None for never.
    """

    def __init__(self, world: World, timing: Timing, time: Time, bus: Bus, mailbox: Mailbox) -> None:
        """Prepare to step a world; nothing runs yet."""
        self.world, self.timing, self.bus, self.mailbox = world, timing, bus, mailbox
        self.lockstep = Lockstep(timing, time, bus, self._say, self._pause_for_loss)
        self.lateness, self.pace = Lateness(), Pace(time, timing.pace or timing.speed)
        self.paused, self.failure = timing.paused, ""
        self.until_tick: int | None = None
        self._time, self._stop = time, threading.Event()
        self._steering = Steering(mailbox.wake)
        self.readers = Readers(world, bus, self._steering)
        self._goals, self._jumps = Goals(world, bus, time, self._stay_paused), world.jumps
        self._intake = Intake(world, mailbox.posted, time, self._stop)
        self._publish, self._record = bus.publish, self._intake.ticked
        self._callbacks: list[tuple[int, Callable[[], None]]] = []

    # -- from the loop --------------------------------------------------------------------------------------------------------------

    def stop(self) -> None:
        """End `run` after the present tick."""
        self._stop.set()
        self.mailbox.wake.set()

    def observe(self, observer: Observer | None) -> None:
        """Let one observer follow the run; None for none. Called before `run`, or later on its thread between two ticks."""
        self._intake.observer = observer

    def steer(self, action: Callable[[], None], source: str = "", *, always: bool = False) -> None:
        """Carry out an action between two ticks. `source`, `always` and errors are as for `Steering.add`."""
        self._steering.add(action, source, always=always)

    def call_at(self, tick: int, action: Callable[[], None]) -> None:
        """Let the simulation thread call something quick as soon as the world has reached a tick. Called before `run`."""
        self._callbacks.append((tick, action))

    def begin_from(self, data: bytes) -> str:
        """Go to a saved state, by a call of the first tick, so that a recording has it. Called before `run`.

        Returns why that was refused; "" if it was not.
        """
        replies: list[Reply | Progress] = []
        self._intake.submit(Posted(Call("world/load", in_one_piece(data), BEGIN), replies.append))
        output = self.world.flush()
        self._intake.batch += 1
        for on_reply, reply in output.replies:
            on_reply(reply)
        self.bus.expect(self.world.ports, self.world.jumps)
        self._follow_jump()
        return next((reply.fault.text for reply in replies if isinstance(reply, Reply) and reply.fault is not None), "")

    def call(
        self, service: str, args: Mapping[str, Json], client: str, on_reply: OnReply, source: str = ""
    ) -> Callable[[], bool]:
        """Start a service of the clock (`uwserver.simulation.thread`) with checked arguments.

        Args:
            service, args: the request.
            client: a name of the barrier, or "".
            on_reply: gets the answer.
            source: the client.

        Returns its cancel function. May raise as `FairQueue.put` and, for a pause, `FairQueue.overtake`.
        """
        if service in ("world/step", "world/run_until", "world/run_until_tick"):
            make = partial(self._goal, service, args, client, on_reply)
            return self._goals.request(make, on_reply, self._steering, source)
        action = {
            "world/pause": self._pause,
            "world/resume": self._resume,
            "world/set_speed": lambda: self._set_speed(args["speed"]),
        }[service]
        if service != PAUSE:
            self._steering.add(lambda: self._acknowledge(action, on_reply), source, on_reply)
            return lambda: False
        overtaken = Refused("preempted", "world/pause, which was called later, has overtaken it", PAUSE)
        for older in self._steering.stop(lambda: self._acknowledge(action, on_reply), source, on_reply):
            self._reply(older, overtaken)
        return lambda: False

    def watch(self, profile: Profile | None) -> None:
        """Let a profile measure ticks from the next one on; None ends it. Simulation thread, between two ticks."""
        timed = untimed if profile is None else profile.timed
        self._publish = timed("publishing", "to the loop", self.bus.publish)
        self._record = timed("recording", "states", self._intake.ticked)
        self.world.watch(profile)

    # -- the thread -----------------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Step until stopped, or until the world diverges. Then `failure` says why, and calls are still answered."""
        # A full garbage collection of a large heap would delay a tick, so the objects that exist now are exempt.
        gc.collect()
        gc.freeze()
        try:
            self._call_due()
            while not self._is_over():
                self._turn()
        except Exception as error:
            file, line = place_of(error)
            self.failure = f"the simulation stopped by an internal fault at {file}:{line}: {error}"
            log.exception("the simulation thread failed")
            self.bus.say(Event("diverged", self.world.tick, self.world.t_ns, self.failure))
        finally:
            gc.unfreeze()
        refused = Refused("shutdown", "the server is shutting down")
        self._refuse_waiting(refused)
        for on_reply, answer in self.world.end(refused.fault.text):
            self.bus.reply(on_reply, answer)

    def _refuse_waiting(self, refused: Refused) -> None:
        """Answer all requests that still wait to be carried out."""
        while (steered := self._steering.take()) is not None:
            steered.action()
        self._goals.give_up(refused)
        while (posted := self.mailbox.posted.take()) is not None:
            if posted.on_reply is not None:
                self._reply(posted.on_reply, refused)

    def _is_over(self) -> bool:
        ended = self.until_tick is not None and (self.world.tick >= self.until_tick or bool(self.failure))
        return ended or self._stop.is_set()

    def _turn(self) -> None:
        self.mailbox.wake.clear()  # Cleared before the queues are read, as every later request sets it again.
        for steered in self._intake.within(STEERING_NS if self._is_paced() else None, self._steering):
            steered.action()
        if (
            self.failure
            # A paused world that steps or runs to a tick needs no grants, and a grant does not move a paused one.
            or (self.paused and not any(goal.pause_there for goal in self._goals))
            or (self.timing.mode == "lockstep" and not self.paused and not self._granted())
        ):
            self._idle()
        elif self._is_due():
            self._tick()

    def _is_due(self) -> bool:
        """Wait for the tick's deadline. Returns False if a request came during a long wait, such as another speed."""
        if self.timing.pace is not None and not self._goals.hurries:
            late_ns = self.pace.wait(self.world.t_ns, self.mailbox.wake)
            if late_ns is None:
                return False
            self.lateness.add(late_ns)
        else:
            # No deadline is kept here, so the tick may wait for the loop: no sink loses samples, and the loop can serve its peers. With a
            # driver, waiting for its packets leaves the loop enough time.
            most = MAX_TICKS // 2 if self.lockstep.asks else self.bus.ahead
            while self.bus.backlog() >= most and not self._stop.is_set():
                self.bus.flush()
                self._time.wait(_POLL_S, self._stop)
        return True

    def _is_paced(self) -> bool:
        """Return whether a tick must not be delayed."""
        return self.timing.mode == "realtime" and not self._goals.hurries

    def _tick(self) -> None:
        self.readers.begin()
        try:
            output = self._several_ticks() if self._may_make_several() else self._one_tick()
        except Diverged as error:
            self._fail(error)
            return
        self.lateness.ticks += output.ticks
        self._intake.batch += 1
        self.lockstep.ticked(output)
        if self._intake.observer is not None:
            self._record()
        self._publish(output, wake=self.lockstep.wakes())
        self._follow_jump()
        self._call_due()
        if len(self._goals):
            self._goals.check()

    def _fail(self, error: Diverged) -> None:
        """Stay where a body diverged, and tell everybody."""
        self.lateness.ticks += error.output.ticks
        self._intake.batch += 1
        self._follow_jump()  # The tick may have loaded a state; the failure belongs to the time after that.
        self.failure = str(error)
        log.error("%s", error)
        self.paused = True
        self.bus.publish(error.output)
        self.bus.say(Event("diverged", self.world.tick, self.world.t_ns, self.failure))
        self._goals.give_up(Refused("internal", self.failure))

    def _one_tick(self) -> TickOutput:
        return self.world.advance(self._intake.for_tick(self._is_paced()))

    def _may_make_several(self) -> bool:
        """Return whether nothing paces ticks, and nothing needs each of them: then several may be made in one call."""
        is_unpaced = self._goals.hurries or self.timing.mode == "freerun"
        return is_unpaced and not (self.lockstep.asks or self.world.is_watched)

    def _several_ticks(self) -> TickOutput:
        """Make several ticks in one call, up to the next tick that something waits for. Waiting requests are carried out first. If they set
        the time, or an observer follows them, a single tick is made instead."""
        observer = self._intake.observer
        if len(self.mailbox.posted) and (observer is not None or self._answer_first()):
            return self._one_tick()
        before = self.world.tick
        ends = [goal.tick for goal in self._goals] + [tick for tick, _ in self._callbacks]
        if observer is not None:
            ends.append(observer.next_tick(before))
        ends += [] if self.until_tick is None else [self.until_tick]
        most = min([end - before for end in ends] + [max(1, self.bus.ahead - self.bus.backlog())])
        if most < 1:
            return self._one_tick()
        return self.world.advance(most=most, posted=self.mailbox.wake.posted)

    def _answer_first(self) -> bool:
        """Carry out the posted requests, as at the start of a tick. Returns whether they have set the time."""
        self.readers.begin()
        jumps = self.world.jumps
        self._carry_out()
        return self.world.jumps != jumps

    def _call_due(self) -> None:
        for callback in [each for each in self._callbacks if each[0] <= self.world.tick]:
            self._callbacks.remove(callback)
            callback[1]()

    def _idle(self) -> None:
        """Answer the posted requests without a tick, then sleep until the next one."""
        self.pace.release()
        self._carry_out()
        self.bus.flush()
        waiting = len(self._steering) or len(self.mailbox.posted)
        if not (waiting or self._stop.is_set() or self.lockstep.asks):
            self.mailbox.wake.wait(_IDLE_S)

    def _carry_out(self) -> None:
        """Carry out the posted requests without a tick."""
        output = self.world.flush(self._intake.requests(self._is_paced()))
        self._intake.batch += 1
        self.bus.publish(output, wake=False)  # answers and events wake the loop anyway
        self._follow_jump()

    def _follow_jump(self) -> None:
        """Begin deadlines and grants again after a reset or restore, and end the goals of the old time."""
        if self.world.jumps == self._jumps:
            return
        self._jumps = self.world.jumps
        self.pace.release()
        self.lockstep.restart(self.world.tick, self.world.t_ns)
        if self.failure:
            self.failure = ""
            log.info("the world can run again, from tick %d", self.world.tick)
        self._goals.give_up(Refused("preempted", "the world was reset or restored"))

    # -- lockstep -------------------------------------------------------------------------------------------------------------------

    def _granted(self) -> bool:
        world = self.world
        for command in self.lockstep.orders(world.tick, world.ports):
            self._intake.submit(Posted(command, None, world.ports[command.port].fields))
        return self.lockstep.is_granted(world.tick)

    def _pause_for_loss(self, text: str) -> None:
        self.paused = True
        self._say("paused", text)

    # -- steering -------------------------------------------------------------------------------------------------------------------

    def _acknowledge(self, action: Callable[[], None], on_reply: OnReply) -> None:
        refusal = None
        try:
            action()
        except Refused as refused:
            refusal = refused
        self._reply(on_reply, refusal)

    def _reply(self, on_reply: OnReply, refused: Refused | None) -> None:
        fault = None if refused is None else refused.fault
        self.bus.reply(on_reply, Reply(self.world.tick, self.world.t_ns, fault=fault))

    def _pause(self) -> None:
        self._goals.give_up(Refused("preempted", "the world was paused"))
        if not self.paused:
            self.paused = True
            self._say("paused", "world/pause was called")

    def _stay_paused(self) -> None:
        """Stay paused after a step is done."""
        self.paused = True
        self.pace.release()

    def _resume(self) -> None:
        self.check_runs()
        if self.paused:
            self.paused = False
            self.lockstep.wait_anew()
            for goal in self._goals:  # A step within the pause becomes a run at the pace of the clock.
                goal.pause_there, goal.paced = False, True
            self._say("resumed", "world/resume was called")

    def check_runs(self) -> None:
        """Refuse a request that needs a world that can run.

        Raises:
            Refused: a fault has ended the run.
        """
        if self.failure:
            raise Refused("denied", f"{self.failure}\nCall world/reset or world/restore first.")

    def _set_speed(self, speed: Json) -> None:
        if self.timing.pace is None:
            raise Refused("denied", f"the clock is in mode {self.timing.mode}: only realtime has a speed", "speed")
        self.pace.speed = float(speed)  # type: ignore[arg-type]  # checked against the argument
        self.pace.release()

    def _goal(self, service: str, args: Mapping[str, Json], client: str, on_reply: OnReply) -> Goal:
        now = self.world.tick
        self.check_runs()
        if len(self._goals) >= MAX_GOALS:
            raise Refused("overload", f"{MAX_GOALS} steps and runs of all clients are under way: wait for one of them")
        if service != "world/step":
            by_time = service == "world/run_until"
            tick = self.world.ticks.at(float(args["t_s"])) if by_time else int(args["tick"])  # type: ignore[arg-type]
            if tick < now:
                text = f"the world stands at tick {now}, t = {self.world.t_ns / NANOSECONDS:g} s: that is past already"
                raise Refused("out_of_range", text, "t_s" if by_time else "tick")
            return Goal(tick, now, on_reply, self.paused, paced=True)
        n = int(args["n"])  # type: ignore[arg-type]
        if self.timing.mode == "lockstep" and not self.paused:
            if client not in self.lockstep.barrier.clients:
                names = ", ".join(sorted(self.lockstep.barrier.clients))
                text = f'"{client}" is not in the lockstep barrier of {names}: say hello with one of these names'
                raise Refused("denied", text)
            return Goal(self.lockstep.barrier.grant(client, n, now), now, on_reply, pause_there=False, paced=True)
        if not self.paused:
            raise Refused("busy", "the world runs by itself: call world/pause first, then step")
        if len(self._goals):
            raise Refused("busy", "another step or run_until is under way")
        return Goal(now + n, now, on_reply, pause_there=True, paced=False)

    def _say(self, event: Literal["paused", "resumed"], text: str) -> None:
        log.info("%s in tick %d: %s", event, self.world.tick, text)
        self.bus.say(Event(event, self.world.tick, self.world.t_ns, text))
