"""The port of a modem that takes messages."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.ports import Buffer, Field, Items
from uwserver.sensors.modem import Modem

Submit = Callable[[int, bytes, bool], None]
"""Has a message sent: to an address, its payload, and whether it asks for an answer."""


class Send:
    """Takes messages, of which each counts: several in one tick are sent one after the other.

    Attributes:
        takes_each: no command replaces another.
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
        self._modem, self._submit, self._now = modem, submit, now
        table = modem.table
        everyone = f"{table.broadcast_address} for all"
        highest = float(max(table.highest_address, table.broadcast_address))
        self.fields = (
            Field("destination", "1", f"address; {everyone}, as where it is left out", minimum=0.0, maximum=highest),
            Field("data", "1", "payload; left out: none", type="bytes", max_bytes=table.max_bytes),
            Field("acknowledge", "1", "1: the receiver is to answer, which tells its range; default: 0", minimum=0.0, maximum=1.0),
        )  # fmt: skip

    def objection(self, value: Items) -> str:
        """Why it takes no such message now, for the sender."""
        destination, data, wanted = self._message(value)
        table, memory = self._modem.table, self._modem.memory
        if destination is None:
            return "needs a whole number as destination"
        if table.broadcast_address != destination > table.highest_address:
            return f"has addresses up to {table.highest_address}, and {table.broadcast_address} for all: nobody can be at {destination}"
        if wanted and not table.acknowledges:
            return "is of a make that answers nothing: leave acknowledge out"
        if wanted and destination == table.broadcast_address:
            return "cannot ask all for an answer, as they would answer at once: ask one address"
        if not data and not wanted:
            return "needs data, or acknowledge = 1 to ask for a range alone"
        waits = len([each for each in memory.queue if not each.answer])
        if memory.busy > self._now() and waits >= table.queue:
            return f"is busy: it sends until {memory.busy:.3f} s, and {waits} messages wait already: try again later"
        if waits > table.queue:
            return f"is busy: {waits} messages wait already: try again later"
        return ""

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
        number = float(to[0]) if isinstance(to, tuple) else float(self._modem.table.broadcast_address)
        payload = data.data if isinstance(data, Buffer) else b""
        return int(number) if number.is_integer() else None, payload, isinstance(wanted, tuple) and wanted[0] >= 0.5
