"""What ends a run whose numbers have left all bounds."""

from __future__ import annotations

from uwserver.ports.crossing import TickOutput
from uwserver.units import NANOSECONDS
from uwserver.world.commands import Commands
from uwserver.world.vehicle import Vehicle


class Diverged(Exception):
    """A body's state is not finite, or absurdly fast. The text names body, tick and the last commands.

    Attributes:
        output: replies to what was carried out at the start of the tick, and samples of ticks before it that were made in one go with it.
    """

    def __init__(self, text: str, output: TickOutput) -> None:
        super().__init__(text)
        self.output = output


def report(tick: int, t_ns: int, vehicle: Vehicle | None, commands: Commands) -> str:
    """The text of it; no vehicle where the body has been taken out."""
    if vehicle is None:
        return f"a body that is no longer there diverged in tick {tick}"
    t = t_ns / NANOSECONDS
    line = f'body "{vehicle.name}" diverged in tick {tick} (t = {t:.6f} s): p_NB = {vehicle.p_NB}, nu = {vehicle.nu}'
    return "\n".join([line, *commands.newest(vehicle.name)])
