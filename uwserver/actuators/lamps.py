"""The lamps of a vehicle: how bright each of them is."""

from __future__ import annotations

from msgspec import Struct

from uwserver.actuators.base import ActuatorTable, Body, Devices, Given, Timeout, check_members
from uwserver.ports import Field
from uwserver.table import Name, Probability


class LampsConfig(ActuatorTable, tag="lamps", kw_only=True, frozen=True):
    """Some or all lamps of the vehicle, commanded as one vector of levels. Cameras see their light.

    Attributes:
        members: names of lamps, in the order of the command; default: all, in the order of the vehicle file.
        level: at the start, and after `timeout_s` without a command; 0 dark, 1 bright.
    """

    own_wrench = False
    timeout_s: Timeout = 0.0
    members: tuple[Name, ...] = ()
    level: Probability = 0.0

    def devices(self) -> Devices:
        """Return the lamps."""
        return Devices("lamps", "lamp", "levels", self.members, is_vector=True)

    def build(self, body: Body) -> Lamps:
        """Return the actuator.

        Raises:
            ValueError: the vehicle has no lamps, or lacks one of the members; the text lists those that it has.
        """
        return Lamps(self, body.lamps)


class LampMemory(Struct):
    """The level of each lamp."""

    levels: tuple[float, ...]


class Lamps:
    """Holds the levels of lamps, which cameras read.

    Attributes:
        names: names of the lamps.
        memory: their levels.
    """

    def __init__(self, config: LampsConfig, there: tuple[str, ...]) -> None:
        self.names = config.members or there
        check_members("lamp", self.names, there)
        if not self.names:
            raise ValueError("the vehicle has no lamps: give it some under [lamps]")
        self._level = config.level
        order = ", ".join(self.names)
        self.doc = f"Lamps {order}."
        doc = f"level of each lamp, 0 dark and 1 bright, order: {order}"
        self.fields = (Field("levels", "1", doc, "", (len(self.names),), minimum=0.0, maximum=1.0),)
        self.neutral()

    def apply(self, value: Given) -> None:
        """Set the levels from now on."""
        (levels,) = value
        if levels is not None:
            self.memory = LampMemory(levels)

    def neutral(self) -> None:
        """Set all lamps to the level of the start."""
        self.memory = LampMemory((self._level,) * len(self.names))
