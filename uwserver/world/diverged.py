"""The error that ends a run whose numbers have left all bounds."""

from __future__ import annotations

from uwserver.ports.crossing import TickOutput
from uwserver.units import NANOSECONDS
from uwserver.world.commands import Commands
from uwserver.world.vehicle import Vehicle


class Diverged(Exception):
    """The state of a body is not finite, or absurdly fast. The text names the body, the tick and the last commands.

    Attributes:
        output: replies to the requests that were carried out at the start of the tick, and samples of earlier ticks that were made in the
            same call.
    """

    def __init__(self, text: str, output: TickOutput) -> None:
        super().__init__(text)
        self.output = output


def report(tick: int, t_ns: int, vehicle: Vehicle | None, commands: Commands) -> str:
    """Return the text of the error. `vehicle` is None if the body has been taken out of the world."""
    if vehicle is None:
        return f"a body that is no longer there diverged in tick {tick}"
    t = t_ns / NANOSECONDS
    line = f'body "{vehicle.name}" diverged in tick {tick} (t = {t:.6f} s): p_NB = {vehicle.p_NB}, nu = {vehicle.nu}'
    return "\n".join([line, *commands.newest(vehicle.name)])
