"""What cameras may see of a world: its things, its lamps, its light. Rays and pictures are made elsewhere, and only where somebody looks."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import TYPE_CHECKING

from uwserver.environment.light import Daylight, WaterLight
from uwserver.physics.kernel.arrays import FloatArray

if TYPE_CHECKING:
    from uwserver.sensors.optical.camera.lamps import LampAt
    from uwserver.sensors.optical.camera.visible import Seen, Visible


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
        self._models: object = None
        self._made: tuple[Hashable, Visible] | None = None

    def visible(self) -> Visible:
        """All that is there now; costs something after bodies came or went."""
        from uwserver.sensors.optical.camera.visible import Models, Visible

        who = self._who()
        if self._made is None or self._made[0] != who:
            if not isinstance(self._models, Models):
                self._models = Models()
            self._made = who, Visible(self._things(), self._models)
        return self._made[1]

    def faults(self) -> list[str]:
        """What cannot be shown as it is, as texts."""
        self.visible()
        return list(getattr(self._models, "faults", ()))
