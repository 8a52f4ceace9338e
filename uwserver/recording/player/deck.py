"""Plays a recording in place of a world: with the same bus, ports, services and times, at any speed and from any instant.

`Deck.run` is the body of the simulation thread. It needs no physics. Time advances in the recorded ticks. It goes back only by a jump, which an event
``reset`` announces: a recorded jump, a seek, or the loop.
"""

from __future__ import annotations

import logging
import struct
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

import numpy as np

from uwserver.ports import EntityList, Event, Fault, OnReply, Reply, Sample, SceneState, WaterView
from uwserver.ports.crossing import TickOutput
from uwserver.recording.player.chunks import McapMessage, NotPlayable
from uwserver.recording.player.messages import Item
from uwserver.recording.player.track import Track
from uwserver.recording.player.world import Range, members_of, objection, world_of
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Lateness, Pace, Time, Timing
from uwserver.simulation.lockstep import GATHER_S, Lockstep
from uwserver.simulation.mailbox import Mailbox, Steering
from uwserver.simulation.readers import OnSamples, OnState
from uwserver.units import NANOSECONDS
from uwserver.world.stepping.step_table import Ticks

log = logging.getLogger(__name__)

STRIDE_NS: Final = NANOSECONDS // 30
"""Largest step of time where nothing was recorded."""
GROWTH_NS: Final = NANOSECONDS // 4
"""Wall time between two checks whether a file has grown."""
MAX_GOALS: Final = 256
GROWN_NS: Final = 3 * NANOSECONDS
"""If a file without an end does not grow for this wall time, it counts as cut off."""
_IDLE_S = 0.1
_POLL_S = 0.0005


@dataclass(eq=False)
class Goal:
    """A request to reach a tick, where playback pauses if `pauses` is set."""

    tick: int
    on_reply: OnReply
    pauses: bool


class Deck:
    """Plays a track on a bus. `uwserver.recording.player.player.Player` adds the services that control it.

    Args:
        track: the recording.
        timing: speed ("freerun" for as fast as possible), and whether it begins paused.
        span: the range that is played.
        time, bus, mailbox: those of the server.

    Attributes:
        world, lateness, pace, lockstep, readers, paused, failure, until_tick: as in `uwserver.simulation.thread.Simulation`.
        water: the recorded sea.
    """

    def __init__(self, track: Track, timing: Timing, span: Range, time: Time, bus: Bus, mailbox: Mailbox) -> None:
        self.track, self.timing, self.span = track, timing, span
        self.world = world_of(track)
        self._ticks = Ticks(self.world.rate_hz)
        self.lateness, self.pace = Lateness(), Pace(time, timing.speed)
        self.lockstep = Lockstep(Timing("realtime"), time, bus, self._say, lambda text: None)
        self.readers = self
        self.paused, self.failure = timing.paused, ""
        self.until_tick: int | None = None
        self.water: WaterView = track.scenes[0].water
        self._bus, self._mailbox, self._time = bus, mailbox, time
        self._steering = Steering(mailbox.wake)
        self._stop = threading.Event()
        self._goals: list[Goal] = []
        self._jumps = self._woken_ns = self._checked_ns = self._grown_ns = self._asked = 0
        self._has_reported_replaced = self._has_reported_damage = False
        self._blank = SceneState(EntityList(0, (), ()), 0, np.zeros((0, 7)), np.zeros(0, np.int8), (0.0, 0.0, 0.0))
        bus.expect(self.world.ports, 0)
        self._place(0, self._bounds()[0])

    # -- from the loop --------------------------------------------------------------------------------------------------------------

    def stop(self) -> None:
        """End `run`."""
        self._stop.set()
        self._mailbox.wake.set()

    def read(self, ports: Sequence[str], on_samples: OnSamples, source: str = "") -> None:
        """Read the last samples of ports, as `uwserver.simulation.readers.Readers.read`."""
        self._steering.add(partial(self._read, tuple(ports), on_samples), source)

    def request_scene_state(self, on_state: OnState, source: str = "") -> None:
        """Read the poses of all bodies, as `uwserver.simulation.readers.Readers.request_scene_state`."""
        self._steering.add(lambda: self._bus.hand_over(partial(on_state, self.track.state or self._blank)), source)

    # -- the thread -----------------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Play until stopped."""
        try:
            while not self._stop.is_set() and not (self.until_tick is not None and self.world.tick >= self.until_tick):
                self._turn()
        except Exception as error:
            self.failure = f"an internal fault stopped the player: {error}"
            log.exception("the player failed")
            self._bus.say(Event("diverged", self.world.tick, self.world.t_ns, self.failure))
        while (steered := self._steering.take()) is not None:
            steered.action()
        self._abort(self._goals, "the server is shutting down")
        self._refuse_posted()
        self.track.close()

    def _turn(self) -> None:
        for _ in range(len(self._steering)):
            steered = self._steering.take()
            if steered is not None:
                steered.action()
        self._refuse_posted()
        if self.failure or (self.paused and not any(goal.pauses for goal in self._goals)):
            self._publish_to_new_listeners()
            self._idle()
            return
        try:
            self._go_on()
        except (NotPlayable, OSError, struct.error) as error:
            self._fail(str(error))

    def _go_on(self) -> None:
        """Play the next tick, or handle the end of the range."""
        world, item = self.world, self.track.head_item
        if self.span.to_s is not None and world.t_ns >= self._bounds()[1]:
            self._at_end()
        elif item is None:
            if not self._may_grow():
                self._at_end()
        elif item.type == "jump":
            self._jump(item)
        else:
            wanted = min(
                item.t_ns, world.t_ns + STRIDE_NS, *(self._ticks.time_of(goal.tick) for goal in self._goals[:1])
            )
            if self.span.to_s is not None:
                wanted = min(wanted, self._bounds()[1])
            tick = max(world.tick + 1, self._ticks.first_at(wanted)) if wanted > world.t_ns else world.tick
            t_ns = self._ticks.time_of(tick)
            if self._is_due(t_ns):
                self._publish(tick, t_ns)

    def _publish(self, tick: int, t_ns: int) -> None:
        """Publish everything that was recorded until a time."""
        track, world, bus = self.track, self.world, self._bus
        samples: list[Sample] = []
        events: list[Event] = []
        self._asked = bus.asked
        self._follow_scene(t_ns)
        while (item := track.head_item) is not None and item.t_ns <= t_ns and item.type != "jump":
            track.pop()
            if item.type == "sample":
                samples += self._samples([item.message])
            elif item.type == "event":
                event = track.messages.played_event(item.message)
                if event is not None:
                    events.append(event)
        world.tick, world.t_ns = tick, t_ns
        self.lateness.ticks += 1
        bus.publish(TickOutput(tick, t_ns, samples, events=events, ports=world.ports, jumps=self._jumps), self._wakes())
        for goal in [goal for goal in self._goals if tick >= goal.tick]:
            self.paused = self.paused or goal.pauses
            self._goals.remove(goal)
            bus.reply(goal.on_reply, Reply(tick, t_ns))

    def _samples(self, messages: Iterable[McapMessage]) -> list[Sample]:
        """Return the samples of messages that a client wants."""
        subscriptions, track = self._bus.subscriptions, self.track
        chosen = (m for m in messages if subscriptions is None or track.messages.topic(m) in subscriptions)
        return [sample for m in chosen if (sample := track.messages.sample(m, self.world.ports)) is not None]

    def _publish_to_new_listeners(self) -> None:
        """Publish the last sample of each wanted port, if clients have subscribed while nothing moves."""
        if self._bus.asked != self._asked:
            self._asked, world = self._bus.asked, self.world
            samples = self._samples(self.track.last())
            self._bus.publish(TickOutput(world.tick, world.t_ns, samples, ports=world.ports, jumps=self._jumps))

    def _is_due(self, t_ns: int) -> bool:
        """Wait for the deadline; return False when a request interrupts a long wait."""
        if self.timing.pace is not None and not (self._goals and self._goals[0].pauses):
            late_ns = self.pace.wait(t_ns, self._mailbox.wake)
            if late_ns is None:
                self._mailbox.wake.clear()
                return False
            self.lateness.add(late_ns)
            return True
        while self._bus.backlog() >= self._bus.ahead and not self._stop.is_set():
            self._bus.flush()
            self._time.wait(_POLL_S, self._stop)
        return True

    def _wakes(self) -> bool:
        """Return whether this tick wakes the loop at once. Fast ticks are gathered for a short time, because waking the loop is expensive."""
        if self.timing.pace is not None and self.pace.speed <= 2.0:
            return True
        now = self._time.now_ns()
        if now - self._woken_ns < GATHER_S * NANOSECONDS:
            return False
        self._woken_ns = now
        return True

    def _idle(self) -> None:
        self.pace.release()
        self._mailbox.wake.clear()
        self._bus.flush()
        if not (len(self._steering) or len(self._mailbox.posted) or self._stop.is_set()):
            self._time.wait(_IDLE_S, self._mailbox.wake)

    def _may_grow(self) -> bool:
        """Check whether the file has grown; return False when it is not expected to grow."""
        if not self.track.is_growing:
            return False
        now = self._time.now_ns()
        if now - self._checked_ns >= GROWTH_NS:
            if now - self._checked_ns > GROWN_NS:
                self._grown_ns = now  # it was not checked meanwhile, so wait again
            self._checked_ns = now
            if self.track.refresh():
                self._grown_ns = now
                return True
            if self.track.is_replaced and not self._has_reported_replaced:
                self._has_reported_replaced = True
                log.warning("%s was replaced; playback continues with the file that was opened", self.track.path)
        if now - self._grown_ns > GROWN_NS:
            return False
        self._idle()
        return True

    def _refuse_posted(self) -> None:
        while (posted := self._mailbox.posted.take()) is not None:
            if posted.on_reply is not None:
                path = getattr(posted.item, "port", "") or getattr(posted.item, "service", "")
                self._bus.reply(posted.on_reply, Reply(self.world.tick, self.world.t_ns, fault=objection(path)))

    # -- jumps ----------------------------------------------------------------------------------------------------------------------

    def _place(self, run: int, t_ns: int) -> list[Sample]:
        """Go to a time of a run; return the last sample of each port."""
        self._set_time(t_ns)
        messages = self.track.seek(run, self.world.t_ns)
        self._follow_scene(self.world.t_ns)
        return self._samples(messages)

    def _set_time(self, t_ns: int) -> None:
        self.world.tick = self._ticks.first_at(t_ns)
        self.world.t_ns = self._ticks.time_of(self.world.tick)

    def _seek(self, run: int, t_ns: int, why: str) -> None:
        """Jump to a time of a run."""
        before = self.world.ports
        self._asked = self._bus.asked
        samples = self._place(run, t_ns)
        world = self.world
        changed = Event("ports_changed", world.tick, world.t_ns, "other bodies were there at this time")
        self._publish_jump(why, f"playback: {why}", samples, [changed] if world.ports is not before else [])

    def _jump(self, item: Item) -> None:
        """Play a recorded jump of time."""
        self.track.pop()
        self._set_time(item.t_ns)
        self._follow_scene(self.world.t_ns)
        event = self.track.messages.event(item.message)
        text = "time was set" if event is None else event.text
        self._publish_jump(text, text, [], [])

    def _publish_jump(self, why: str, text: str, samples: list[Sample], events: list[Event]) -> None:
        """Announce a jump with an event ``reset``; requests that wait for a tick end with the reason `why`."""
        world = self.world
        self._jumps += 1
        self._abort(self._goals, why)
        events = [Event("reset", world.tick, world.t_ns, text), *events]
        self._bus.publish(TickOutput(world.tick, world.t_ns, samples, [], events, world.ports, self._jumps))
        self.pace.release()

    def _at_end(self) -> None:
        from_ns, to_ns = self._bounds()
        if self.span.loops and to_ns > from_ns:
            self._loop()
            return
        self._abort(self._goals, "the recording ends here")
        if not self.paused:
            self.paused = True
            self._say("paused", "the end of the range")

    def _loop(self) -> None:
        """Begin again: at the first run, or at the begin of the range in the current run."""
        if self.span.from_s is None and self.span.to_s is None:
            self._seek(0, self.track.runs[0].from_ns, "the recording begins again")
        else:
            self._seek(self.track.run, self._bounds()[0], "the range begins again")

    def _follow_scene(self, t_ns: int) -> None:
        scene, world = self.track.scene_at(t_ns), self.world
        if scene.ports is not world.ports or scene.services is not world.services:
            world.ports, world.services, world.members = scene.ports, scene.services, members_of(scene)
        self.water = scene.water
        if self.track.messages.damaged and not self._has_reported_damage:
            self._has_reported_damage = True
            log.warning("%s: messages that cannot be read are skipped", self.track.path)

    def _bounds(self) -> tuple[int, int]:
        """Return begin and end of the range in the current run, ns."""
        run, span = self.track.runs[self.track.run], self.span
        from_ns = run.from_ns if span.from_s is None else max(run.from_ns, round(span.from_s * NANOSECONDS))
        to_ns = run.to_ns if span.to_s is None else min(run.to_ns, round(span.to_s * NANOSECONDS))
        return min(from_ns, run.to_ns), to_ns

    def _read(self, ports: Sequence[str], on_samples: OnSamples) -> None:
        found = [self.track.newest(path, self.world.ports) for path in ports]
        self._bus.hand_over(partial(on_samples, tuple(sample for sample in found if sample is not None)))

    def _fail(self, text: str) -> None:
        self.failure = text
        self.paused = True
        log.error("%s", text)
        self._bus.say(Event("diverged", self.world.tick, self.world.t_ns, text))

    def _say(self, event: Literal["paused", "resumed"], text: str) -> None:
        log.info("%s at %g s: %s", event, self.world.t_ns / NANOSECONDS, text)
        self._bus.say(Event(event, self.world.tick, self.world.t_ns, text))

    def _abort(self, goals: Sequence[Goal], why: str) -> None:
        """End requests that wait for a tick; those that have ended already are ignored."""
        for goal in [goal for goal in goals if goal in self._goals]:
            self._goals.remove(goal)
            self._bus.reply(goal.on_reply, Reply(self.world.tick, self.world.t_ns, fault=Fault("preempted", why)))
