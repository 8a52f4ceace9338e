"""The port of a modem that takes messages, and the calls that wait for the distance of another modem."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.ports import Buffer, ErrorCode, Fault, Field, Items, Json
from uwserver.ports.crossing import Answers, Later
from uwserver.sensors.modem import MOST_QUEUE, Modem, ModemReport, ModemTable

Submit = Callable[[int, bytes, bool], None]
"""Sends a message: address, payload, and whether an answer is wanted."""


class Send:
    """Takes messages. Every message counts: several in one tick are sent one after the other.

    Attributes:
        takes_each: no command replaces another.
        modem: sends the messages.
    """

    doc = (
        "Messages for a modem to send. While it sends, a few messages may wait; a further one is refused as busy. A message to an address without "
        "a modem is sent like any other; if an answer was requested, its absence is reported."
    )
    takes_each = True

    def __init__(self, modem: Modem, submit: Submit, now: Callable[[], float]) -> None:
        """Take the modem.

        Args:
            modem: sends the messages.
            submit: sends one message.
            now: gives the simulation time, s.
        """
        self.modem, self._submit, self._now = modem, submit, now
        table = modem.table
        everyone = f"{table.broadcast_address} for all"
        highest = float(max(table.highest_address, table.broadcast_address))
        self.fields = (
            Field("destination", "1", f"address; default: {everyone}", minimum=0.0, maximum=highest),
            Field("data", "1", "payload; default: empty", type="bytes", max_bytes=table.max_bytes),
            Field("acknowledge", "1", "1: request an answer, which gives the range of the receiver; default: 0", minimum=0.0, maximum=1.0),
        )  # fmt: skip

    def objection(self, value: Items) -> Fault | None:
        """Return why a message is refused now, as a text for the sender. The code "busy" means that it may be sent later."""
        destination, data, wanted = self._message(value)
        table = self.modem.table
        if destination is None:
            return Fault("bad_argument", "needs a whole number as destination")
        if destination != table.broadcast_address and (not table.addressed or destination > table.highest_address):
            return Fault("bad_argument", _nobody(table, destination))
        if wanted and not table.acknowledges:
            return Fault("bad_argument", "is a model that never answers: leave acknowledge out")
        if wanted and destination == table.broadcast_address:
            text = "cannot request an answer from all, as the answers would collide: ask one address"
            return Fault("bad_argument", text)
        if not data and not wanted:
            return Fault("bad_argument", "needs data, or acknowledge = 1 to ask for a range alone")
        return self._why_busy(wanted)

    def objection_to_range(self, destination: int) -> Fault | None:
        """Return why the modem does not ask an address for its distance now."""
        memory = self.modem.memory
        if destination == self.modem.settings.address:
            return Fault("bad_argument", f"has address {destination} itself: ask another one")
        if any(each.ranging for each in (*memory.queue, *(asked.message for asked in memory.waiting))):
            return Fault("busy", "is busy: it waits for another range: try again later, or call cancel_range")
        return self.objection(((float(destination),), None, (1.0,)))

    def _why_busy(self, wanted: bool) -> Fault | None:
        table, memory = self.modem.table, self.modem.memory
        waits = len([each for each in memory.queue if not each.answer])
        if memory.busy > self._now() and waits >= table.queue:
            text = f"is busy: it sends until {memory.busy:.3f} s, and {waits} messages wait already: try again later"
            return Fault("busy", text)
        if waits > table.queue:
            return Fault("busy", f"is busy: {waits} messages wait already: try again later")
        if wanted and len(memory.waiting) + waits >= MOST_QUEUE:
            return Fault("busy", f"is busy: {MOST_QUEUE} messages wait for their answers: try again later")
        return None

    def apply(self, value: Items) -> None:
        """Send a message, or queue it."""
        destination, data, wanted = self._message(value)
        if destination is not None:
            self._submit(destination, data, wanted)

    def neutral(self) -> None:
        """Do nothing: a message that was sent cannot be taken back."""

    def _message(self, value: Items) -> tuple[int | None, bytes, bool]:
        """Return the destination (None if it is no whole number), the payload, and whether an answer is wanted."""
        to, data, wanted = value
        number = float(to[0]) if isinstance(to, tuple) else float(self.modem.table.broadcast_address)
        payload = data.data if isinstance(data, Buffer) else b""
        return int(number) if number.is_integer() else None, payload, isinstance(wanted, tuple) and wanted[0] >= 0.5


def _nobody(table: ModemTable, destination: int) -> str:
    if not table.addressed:
        return "is a model without addresses, which sends to all: leave destination out"
    return f"has addresses up to {table.highest_address}, and {table.broadcast_address} for all: no modem can have the address {destination}"


class Ranging:
    """Answers a call when the answer of the other modem has come, or can no longer come."""

    def __init__(self, answers: Answers, now: Callable[[], tuple[int, int]]) -> None:
        """Begin without calls.

        Args:
            answers: takes the replies.
            now: gives the tick and the simulation time (ns).
        """
        self._answers, self._now = answers, now
        self._asked: dict[int, tuple[str, Later]] = {}

    def wait(self, message: int, path: str) -> Later:
        """Return a call that waits for the answer to a message of the modem with this port."""
        later = Later(self._answers)
        self._asked[message] = path, later
        return later

    def answered(self, message: int, told: ModemReport, travel: float) -> None:
        """Answer the call that waits for a message; do nothing if no call does.

        Args:
            message: id of the message.
            told: what the modem reports about the answer.
            travel: travel time there and back, s.
        """
        result: Json = {
            "destination": told.destination,
            "range": told.range,
            "travel_time": travel,
            "snr": told.snr,
            "bearing": told.bearing,
            "elevation": told.elevation,
            "relative_speed": told.speed,
            "t_s": told.begin,
        }
        self._finish(message, result, None)

    def lost(self, message: int, text: str) -> None:
        """End the call that waits for a message, as no answer came in time."""
        self._finish(message, None, ("timeout", text))

    def end(self, why: str, path: str | None = None) -> None:
        """End all calls that wait for messages of the modem with this port, or of any modem."""
        for message in [message for message, (of, _) in self._asked.items() if path in (None, of)]:
            self._finish(message, None, ("preempted", why))

    def _finish(self, message: int, result: Json, fault: tuple[ErrorCode, str] | None) -> None:
        path, later = self._asked.pop(message, ("", None))
        if later is not None:
            where = path.removesuffix("received") + "range"
            later.finish(*self._now(), result, None if fault is None else Fault(*fault, where))
