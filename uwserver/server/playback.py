"""Plays a recording in place of a world, with the same hub for the same adapters and without physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from uwserver.ports import Json
from uwserver.recording.player.player import Player
from uwserver.recording.player.track import Track
from uwserver.recording.player.world import SERVICES, Range, objection
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import Scenery
from uwserver.server.context import Hub
from uwserver.simulation.bus import Bus
from uwserver.simulation.clock import Time, Timing
from uwserver.simulation.mailbox import Mailbox


@dataclass(frozen=True)
class Playback:
    """A recording to play.

    Attributes:
        track: the recording, which the player closes.
        timing: speed, and whether it begins paused.
        span: the range that is played.
    """

    track: Track
    timing: Timing
    span: Range

    def start(
        self,
        name: str,
        resolved: Resolved,
        outlet: tuple[Time, Bus, Mailbox],
        tell: tuple[Callable[[str], None], Callable[[], dict[str, Json]]],
    ) -> tuple[Player, Hub]:
        """Return the player, and the hub that shows it to adapters.

        Args:
            name: name of the server.
            resolved: the scenario, with the adapters that serve it.
            outlet: clock and queues of the server.
            tell: shutdown and status of the server.
        """
        _, bus, mailbox = outlet
        player = Player(self.track, self.timing, self.span, *outlet)
        scenery = Scenery(resolved, player.world, lambda: player.water)
        return player, Hub(name, player, bus, mailbox, *tell, None, None, scenery, SERVICES, objection, player.brief)
