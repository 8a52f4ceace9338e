"""Profiles of ticks on request: ``world/profile``, and `uwserver run --profile`. Loop thread.

Ticks are measured only while a profile is requested.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from uwserver.ports import Argument, OnReply, Refused, Reply, Service
from uwserver.simulation.thread import Simulation
from uwserver.world.parts.profile import Profile, Report, Window

PROFILE = Service(
    "world/profile",
    "Measure ticks for some seconds of wall time, then tell what a tick takes by stage and kind: mean and worst, calls, readings.",
    (
        Argument(
            "seconds", "float", "how long, wall time", "s", required=False, default=1.0, minimum=0.01, maximum=3600.0
        ),
    ),
    long_running=True,
)
MAX_MEASUREMENTS = 16
"""Most measurements at a time, as each tick is added to all of them."""

Done = Callable[[Report], None]


@dataclass(eq=False)
class _Measurement:
    """A measurement that goes on.

    Attributes:
        done: takes the report. Loop thread.
        source: the client; begin and end of one client keep their order.
        ending: whether its end was requested. Loop thread.
        window: what is measured; used by the simulation thread while that runs.
        report: the result.
    """

    done: Done
    source: str = ""
    ending: bool = False
    window: Window | None = None
    report: Report | None = None


class Profiling:
    """The measurements of a simulation."""

    def __init__(
        self,
        simulation: Simulation,
        now_ns: Callable[[], int],
        call_soon: Callable[[Callable[[], None]], None],
        call_later: Callable[[float, Callable[[], None]], object],
    ) -> None:
        """Begin without measurements, before the simulation runs.

        Args:
            simulation: its ticks are measured.
            now_ns: gives the time of a clock, ns.
            call_soon: lets the loop call a function, from any thread.
            call_later: lets the loop call a function after some seconds.
        """
        self._simulation, self._call_soon, self._call_later = simulation, call_soon, call_later
        self._profile = Profile(now_ns)
        self._running: set[_Measurement] = set()
        self._finished = False

    def call(self, seconds: float, source: str, on_reply: OnReply) -> Callable[[], bool]:
        """Carry out `PROFILE`. Returns its cancel function.

        Raises:
            Refused: there are too many measurements.
        """
        if len(self._running) >= MAX_MEASUREMENTS:
            raise Refused("overload", f"{MAX_MEASUREMENTS} profiles are being measured: wait for one of them")
        world = self._simulation.world

        def done(report: Report) -> None:
            on_reply(Reply(world.tick, world.t_ns, report.as_json()))

        def cancel() -> bool:
            if measurement.ending:
                return False
            refused = Refused("preempted", "cancelled by the caller")
            measurement.done = lambda report: on_reply(Reply(world.tick, world.t_ns, fault=refused.fault))
            self._end(measurement)
            return True

        measurement = _Measurement(done, source)
        self._begin(measurement, seconds)
        return cancel

    def tell_every(self, seconds: float, tell: Callable[[str], None]) -> None:
        """Report a table again and again after `seconds` of wall time, and one for the whole run at its end."""

        def again(report: Report) -> None:
            if not self._finished:
                tell(report.table())
                self._begin(_Measurement(again), seconds)

        self._begin(_Measurement(lambda report: tell(f"the whole run: {report.table()}")), None)
        self._begin(_Measurement(again), seconds)

    def finish(self) -> None:
        """Report what was measured so far to all that wait, after the simulation thread has ended."""
        self._finished = True
        for measurement in tuple(self._running):
            self._tell(
                measurement, measurement.report or self._profile.close(measurement.window or self._profile.open())
            )

    def _begin(self, measurement: _Measurement, seconds: float | None) -> None:
        """Measure for `seconds`; None: until the end of the run."""

        def begin() -> None:
            if not self._profile.is_needed:
                self._simulation.watch(self._profile)
            measurement.window = self._profile.open()
            if seconds is not None:
                self._call_soon(partial(self._end_in, seconds, measurement))

        self._simulation.steer(begin, measurement.source, always=not measurement.source)
        self._running.add(measurement)

    def _end_in(self, seconds: float, measurement: _Measurement) -> None:
        self._call_later(seconds, partial(self._end, measurement))

    def _end(self, measurement: _Measurement) -> None:
        if not measurement.ending:
            measurement.ending = True
            self._simulation.steer(partial(self._close, measurement), measurement.source, always=True)

    def _close(self, measurement: _Measurement) -> None:
        """End a measurement, on the simulation thread. It has begun by now, as steering keeps the order of a client."""
        assert measurement.window is not None
        report = measurement.report = self._profile.close(measurement.window)
        if not self._profile.is_needed:
            self._simulation.watch(None)
        self._call_soon(partial(self._tell, measurement, report))

    def _tell(self, measurement: _Measurement, report: Report) -> None:
        if measurement in self._running:  # at the end of the run `finish` may have reported it
            self._running.remove(measurement)
            measurement.done(report)
