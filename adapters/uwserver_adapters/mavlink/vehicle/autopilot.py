"""The built-in autopilot of one vehicle, as the world shows it: its ports and services by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Json, Refused, Reply
from uwserver_adapters.mavlink.vehicle.wording import in_words_of_mavlink

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
        asker: number of the channel for which it is asked, which has a queue of its own; 0 for the adapter itself.
        replied_ns: simulation time at which the last call was carried out.
    """

    def __init__(self, context: AdapterContext, vehicle: str) -> None:
        self._context = context
        self._askers: dict[int, Conversation] = {}
        self._vehicle = vehicle
        self._root = f"{vehicle}/autopilot"
        self.asker = 0
        self.replied_ns = 0

    @property
    def is_there(self) -> bool:
        """Whether the vehicle has one."""
        return f"{self._root}/pilot" in self._context.ports

    @property
    def absence(self) -> str:
        """What to do when there is none."""
        return f"no autopilot: add [vehicles.{self._vehicle}.autopilot] to the scenario"

    @property
    def _peer(self) -> Conversation:
        peer = self._askers.get(self.asker)
        if peer is None:
            # Who floods keeps itself waiting, and no other station.
            peer = self._askers[self.asker] = Conversation(self._context, SOURCE, queue=str(self.asker))
        return peer

    def forget(self, asker: int) -> None:
        """A channel is gone; what was asked for it is carried out."""
        self._askers.pop(asker, None)

    def command(self, port: str, value: Mapping[str, object], done: Done | None = None) -> None:
        """Post a set point to one of its ports, as `depth`."""
        if not self.is_there:
            self._told(self.absence, done)
            return
        try:
            self._peer.command(f"{self._root}/{port}", value, lambda reply: self._told(_reason(reply), done))
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

        def on_answer(reply: Reply) -> None:
            self.replied_ns = reply.t_ns
            if reply.fault is None and result is not None:
                result(reply.result)
            self._told(_reason(reply), done)

        try:
            self._peer.call(f"{self._root}/{service}", args, on_answer)
        except Refused as refused:
            self._told(refused.fault.text, done)

    def _told(self, reason: str, done: Done | None) -> None:
        reason = in_words_of_mavlink(reason)
        stats = self._context.stats
        if reason:
            stats.errors += 1
            stats.last_error = reason
        if done is not None:
            done(reason)


def _reason(reply: Reply) -> str:
    return reply.fault.text if reply.fault is not None else ""
