"""The built-in autopilot of one vehicle, as the world shows it: its ports and services by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uwserver.adapter import AdapterContext
from uwserver.ports import Json, Progress, Refused, Reply

SOURCE = "ground station"
"""One commander for all ground stations: they take turns by MAVLink's own rules."""

Done = Callable[[str], None]
"""Gets the one outcome: "" when it is done, else why not."""


class Autopilot:
    """Commands and calls. Loop thread.

    Args:
        context: the world.
        vehicle: name of the vehicle.

    Attributes:
        replied_ns: simulation time at which the last call was carried out.
    """

    def __init__(self, context: AdapterContext, vehicle: str) -> None:
        self._context = context
        self._vehicle = vehicle
        self._root = f"{vehicle}/autopilot"
        self.replied_ns = 0

    @property
    def is_there(self) -> bool:
        """Whether the vehicle has one."""
        return f"{self._root}/pilot" in self._context.ports

    @property
    def absence(self) -> str:
        """What to do when there is none."""
        return f"no autopilot: add [vehicles.{self._vehicle}.autopilot] to the scenario"

    def command(self, port: str, value: Mapping[str, object], done: Done | None = None) -> None:
        """Post a set point to one of its ports, as `depth`."""
        if not self.is_there:
            self._told(self.absence, done)
            return

        def on_reply(outcome: Reply | Progress) -> None:
            if isinstance(outcome, Reply):
                self._told(outcome.fault.text if outcome.fault is not None else "", done)

        self._context.stats.commands += 1
        try:
            self._context.command(f"{self._root}/{port}", value, SOURCE, on_reply)
        except Refused as refused:
            self._told(refused.fault.text, done)

    def call(self, service: str, args: Mapping[str, object], done: Done, result: Callable[[Json], None] | None = None) -> None:  # fmt: skip
        """Call one of its services, as `arm`.

        Args:
            service: its name.
            args: its arguments.
            done: gets the outcome.
            result: gets what it gave, before `done`.
        """
        if not self.is_there:
            self._told(self.absence, done)
            return

        def on_reply(outcome: Reply | Progress) -> None:
            if isinstance(outcome, Reply):
                self.replied_ns = outcome.t_ns
                if outcome.fault is None and result is not None:
                    result(outcome.result)
                self._told(outcome.fault.text if outcome.fault is not None else "", done)

        self._context.stats.calls += 1
        try:
            self._context.call(f"{self._root}/{service}", args, SOURCE, on_reply)
        except Refused as refused:
            self._told(refused.fault.text, done)

    def _told(self, reason: str, done: Done | None) -> None:
        stats = self._context.stats
        if reason:
            stats.errors += 1
            stats.last_error = reason
        if done is not None:
            done(reason)
