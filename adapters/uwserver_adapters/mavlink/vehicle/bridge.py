"""What the parts of the vehicle share: the way to ground stations, and what is known of the world."""

from __future__ import annotations

from collections import Counter
from typing import Protocol

from uwserver.adapter import AdapterContext
from uwserver_adapters.mavlink.vehicle.autopilot import Autopilot, Done
from uwserver_adapters.mavlink.vehicle.home import Home
from uwserver_adapters.mavlink.vehicle.modes import Mode
from uwserver_adapters.mavlink.vehicle.readings import Readings
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.codec import microseconds
from uwserver_adapters.mavlink.wire.dialect import Dialect, Fields

CRITICAL, ERROR, WARNING = "MAV_SEVERITY_CRITICAL", "MAV_SEVERITY_ERROR", "MAV_SEVERITY_WARNING"
NOTICE, INFO = "MAV_SEVERITY_NOTICE", "MAV_SEVERITY_INFO"
_TEXT = 50
"""Characters of one STATUSTEXT. A longer text is sent in pieces."""
_LONGEST_TEXT = 4 * _TEXT


class Send(Protocol):
    """Sends a message to one channel, or to all."""

    def __call__(self, name: str, fields: Fields, channel: Channel | None = None) -> None: ...


class Bridge:
    """Connects ground stations and the world. Runs on the loop thread.

    Args:
        context: the world.
        vehicle: name of the vehicle in the world.
        home: its place on the Earth.
        dialect: the messages.
        send: sends messages.

    Attributes:
        dialect, home, send: as given.
        autopilot: the vehicle's autopilot.
        readings: what its instruments and its autopilot have said.
        counters: counts what was received and not used, by reason: refused, not_in_charge ...
    """

    def __init__(self, context: AdapterContext, vehicle: str, home: Home, dialect: Dialect, send: Send) -> None:
        self.dialect = dialect
        self.home = home
        self.send = send
        self.autopilot = Autopilot(context, vehicle)
        self.readings = Readings(context, vehicle)
        self.counters: Counter[str] = Counter()
        self._text_id = 0

    def tell(self, severity: str, text: str) -> None:
        """Send a text to all as STATUSTEXT."""
        data = text.encode("ascii", "replace")[:_LONGEST_TEXT]
        pieces = [data[k : k + _TEXT] for k in range(0, len(data), _TEXT)] or [b""]
        if len(pieces) > 1:
            self._text_id = self._text_id % 0xFFFF + 1
        for number, piece in enumerate(pieces):
            id = self._text_id if len(pieces) > 1 else 0
            self.send("STATUSTEXT", {"severity": severity, "text": piece, "id": id, "chunk_seq": number})
        if len(pieces) > 1 and len(pieces[-1]) == _TEXT:  # only a piece that is not full ends the text
            self.send("STATUSTEXT", {"severity": severity, "text": b"", "id": self._text_id, "chunk_seq": len(pieces)})

    def failure_teller(self, prefix: str = "", severity: str = WARNING) -> Done:
        """Return a callback that tells all why something has failed, and nothing if it has succeeded."""

        def tell(reason: str) -> None:
            if reason:
                self.tell(severity, f"{prefix}{reason}")

        return tell

    def home_position(self) -> Fields | None:
        """Return the fields of HOME_POSITION; None while home is not known."""
        return self.home.home_position(microseconds(self.readings.t_ns))

    def tell_home(self) -> None:
        """Send HOME_POSITION to all, if home is known."""
        if (fields := self.home_position()) is not None:
            self.send("HOME_POSITION", fields)

    def set_mode(self, mode: Mode, done: Done) -> None:
        """Change the autopilot's mode."""
        self.switch("set_mode", {"mode": mode.autopilot}, done, mode=mode.autopilot)

    def switch(self, service: str, args: dict[str, object], done: Done, **change: str | bool) -> None:
        """Call a service that changes the mode or arms, and assume the change as soon as it is carried out.

        Args:
            service: name of the autopilot's service.
            args: its arguments.
            done: gets the outcome.
            change: see `Readings.assume`.
        """

        def on_done(reason: str) -> None:
            if not reason:
                self.readings.assume(self.autopilot.replied_ns, **change)
            done(reason)

        self.autopilot.call(service, args, on_done)
