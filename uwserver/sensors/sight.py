"""What cameras may see of a world: its things, its lamps, its light. Rays and pictures are made elsewhere, and only where somebody looks."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import TYPE_CHECKING

from uwserver.environment.light import Daylight, WaterLight
from uwserver.physics.kernel.arrays import FloatArray

if TYPE_CHECKING:
    from uwserver.sensors.optical.camera.lamps import LampAt
    from uwserver.sensors.optical.camera.visible import Look, Models, Seen


class Sight:
    """The things of one world, which come and go.

    Attributes:
        water, day: light.
        lamps: gives all that shine now.
        state: gives the present state (n, 13) of all bodies.
    """

    def __init__(
        self,
        light: tuple[WaterLight, Daylight],
        things: Callable[[], Iterable[Seen]],
        who: Callable[[], Hashable],
        lamps: Callable[[], tuple[LampAt, ...]],
        state: Callable[[], FloatArray],
    ) -> None:
        """Of a world.

        Args:
            light: water and daylight.
            things: tells all that can be seen.
            who: tells who is in the world: another value when bodies came or went.
            lamps, state: see above.
        """
        self.water, self.day = light
        self.lamps, self.state = lamps, state
        self._things, self._who = things, who
        self._models: Models | None = None
        self._look: tuple[Hashable, Look] | None = None

    def look(self) -> Look:
        """At all that is there now; the same until bodies come or go."""
        who = self._who()
        if self._look is None or self._look[0] != who:
            from uwserver.sensors.optical.camera.visible import Look, Models

            if self._models is None:
                self._models = Models()
            self._look = who, Look(self._things(), self._models)
        return self._look[1]

    def faults(self) -> list[str]:
        """What cannot be shown as it is, as texts. Before anything runs."""
        self.look().made()
        return [] if self._models is None else self._models.faults
