"""The readers of a world: samples are made only of ports that they subscribe to, and the newest sample of any port on request."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from uwserver.ports import EntityList, Refused, Sample, SceneState
from uwserver.ports.decimation import EVERY_SAMPLE
from uwserver.simulation.bus import Bus, Subscriptions
from uwserver.simulation.mailbox import Steering
from uwserver.world.state.scene_probe import SceneProbe
from uwserver.world.world import World

log = logging.getLogger(__name__)

AT_ONCE = 16
"""Ports that are read between two ticks in one go, in about 0.1 ms. Then other clients have their turn."""

OnState = Callable[[SceneState], None]
"""Takes the state of the scene."""
OnSamples = Callable[[Sequence[Sample]], None]
"""Takes the newest samples of some ports."""


class Readers:
    """Stands between a world and its readers."""

    def __init__(self, world: World, bus: Bus, steering: Steering, *, makes_all: bool = False) -> None:
        """Take the world of a simulation.

        Args:
            world: world of the simulation.
            bus: knows the subscriptions.
            steering: runs actions between two ticks.
            makes_all: all samples are made, also those that nobody subscribes to, as the program that steps the world gets them.
        """
        self._world, self._bus, self._steering, self._makes_all = world, bus, steering, makes_all
        self._subscriptions: Subscriptions | None = None
        self._probe = SceneProbe(world)
        self._seen = SceneState(EntityList(0, (), ()), 0, np.zeros((0, 7)), np.zeros(0, np.int8), (0.0, 0.0, 0.0))
        self._is_blind = False
        bus.expect(world.ports, world.jumps)

    def begin(self) -> None:
        """Begin a tick: give the world the present subscriptions. Simulation thread."""
        subscriptions = self._bus.subscriptions
        if subscriptions is not self._subscriptions and not self._makes_all:
            self._subscriptions = subscriptions
            world = self._world
            # The decimations are for ports and times that have changed since, so they do not apply.
            is_past = (
                subscriptions is None or subscriptions.known is not world.ports or subscriptions.jumps != world.jumps
            )
            world.subscribe(
                subscriptions, EVERY_SAMPLE if subscriptions is None or is_past else subscriptions.decimations
            )

    def read(self, ports: Sequence[str], on_samples: OnSamples, source: str = "") -> None:
        """Ask for the newest delivered samples of some ports, subscribed to or not. Loop thread.

        The loop keeps no samples for this: a port that is not read costs nothing there, and a sample that a sensor sends once in an hour
        can still be read later.

        Args:
            ports: paths; ports that are gone, or have no sample yet, are left out.
            on_samples: gets the samples on the loop, after everything that the world has sent before.
            source: the client.

        Raises:
            Refused: `overload`; the client has too many requests waiting.
        """
        self._steering.add(partial(self._read_part, ports, 0, [], on_samples, source), source)

    def request_scene_state(self, on_state: OnState, source: str = "") -> None:
        """Ask for the state of the scene: where all bodies are. Loop thread.

        Args:
            on_state: gets it on the loop, after everything that the world has sent before.
            source: the client.

        Raises:
            Refused: `overload`; the client has too many requests waiting.
        """
        self._steering.add(partial(self._hand_over_scene_state, on_state), source)

    def _hand_over_scene_state(self, on_state: OnState) -> None:
        try:
            state = self._probe.state()
        except Exception:  # A fault in what only viewers need must not end the world.
            if not self._is_blind:
                self._is_blind = True
                log.exception("the poses of the bodies cannot be read: viewers keep the last ones")
            state = self._seen
        self._seen = state
        self._bus.hand_over(partial(on_state, state))

    def _read_part(
        self, ports: Sequence[str], first: int, found: list[Sample], on_samples: OnSamples, source: str
    ) -> None:
        for path in ports[first : first + AT_ONCE]:
            try:
                reading = self._world.read(path)
            except Refused:
                continue  # its vehicle was removed
            if reading is not None:
                found.append(reading.sample)
        rest = first + AT_ONCE
        if rest < len(ports):
            self._steering.add(partial(self._read_part, ports, rest, found, on_samples, source), source, always=True)
        else:
            self._bus.hand_over(partial(on_samples, tuple(found)))
