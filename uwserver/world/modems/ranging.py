"""Calls that wait for the distance of another modem. The state of the modem has the messages; the calls, which no state keeps, are here."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.ports import ErrorCode, Fault, Json
from uwserver.ports.crossing import Answers, Later
from uwserver.sensors.modem_memory import ModemReport


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
