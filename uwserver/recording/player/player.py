"""Adds to playback the services that control it: those of the clock with their usual names, and those under ``playback/``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import cast

from uwserver.ports import Fault, Json, OnReply, Refused, Reply
from uwserver.recording.player.chunks import NotPlayable
from uwserver.recording.player.deck import MAX_GOALS, Deck, Goal
from uwserver.recording.player.world import DEFAULT, Range
from uwserver.units import NANOSECONDS

FASTEST = 0.0
"""The speed that stands for as fast as possible."""


class Player(Deck):
    """Plays a recording in place of a `uwserver.simulation.thread.Simulation`; arguments as in `Deck`."""

    def call(
        self, service: str, args: Mapping[str, Json], client: str, on_reply: OnReply, source: str = ""
    ) -> Callable[[], bool]:
        """Call a service of `uwserver.recording.player.world.SERVICES`, as `uwserver.simulation.thread.Simulation.call`."""
        goals: list[Goal] = []

        def act() -> None:
            result, fault = None, None
            try:
                result = self._act(service, args, on_reply, goals)
            except Refused as refused:
                fault = refused.fault
            except NotPlayable as error:
                self._fail(str(error))
                fault = Fault("internal", str(error))
            if not goals:
                self._bus.reply(on_reply, Reply(self.world.tick, self.world.t_ns, result, fault))

        def cancel() -> bool:
            if goals and goals[0] not in self._goals:
                return False
            self._steering.add(lambda: self._abort(goals, "cancelled by the caller"), source, always=True)
            return bool(goals)

        self._steering.add(act, source, on_reply)
        return cancel

    def _act(self, service: str, args: Mapping[str, Json], on_reply: OnReply, goals: list[Goal]) -> Json:
        """Carry out a service; one that takes time adds its goal to `goals`.

        Raises:
            Refused: it is not possible.
        """
        number = cast(Mapping[str, float], args)
        match service.partition("/")[2]:
            case "pause":
                self._pause()
            case "resume":
                self._resume()
            case "set_speed" | "speed":
                self._set_speed(number["speed"])
            case "seek":
                self._seek_to(number["t_s"], int(number["run"]))
            case "loop":
                self._set_range(bool(args["on"]), number["from_s"], number["to_s"])
            case "step":
                self._step(int(number["n"]), on_reply, goals)
            case "run_until":
                self._reach(self._ticks.at(number["t_s"]), on_reply, goals, "t_s")
            case "run_until_tick":
                self._reach(int(number["tick"]), on_reply, goals, "tick")
            case "state":
                return self.state()
        return None

    # -- services -------------------------------------------------------------------------------------------------------------------

    def _pause(self) -> None:
        self._abort(self._goals, "the playback was paused")
        if not self.paused:
            self.paused = True
            self._say("paused", "on request")

    def _resume(self) -> None:
        if self.failure:
            raise Refused("denied", f"{self.failure}: start `uwserver play` again")
        if self._is_over and not (self.track.is_growing and self.track.refresh()):
            self._loop()
        if self.paused:
            self.paused = False
            self._say("resumed", "on request")

    @property
    def _is_over(self) -> bool:
        return self.track.head_item is None or (self.span.to_s is not None and self.world.t_ns >= self._bounds()[1])

    def _set_speed(self, speed: float) -> None:
        is_free = speed == FASTEST
        self.timing = replace(self.timing, mode="freerun" if is_free else "realtime", speed=speed or self.timing.speed)
        self.pace.speed = speed or self.pace.speed
        self.pace.release()

    def _seek_to(self, t_s: float, run: int) -> None:
        if self.track.is_growing:
            self.track.refresh()
        runs = self.track.runs
        number = self.track.run if run == DEFAULT else run
        if number >= len(runs):
            raise Refused("out_of_range", f"there are {len(runs)} runs, counted from 0", "run")
        t_ns, there = round(t_s * NANOSECONDS), runs[number]
        if t_ns > there.to_ns + self._ticks.time_of(1):
            text = f"run {number} ends at {there.to_ns / NANOSECONDS:g} s"
            raise Refused("out_of_range", f"{text}: there is nothing at {t_s:g} s", "t_s")
        self._seek(number, max(t_ns, there.from_ns), f"sought {t_s:g} s")

    def _set_range(self, loops: bool, from_s: float, to_s: float) -> None:
        span = Range(
            self.span.from_s if from_s == DEFAULT else from_s, self.span.to_s if to_s == DEFAULT else to_s, loops
        )
        if span.from_s is not None and span.to_s is not None and span.from_s >= span.to_s:
            raise Refused("out_of_range", f"the range from {span.from_s:g} to {span.to_s:g} s is empty", "to_s")
        self.span = span

    def _step(self, n: int, on_reply: OnReply, goals: list[Goal]) -> None:
        if not self.paused:
            raise Refused("busy", "time runs by itself: call playback/pause first, then step")
        if n < 0:
            t_ns = max(self.track.runs[self.track.run].from_ns, self._ticks.time_of(max(0, self.world.tick + n)))
            self._seek(self.track.run, t_ns, f"{-n} ticks back")
        elif n:
            self._add_goal(self.world.tick + n, on_reply, goals)

    def _reach(self, tick: int, on_reply: OnReply, goals: list[Goal], where: str) -> None:
        if tick < self.world.tick:
            text = f"playback is at tick {self.world.tick}, t = {self.world.t_ns / NANOSECONDS:g} s"
            raise Refused("out_of_range", f"{text}, which is later; use playback/seek", where)
        if tick > self.world.tick:
            self._add_goal(tick, on_reply, goals)

    def _add_goal(self, tick: int, on_reply: OnReply, goals: list[Goal]) -> None:
        if len(self._goals) >= MAX_GOALS:
            raise Refused(
                "overload", f"{MAX_GOALS} steps and runs of all clients are in progress: wait for one of them"
            )
        goals.append(Goal(tick, on_reply, self.paused))
        self._goals = sorted([*self._goals, *goals], key=lambda goal: goal.tick)

    # -- status ---------------------------------------------------------------------------------------------------------------------

    def brief(self) -> dict[str, Json]:
        """Return the part of ``world/status`` about playback. On any thread."""
        run, span = self.track.runs[self.track.run], self.span
        return {
            "file": self.track.path.name,
            "t_s": self.world.t_ns / NANOSECONDS,
            "from_s": run.from_ns / NANOSECONDS,
            "to_s": run.to_ns / NANOSECONDS,
            "run": self.track.run,
            "runs": len(self.track.runs),
            "loop": span.loops,
            "range_s": [span.from_s, span.to_s],
            "speed": FASTEST if self.timing.pace is None else self.pace.speed,
            "growing": self.track.is_growing,
        }

    def state(self) -> dict[str, Json]:
        """Return the answer of ``playback/state``."""
        details: dict[str, Json] = {
            "paused": self.paused,
            "tick": self.world.tick,
            "damaged": self.track.messages.damaged,
            "remarks": list(self.track.remarks),
            "spans_s": [[run.from_ns / NANOSECONDS, run.to_ns / NANOSECONDS] for run in self.track.runs],
            "marks": [
                {
                    "run": mark.run,
                    "t_s": mark.event.t_ns / NANOSECONDS,
                    "event": mark.event.event,
                    "text": mark.event.text,
                }
                for mark in self.track.marks()
            ],
        }
        return self.brief() | details
