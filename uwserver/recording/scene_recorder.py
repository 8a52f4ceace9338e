"""Observes the bodies of a world and their poses, for playback of the recording."""

from __future__ import annotations

import logging
import math

from uwserver.ports import SceneState
from uwserver.recording.states import STATES_HZ, Presence, Seen
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import water_view
from uwserver.world.scene_probe import SceneProbe
from uwserver.world.world import World

log = logging.getLogger(__name__)


class SceneRecorder:
    """Observes the bodies of a world and their poses, at most `STATES_HZ` times a second. Runs on the simulation thread."""

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._world, self._resolved = world, resolved
        self._probe = SceneProbe(world)
        self._every = max(1, math.ceil(world.rate_hz / STATES_HZ))
        self._seen: Presence | None = None
        self._current = world.water.current
        self._began: int | None = None
        self._jumps, self._has_failed = world.jumps, False

    def begin(self) -> None:
        """Count the jumps of time from here on. Later calls do nothing."""
        if self._began is None:
            self._began = self._world.jumps

    def next_tick(self, tick: int) -> int:
        """Return the next tick at which poses are due; the very next one if none were taken yet."""
        return tick + 1 if self._seen is None and not self._has_failed else tick + self._every - tick % self._every

    def changes(self) -> tuple[Presence | Seen, ...]:
        """Return the bodies, ports and services, if they changed, and the poses, if they are due."""
        world, seen = self._world, self._seen
        self.begin()
        is_as_before = seen is not None and seen.ports is world.ports and seen.services is world.services
        if self._has_failed or (world.tick % self._every and world.jumps == self._jumps and is_as_before):
            return ()
        self._jumps = world.jumps
        try:
            state = self._probe.state()
            found = Seen(self._since_began, state)
            presence = self._presence(state)
        except Exception:  # an internal fault in data for viewers only must end neither the world nor the recording
            self._has_failed = True
            log.exception("the poses of the bodies cannot be recorded; the recording continues without them")
            return ()
        return (found,) if presence is None else (presence, found)

    @property
    def _since_began(self) -> int:
        return self._world.jumps - (self._began or 0)

    def _presence(self, state: SceneState) -> Presence | None:
        world, seen = self._world, self._seen
        if seen and seen.entities is state.entities and seen.ports is world.ports and seen.services is world.services:
            return None
        models = {name: member.vehicle.model for name, member in world.members.items()}
        has_other_water = seen is None or self._current != state.current
        water = water_view(self._resolved, world) if has_other_water else None
        self._current = state.current
        self._seen = Presence(
            state.entities, self._since_began, world.tick, world.t_ns, world.ports, world.services, models, water
        )
        return self._seen
