"""The built-in autopilot of one vehicle, reached by the names of its ports and services."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uwserver.adapter import AdapterContext, Conversation
from uwserver.ports import Json, Refused, Reply
from uwserver_adapters.mavlink.vehicle.wording import in_words_of_mavlink

SOURCE = "ground station"
"""All ground stations are one source of commands: they take turns by MAVLink's own rules."""

Done = Callable[[str], None]
"""Takes the outcome once: "" for success, else the reason of the failure."""


def command(peer: Conversation, port: str, value: Mapping[str, object], done: Done) -> None:
    """Command an actuator. `done` gets the outcome, at once if the command is refused."""
    try:
        peer.command(port, value, lambda reply: done(_reason(reply)))
    except Refused as refused:
        done(refused.fault.text)


class Autopilot:
    """Commands and calls the autopilot. Runs on the loop thread.

    Args:
        context: the world.
        vehicle: name of the vehicle.

    Attributes:
        asker: number of the channel that asks, each of which has a queue of its own; 0 for the adapter itself.
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
        """Whether the vehicle has an autopilot."""
        return f"{self._root}/pilot" in self._context.ports

    @property
    def absence(self) -> str:
        """What to do when there is no autopilot."""
        return f"no autopilot: add [vehicles.{self._vehicle}.autopilot] to the scenario"

    @property
    def _peer(self) -> Conversation:
        peer = self._askers.get(self.asker)
        if peer is None:
            # A station that floods fills only its own queue.
            peer = self._askers[self.asker] = Conversation(self._context, SOURCE, queue=str(self.asker))
        return peer

    def forget(self, asker: int) -> None:
        """Forget a channel that has been closed. What it has asked for is still carried out."""
        self._askers.pop(asker, None)

    def command(self, port: str, value: Mapping[str, object], done: Done | None = None) -> None:
        """Send a set point to one of the autopilot's ports, such as `depth`."""
        if self.is_there:
            command(self._peer, f"{self._root}/{port}", value, lambda reason: self._finish(reason, done))
        else:
            self._finish(self.absence, done)

    def call(self, service: str, args: Mapping[str, object], done: Done, result: Callable[[Json], None] | None = None) -> None:  # fmt: skip
        """Call one of the autopilot's services, such as `arm`.

        Args:
            service: name of the service.
            args: its arguments.
            done: gets the outcome.
            result: gets the result, before `done`.
        """
        if not self.is_there:
            self._finish(self.absence, done)
            return

        def on_answer(reply: Reply) -> None:
            self.replied_ns = reply.t_ns
            if reply.fault is None and result is not None:
                result(reply.result)
            self._finish(_reason(reply), done)

        try:
            self._peer.call(f"{self._root}/{service}", args, on_answer)
        except Refused as refused:
            self._finish(refused.fault.text, done)

    def _finish(self, reason: str, done: Done | None) -> None:
        reason = in_words_of_mavlink(reason)
        if reason:
            self._context.stats.count_error(reason)
        if done is not None:
            done(reason)


def _reason(reply: Reply) -> str:
    return reply.fault.text if reply.fault is not None else ""
