"""The commands of the actuators that an autopilot holds, seen as parts of their full commands: to show them, and to try them one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from uwserver.autopilot.allocation import Given


@dataclass(frozen=True)
class Hold:
    """One held actuator.

    Attributes:
        names: of its devices, `thrusters.t1`, one for each component of its command.
        full: full command of each component, in its unit, field by field.
    """

    names: tuple[str, ...]
    full: tuple[tuple[float, ...], ...]


class Outputs:
    """All components of all held actuators in a row.

    Args:
        holds: in the order of the allocation's commands.

    Attributes:
        names: of the components.
    """

    def __init__(self, holds: Sequence[Hold]) -> None:
        self.names = tuple(name for hold in holds for name in hold.names)
        self._holds = [hold.full for hold in holds]

    def parts(self, commands: Sequence[Given]) -> tuple[float, ...]:
        """Commands over full commands: -1 to 1, 0 for a field that is left out."""
        return tuple(
            value / most
            for fields, command in zip(self._holds, commands, strict=True)
            for full, values in zip(fields, command, strict=True)
            for most, value in zip(full, values or (0.0,) * len(full), strict=True)
        )

    def commands(self, parts: Sequence[float]) -> list[Given]:
        """The other way round: commands of each actuator."""
        rest = iter(parts)
        return [tuple(tuple(most * next(rest) for most in full) for full in fields) for fields in self._holds]
