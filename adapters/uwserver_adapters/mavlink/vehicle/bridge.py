"""What the parts of the vehicle share, and what stands below all of them: the way to ground stations, and what is known of the world."""

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
"""Characters of one STATUSTEXT; a longer text comes in pieces."""
_LONGEST_TEXT = 4 * _TEXT


class Send(Protocol):
    """Sends a message to one channel, or to all."""

    def __call__(self, name: str, fields: Fields, channel: Channel | None = None) -> None: ...


class Bridge:
    """Between ground stations and the world. Loop thread.

    Args:
        context: the world.
        vehicle: name of the vehicle in the world.
        home: where it is on the Earth.
        dialect: the messages.
        send: where messages go.

    Attributes:
        dialect, home, send: as given.
        autopilot: of the vehicle.
        readings: of its instruments and its autopilot.
        counters: what came and was not taken: refused, stale_time ...
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
        """STATUSTEXT to all."""
        data = text.encode("ascii", "replace")[:_LONGEST_TEXT]
        pieces = [data[k : k + _TEXT] for k in range(0, len(data), _TEXT)] or [b""]
        if len(pieces) > 1:
            self._text_id = self._text_id % 0xFFFF + 1
        for number, piece in enumerate(pieces):
            id = self._text_id if len(pieces) > 1 else 0
            self.send("STATUSTEXT", {"severity": severity, "text": piece, "id": id, "chunk_seq": number})
        if len(pieces) > 1 and len(pieces[-1]) == _TEXT:  # a piece that is not full ends the text
            self.send("STATUSTEXT", {"severity": severity, "text": b"", "id": self._text_id, "chunk_seq": len(pieces)})

    def home_position(self) -> Fields | None:
        """Fields of HOME_POSITION; None while home is not known."""
        return self.home.home_position(microseconds(self.readings.t_ns))

    def tell_home(self) -> None:
        """HOME_POSITION to all, if it is known."""
        if (fields := self.home_position()) is not None:
            self.send("HOME_POSITION", fields)

    def set_mode(self, mode: Mode, done: Done) -> None:
        """Change the mode."""
        self.switch("set_mode", {"mode": mode.autopilot}, done, mode=mode.autopilot)

    def switch(self, service: str, args: dict[str, object], done: Done, **change: str | bool) -> None:
        """Call a service that changes mode or arming, and believe in the change as soon as it is carried out.

        Args:
            service: of the autopilot.
            args: its arguments.
            done: gets the outcome.
            change: see `Readings.assume`.
        """

        def told(reason: str) -> None:
            if not reason:
                self.readings.assume(self.autopilot.replied_ns, **change)
            done(reason)

        self.autopilot.call(service, args, told)
