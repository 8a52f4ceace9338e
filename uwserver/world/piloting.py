"""Autopilots as parts of their world: one that steps them all in one call before the bodies move, and one each for what it remembers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from uwserver.autopilot.bank import Bank, Seat
from uwserver.autopilot.craft import Held
from uwserver.autopilot.pilot import Autopilot
from uwserver.autopilot.state import Remembered
from uwserver.physics.bodies import Hydrodynamics
from uwserver.ports import Sample
from uwserver.world.banks import load_autopilots as load_kernels
from uwserver.world.part import Part, State


class PilotState(State, frozen=True):
    """What an autopilot believes, remembers, and was told."""

    pilot: Remembered


class Piloting(Part):
    """One autopilot. Compiled code hears its sensors but for those that speak in words, which come as samples."""

    state_type = PilotState

    def __init__(self, pilot: Autopilot) -> None:
        self.pilot = pilot
        self.hears = pilot.craft.hearing.in_words

    @property
    def path(self) -> str:
        """``<vehicle>/autopilot``."""
        return self.pilot.craft.path

    def hear(self, sample: Sample, t_ns: int) -> None:
        """Take the sample into the estimate."""
        if sample.valid:
            self.pilot.seat.hear(sample.port, sample.value, sample.t_ns, t_ns)

    def leave(self, why: str) -> None:
        """Answer who waits for the end of a way."""
        self.pilot.preempt(why)

    def save(self) -> PilotState:
        """All that it remembers; the call that waits is not part of it."""
        return PilotState(self.pilot.seat.save())

    def check(self, state: Any) -> None:
        """It is of this vehicle."""
        self.pilot.check(state.pilot)

    def load(self, state: PilotState) -> None:
        """Go on from there."""
        self.pilot.load(state.pilot)


class _Switch(NamedTuple):
    """An actuator that somebody may switch off, and whose autopilot has to know."""

    slot: Held
    seat: Seat


class Pilots(Part):
    """A part that stands for all autopilots: each steps with its divisor, in the step (`uwserver.step.tick`)."""

    path = "world/autopilots"
    state_type = State

    def __init__(self, hydro: Hydrodynamics) -> None:
        self._hydro = hydro
        self._bank: Bank | None = None
        self._pilots: dict[int, Autopilot] = {}
        self._streams: Mapping[str, int] = {}
        self._divisors: tuple[int, ...] = ()
        self._switches: list[_Switch] = []
        self._active: list[bool] = []
        self.ports: tuple[str, ...] = ()

    def settle(self, parts: Iterable[Part], streams: Mapping[str, int]) -> None:
        """Parts came or went: the autopilots among them lie here from now on.

        Args:
            parts: all of the world.
            streams: numbers of the streams of samples, by port.
        """
        pilots = [part.pilot for part in parts if isinstance(part, Piloting)]
        if pilots == list(self._pilots.values()) and streams == self._streams:
            return
        self._streams = streams
        self._divisors = tuple({pilot.craft.divisor for pilot in pilots})
        self.ports = tuple([port for pilot in pilots for port in pilot.craft.hearing.ports if port in streams])
        self._pilots = dict(enumerate(pilots))
        self._switches = [_Switch(slot, pilot.seat) for pilot in pilots for slot in pilot.craft.held]
        self._active = []
        if pilots and self._bank is None:
            load_kernels()
            self._bank = Bank()
        if self._bank is not None:
            self._bank.gather([pilot.seat for pilot in pilots], streams, max(streams.values(), default=-1) + 1)

    def attend(self, t_ns: int) -> None:
        """Some have stepped that need Python."""
        assert self._bank is not None
        for k, need in self._bank.needs():
            self._pilots[k].attend(need, self._hydro.table, t_ns)

    @property
    def bank(self) -> Bank | None:
        """Where they lie; None where there is none."""
        return self._bank if self._pilots else None

    @property
    def every(self) -> int:
        """Ticks of which those are a multiple in which any may be due."""
        return math.gcd(*self._divisors)

    def follow_switches(self) -> None:
        """Actuators may have been switched on or off since the last tick."""
        active = [switch.slot.active for switch in self._switches]
        if active != self._active:
            self._active = active
            for switch in self._switches:
                switch.seat.switch()

    def save(self) -> State:
        """Nothing: each keeps its own."""
        return State()

    def load(self, state: Any) -> None:
        """Nothing."""
