"""What cameras may see of a world: its things, its lamps, its light. Pictures are made elsewhere, and only where somebody looks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from uwserver.environment.light import Daylight, WaterLight
from uwserver.physics.kernel.arrays import FloatArray


class Sight(NamedTuple):
    """Of one world.

    Attributes:
        water, day: light.
        look: gives a `uwserver.sensors.optical.camera.visible.Look` at all that is there now.
        lamps: gives all lamps that shine now, each a `uwserver.sensors.optical.camera.lamps.LampAt`.
        state: gives the present state (n, 13) of all bodies.
    """

    water: WaterLight
    day: Daylight
    look: Callable[[], Any]
    lamps: Callable[[], tuple[Any, ...]]
    state: Callable[[], FloatArray]
