"""Autopilots as parts of their world: one part that steps all of them in one call before the bodies move, and one part for the state of
each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from uwserver.autopilot.arrays import AutopilotArrays, AutopilotRow
from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.state import Remembered
from uwserver.autopilot.vehicle_spec import Held
from uwserver.physics.bodies import Hydrodynamics
from uwserver.ports import Sample
from uwserver.world.parts.part import Part, State, Stateless
from uwserver.world.stepping import kernel_stages


class PilotState(State, frozen=True):
    """The state of an autopilot: its estimate, its memory and its orders."""

    pilot: Remembered


class Piloting(Part):
    """One autopilot. Compiled code gives it the samples of its sensors, except those with texts, which come as sample objects."""

    state_type = PilotState

    def __init__(self, pilot: Autopilot) -> None:
        self.pilot = pilot
        self.listens_to = pilot.spec.inputs.text_ports

    @property
    def path(self) -> str:
        """``<vehicle>/autopilot``."""
        return self.pilot.spec.path

    def on_sample(self, sample: Sample, t_ns: int) -> None:
        """Take a sample into the estimate."""
        if sample.valid:
            self.pilot.row.on_sample(sample.port, sample.value, sample.t_ns, t_ns)

    def leave(self, why: str) -> None:
        """Answer the caller that waits for the end of a manoeuvre."""
        self.pilot.preempt(why)

    def save(self) -> PilotState:
        """Return its state. The call that waits is not part of it."""
        return PilotState(self.pilot.row.save())

    def check(self, state: Any) -> None:
        """Raise ValueError if the state is not of this vehicle's autopilot."""
        self.pilot.check(state.pilot)

    def load(self, state: PilotState) -> None:
        """Take over a checked state."""
        self.pilot.load(state.pilot)


class _Switch(NamedTuple):
    """An actuator that can be switched off, and the autopilot that has to know of it."""

    slot: Held
    row: AutopilotRow


class Pilots(Stateless):
    """A part that stands for all autopilots. They step within the step (`uwserver.step.tick`), each once every `divisor` ticks."""

    path = "world/autopilots"

    def __init__(self, hydro: Hydrodynamics) -> None:
        self._hydro = hydro
        self._arrays: AutopilotArrays | None = None
        self._pilots: dict[int, Autopilot] = {}
        self._streams: Mapping[str, int] = {}
        self._divisors: tuple[int, ...] = ()
        self._switches: list[_Switch] = []
        self._active: list[bool] = []
        self.ports: tuple[str, ...] = ()

    def parts_changed(self, parts: Iterable[Part], streams: Mapping[str, int]) -> None:
        """Find the autopilots again after parts were added or removed.

        Args:
            parts: all parts of the world.
            streams: numbers of the streams of samples, by port.
        """
        pilots = [part.pilot for part in parts if isinstance(part, Piloting)]
        if pilots == list(self._pilots.values()) and streams == self._streams:
            return
        self._streams = streams
        self._divisors = tuple({pilot.spec.divisor for pilot in pilots})
        self.ports = tuple([port for pilot in pilots for port in pilot.spec.inputs.ports if port in streams])
        self._pilots = dict(enumerate(pilots))
        self._switches = [_Switch(slot, pilot.row) for pilot in pilots for slot in pilot.spec.held]
        self._active = []
        if pilots and self._arrays is None:
            kernel_stages.load("autopilots")
            self._arrays = AutopilotArrays()
        if self._arrays is not None:
            self._arrays.gather([pilot.row for pilot in pilots], streams, max(streams.values(), default=-1) + 1)

    def attend(self, t_ns: int) -> None:
        """Do the Python work of the autopilots that have just stepped."""
        assert self._arrays is not None
        for k, need in self._arrays.needs():
            self._pilots[k].attend(need, self._hydro.table, t_ns)

    @property
    def arrays(self) -> AutopilotArrays | None:
        """The rows of the autopilots; None if there are no autopilots."""
        return self._arrays if self._pilots else None

    @property
    def every(self) -> int:
        """Autopilots step only in ticks that are a multiple of this."""
        return math.gcd(*self._divisors)

    def follow_switches(self) -> None:
        """Tell the autopilots which actuators were switched on or off since the last tick."""
        active = [switch.slot.active for switch in self._switches]
        if active != self._active:
            self._active = active
            for switch in self._switches:
                switch.row.switch()
