"""Makes the additional channels of a recording that Foxglove, Lichtblick and rerun show without set-up. A replay ignores them."""

from __future__ import annotations

import logging
from collections.abc import Iterator

from uwserver.adapter.foxglove import Foreign, SceneChannels
from uwserver.ports import Event, Port, Sample, SceneState, WaterView
from uwserver.recording.states import Presence
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import Scenery
from uwserver.world.world import World

log = logging.getLogger(__name__)

_FAULT = "an internal fault ended the channels for Foxglove; the recording itself continues"


class FoxgloveChannels:
    """Makes the messages for other viewers. It runs on the recorder's thread, and reads only what is constant in the world.

    An internal fault ends these channels, but not the recording.

    Args:
        world: as built.
        resolved: the scenario from which it was built.
    """

    def __init__(self, world: World, resolved: Resolved) -> None:
        self._water: WaterView | None = None
        self._scenery = Scenery(resolved, world, self._newest_water)
        self._channels = SceneChannels(self._scenery.meshes.data.__getitem__, self._scenery.model_files.__getitem__)
        self._ended = False

    def of(self, item: Presence | SceneState | Event) -> Iterator[Foreign]:
        """Yield the messages for the entities of the world, their poses, or an event."""
        if self._ended:
            return
        try:
            if isinstance(item, Presence):
                self._water = item.water or self._water
                yield self._channels.scene(self._scenery.scene(item.entities), item.t_ns)
            elif isinstance(item, SceneState):
                yield from self._channels.state(item)
            else:
                yield self._channels.event(item)
        except Exception:  # channels that only other viewers need must not end the recording
            self._ended = True
            log.exception(_FAULT)

    def of_sample(self, sample: Sample, port: Port) -> Foreign | None:
        """Return the message for a sample of this port; None for most ports."""
        if self._ended:
            return None
        try:
            return self._channels.sample(port, sample)
        except Exception:  # as above
            self._ended = True
            log.exception(_FAULT)
            return None

    def shows(self, port: Port) -> bool:
        """Return whether samples of a port may have messages."""
        return not self._ended and self._channels.shows(port)

    def _newest_water(self) -> WaterView:
        assert self._water is not None, "the first presence contains the water"
        return self._water
