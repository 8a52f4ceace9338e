"""Sees who is in a world and where, for a recording that is to be played."""

from __future__ import annotations

import logging
import math

from uwserver.ports import SceneState
from uwserver.recording.states import STATES_HZ, Presence, Seen
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import water_view
from uwserver.world.lookout import Lookout
from uwserver.world.world import World

log = logging.getLogger(__name__)


class Looker:
    """Sees who is in a world and where, at most `STATES_HZ` a second. Simulation thread."""

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._world, self._resolved = world, resolved
        self._lookout = Lookout(world)
        self._every = max(1, math.ceil(world.rate_hz / STATES_HZ))
        self._seen: Presence | None = None
        self._current = world.water.current
        self._began: int | None = None
        self._jumps, self._is_blind = world.jumps, False

    def begin(self) -> None:
        """From here on whoever is told events hears of each jump."""
        if self._began is None:
            self._began = self._world.jumps

    def next_tick(self, tick: int) -> int:
        """After this one, the next in which it is time to tell where everybody is: the very next where nobody has been told of yet."""
        return tick + 1 if self._seen is None and not self._is_blind else tick + self._every - tick % self._every

    def look(self) -> tuple[Presence | Seen, ...]:
        """Who is there, if that has changed, and where, if it is time to tell."""
        world, seen = self._world, self._seen
        self.begin()
        is_as_before = seen is not None and seen.ports is world.ports and seen.services is world.services
        if self._is_blind or (world.tick % self._every and world.jumps == self._jumps and is_as_before):
            return ()
        self._jumps = world.jumps
        try:
            state = self._lookout.state()
            found = Seen(self._since_began, state)
            presence = self._presence(state)
        except Exception:  # a fault of ours in what only viewers need must end neither world nor recording
            self._is_blind = True
            log.exception("where the bodies are cannot be told: the recording goes on without it")
            return ()
        return (found,) if presence is None else (presence, found)

    @property
    def _since_began(self) -> int:
        return self._world.jumps - (self._began or 0)

    def _presence(self, state: SceneState) -> Presence | None:
        world, seen = self._world, self._seen
        if seen and seen.cast is state.cast and seen.ports is world.ports and seen.services is world.services:
            return None
        models = {name: member.vehicle.model for name, member in world.members.items()}
        is_other_water = seen is None or self._current != state.current
        water = water_view(self._resolved, world) if is_other_water else None
        self._current = state.current
        self._seen = Presence(
            state.cast, self._since_began, world.tick, world.t_ns, world.ports, world.services, models, water
        )
        return self._seen
