"""Who reads what the world measures: samples are made of those ports alone, and of others the newest on request."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from uwserver.ports import Cast, Refused, Sample, SceneState
from uwserver.ports.thinning import WHOLE
from uwserver.simulation.bus import Bus
from uwserver.simulation.steering import Steering
from uwserver.simulation.wants import Wanted
from uwserver.world.lookout import Lookout
from uwserver.world.world import World

log = logging.getLogger(__name__)

AT_ONCE = 16
"""Ports that are read between two ticks before others have their turn: about 0.1 ms."""

OnState = Callable[[SceneState], None]
"""Gets where all bodies are."""
OnSamples = Callable[[Sequence[Sample]], None]
"""Gets the newest samples of some ports."""


class Readers:
    """Between a world and those who read it."""

    def __init__(self, world: World, bus: Bus, steering: Steering) -> None:
        """Of a simulation; `bus` knows who wants what, `steering` is what its thread does between two ticks."""
        self._world, self._bus, self._steering = world, bus, steering
        self._wanted: Wanted | None = None
        self._lookout = Lookout(world)
        self._seen = SceneState(Cast(0, (), ()), 0, np.zeros((0, 7)), np.zeros(0, np.int8), (0.0, 0.0, 0.0))
        self._is_blind = False
        bus.expect(world.ports, world.jumps)

    def begin(self) -> None:
        """A tick begins: what is wanted by now is made in it. Simulation thread."""
        wanted = self._bus.wanted
        if wanted is not self._wanted:
            self._wanted = wanted
            world = self._world
            # What the readers know of is past: what is enough for them was said of other samples.
            is_past = wanted is None or wanted.known is not world.ports or wanted.jumps != world.jumps
            world.want(wanted, WHOLE if wanted is None or is_past else wanted.thinned)

    def read(self, ports: Sequence[str], on_samples: OnSamples, source: str = "") -> None:
        """Ask for the newest delivered samples of some ports, wanted or not. Loop thread.

        They are not kept for this on the loop: what nobody asks for costs nothing there, and a sample that a sensor sends once in an hour is
        not lost to who asks later.

        Args:
            ports: paths; those that are gone, or have said nothing yet, are left out.
            on_samples: gets them on the loop, after all that the world had said before.
            source: who asks.

        Raises:
            Refused: `overload`; it asked too much before.
        """
        self._steering.add(partial(self._look, ports, 0, [], on_samples, source), source)

    def look(self, on_state: OnState, source: str = "") -> None:
        """Ask where all bodies are. Loop thread.

        Args:
            on_state: gets it on the loop, after all that the world had said before.
            source: who asks.

        Raises:
            Refused: `overload`; it asked too much before.
        """
        self._steering.add(partial(self._look_at_bodies, on_state), source)

    def _look_at_bodies(self, on_state: OnState) -> None:
        try:
            state = self._lookout.state()
        except Exception:  # a fault of ours in what only viewers need must not end the world
            if not self._is_blind:
                self._is_blind = True
                log.exception("where the bodies are cannot be told: viewers see them where they were")
            state = self._seen
        self._seen = state
        self._bus.hand_over(partial(on_state, state))

    def _look(self, ports: Sequence[str], first: int, found: list[Sample], on_samples: OnSamples, source: str) -> None:
        for path in ports[first : first + AT_ONCE]:
            try:
                reading = self._world.read(path)
            except Refused:
                continue  # its vehicle left
            if reading is not None:
                found.append(reading.sample)
        rest = first + AT_ONCE
        if rest < len(ports):
            self._steering.add(partial(self._look, ports, rest, found, on_samples, source), source, always=True)
        else:
            self._bus.hand_over(partial(on_samples, tuple(found)))
