"""What all parts of the vehicle share: the way to ground stations and to the autopilot, the readings, the origin of N and home."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Protocol

from msgspec import Struct

from uwserver.adapter import AdapterContext, Conversation
from uwserver.frames import Vec3
from uwserver.ports import Json, Refused, Reply
from uwserver_adapters.mavlink.vehicle.modes import Mode, in_words_of_mavlink
from uwserver_adapters.mavlink.vehicle.readings import Readings
from uwserver_adapters.mavlink.wire.channel import Channel
from uwserver_adapters.mavlink.wire.codec import Datum, datum, degrees_e7, from_degrees_e7, microseconds
from uwserver_adapters.mavlink.wire.dialect import Dialect, Fields

SOURCE = "ground station"
"""All ground stations are one source of commands: they take turns by MAVLink's own rules."""
CRITICAL, ERROR, WARNING = "MAV_SEVERITY_CRITICAL", "MAV_SEVERITY_ERROR", "MAV_SEVERITY_WARNING"
NOTICE, INFO = "MAV_SEVERITY_NOTICE", "MAV_SEVERITY_INFO"
_TEXT = 50
"""Characters of one STATUSTEXT. A longer text is sent in pieces."""
_LONGEST_TEXT = 4 * _TEXT


class Place(Struct, frozen=True):
    """Latitude and longitude (rad), and altitude above the sea (m)."""

    latitude: float
    longitude: float
    altitude: float = 0.0


class Home:
    """Origin of N and home. Both are unknown until the scenario or a ground station sets them.

    Args:
        origin_deg: latitude and longitude of N's origin.

    Raises:
        ValueError: there is no such place.

    Attributes:
        origin: origin of N, at sea level.
        home: what relative altitudes refer to; the sea above the origin unless set.
    """

    def __init__(self, origin_deg: tuple[float, float] | None) -> None:
        self.origin: Datum | None = None if origin_deg is None else datum(*origin_deg)
        self.home: Place | None = None
        if origin_deg is not None and self.origin is None:
            raise ValueError(f"origin_deg = {list(origin_deg)}: write latitude, longitude, in degrees")
        self._home_at_origin()

    def _home_at_origin(self) -> None:
        if self.origin is not None and self.home is None:
            self.home = Place(self.origin.latitude, self.origin.longitude)

    def set_origin(self, latitude_e7: float, longitude_e7: float) -> bool:
        """Set the origin, in 1e-7 degrees. Returns False when it is already known, or there is no such place."""
        if self.origin is not None:
            return False
        self.origin = datum(latitude_e7 / 1e7, longitude_e7 / 1e7)
        self._home_at_origin()
        return self.origin is not None

    def place(self, p_N: Vec3) -> Place | None:
        """Return the place of a point of N."""
        if self.origin is None:
            return None
        latitude, longitude = self.origin.geodetic(p_N[0], p_N[1])
        return Place(latitude, longitude, -p_N[2])

    def point(self, latitude_e7: float, longitude_e7: float, altitude: float, is_relative: bool) -> Vec3 | None:
        """Return the point of N at a place.

        Args:
            latitude_e7, longitude_e7: 1e-7 degrees.
            altitude: m, above the sea or above home.
            is_relative: whether the altitude is above home.

        Returns:
            None without an origin, or where there is no such place.
        """
        there = datum(latitude_e7 / 1e7, longitude_e7 / 1e7)
        if self.origin is None or there is None:
            return None
        north, east = self.origin.north_east(there.latitude, there.longitude)
        return (north, east, -self.sea_altitude(altitude, is_relative))

    def sea_altitude(self, altitude: float, is_relative: bool) -> float:
        """Return the altitude above the sea (m) of an altitude above the sea or above home."""
        return altitude + (self.home.altitude if is_relative and self.home is not None else 0.0)

    def home_position(self, time_usec: int) -> Fields | None:
        """Return the fields of HOME_POSITION."""
        if self.home is None or self.origin is None:
            return None
        north, east = self.origin.north_east(self.home.latitude, self.home.longitude)
        return {
            "latitude": degrees_e7(self.home.latitude),
            "longitude": degrees_e7(self.home.longitude),
            "altitude": self.home.altitude * 1e3,
            "x": north,
            "y": east,
            "z": -self.home.altitude,
            "q": (1.0, 0.0, 0.0, 0.0),
            "time_usec": time_usec,
        }

    def global_origin(self, time_usec: int) -> Fields | None:
        """Return the fields of GPS_GLOBAL_ORIGIN."""
        if self.origin is None:
            return None
        return {
            "latitude": degrees_e7(self.origin.latitude),
            "longitude": degrees_e7(self.origin.longitude),
            "time_usec": time_usec,
        }


def place_of_e7(latitude_e7: float, longitude_e7: float, altitude: float) -> Place | None:
    """Return a place given in 1e-7 degrees and m, or None where there is no such place."""
    if datum(latitude_e7 / 1e7, longitude_e7 / 1e7) is None:
        return None
    return Place(from_degrees_e7(latitude_e7), from_degrees_e7(longitude_e7), altitude)


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
