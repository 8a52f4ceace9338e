"""The port of a modem that takes messages."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.ports import Buffer, Fault, Field, Items
from uwserver.sensors.messages import MOST_QUEUE
from uwserver.sensors.modem import Modem, ModemTable

Submit = Callable[[int, bytes, bool], None]
"""Has a message sent: to an address, its payload, and whether it asks for an answer."""


class Send:
    """Takes messages, of which each counts: several in one tick are sent one after the other.

    Attributes:
        takes_each: no command replaces another.
        modem: that sends.
    """

    doc = (
        "Messages that a modem is to send. While it sends, a few wait; then it is busy and says so. A message to an address that nobody has is "
        "sent like any other: what becomes of it is told where an answer was asked for."
    )
    takes_each = True

    def __init__(self, modem: Modem, submit: Submit, now: Callable[[], float]) -> None:
        """Of a modem.

        Args:
            modem: that sends.
            submit: has a message sent.
            now: simulation time, s.
        """
        self.modem, self._submit, self._now = modem, submit, now
        table = modem.table
        everyone = f"{table.broadcast_address} for all"
        highest = float(max(table.highest_address, table.broadcast_address))
        self.fields = (
            Field("destination", "1", f"address; {everyone}, as where it is left out", minimum=0.0, maximum=highest),
            Field("data", "1", "payload; left out: none", type="bytes", max_bytes=table.max_bytes),
            Field("acknowledge", "1", "1: the receiver is to answer, which tells its range; default: 0", minimum=0.0, maximum=1.0),
        )  # fmt: skip

    def objection(self, value: Items) -> Fault | None:
        """Why it takes no such message now, for the sender: "busy" is the code of what may be sent later."""
        destination, data, wanted = self._message(value)
        table = self.modem.table
        if destination is None:
            return Fault("bad_argument", "needs a whole number as destination")
        if destination != table.broadcast_address and (not table.addressed or destination > table.highest_address):
            return Fault("bad_argument", _nobody(table, destination))
        if wanted and not table.acknowledges:
            return Fault("bad_argument", "is of a make that answers nothing: leave acknowledge out")
        if wanted and destination == table.broadcast_address:
            text = "cannot ask all for an answer, as they would answer at once: ask one address"
            return Fault("bad_argument", text)
        if not data and not wanted:
            return Fault("bad_argument", "needs data, or acknowledge = 1 to ask for a range alone")
        return self._why_busy(wanted)

    def objection_to_range(self, destination: int) -> Fault | None:
        """Why it does not ask an address for its distance now."""
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
        """Send a message, or let it wait."""
        destination, data, wanted = self._message(value)
        if destination is not None:
            self._submit(destination, data, wanted)

    def neutral(self) -> None:
        """Nothing to undo: what was sent was sent."""

    def _message(self, value: Items) -> tuple[int | None, bytes, bool]:
        """Destination (None: no whole number), payload, and whether it asks for an answer."""
        to, data, wanted = value
        number = float(to[0]) if isinstance(to, tuple) else float(self.modem.table.broadcast_address)
        payload = data.data if isinstance(data, Buffer) else b""
        return int(number) if number.is_integer() else None, payload, isinstance(wanted, tuple) and wanted[0] >= 0.5


def _nobody(table: ModemTable, destination: int) -> str:
    if not table.addressed:
        return "is of a make without addresses, and sends to all: leave destination out"
    return f"has addresses up to {table.highest_address}, and {table.broadcast_address} for all: nobody can be at {destination}"
