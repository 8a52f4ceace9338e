"""Who waits for the distance of another modem. What is sent for it is in the state of the modem; the callers, who are not, are here."""

from __future__ import annotations

from collections.abc import Callable

from uwserver.ports import ErrorCode, Fault, Json
from uwserver.ports.crossing import Answers, Later
from uwserver.sensors.messages import Message


class Ranging:
    """Calls that are answered when the answer of another modem has come, or can come no more."""

    def __init__(self, answers: Answers, now: Callable[[], tuple[int, int]]) -> None:
        """Of a world.

        Args:
            answers: where replies go.
            now: tick and simulation time (ns).
        """
        self._answers, self._now = answers, now
        self._asked: dict[int, tuple[str, Later]] = {}

    def wait(self, message: int, path: str) -> Later:
        """For the answer to a message that the modem with this port sends."""
        later = Later(self._answers)
        self._asked[message] = path, later
        return later

    def answered(self, message: int, told: Message, travel: float) -> None:
        """An answer has come.

        Args:
            message: that it answers; of one that nobody waits for nothing happens.
            told: what the modem tells of it.
            travel: there and back, s.
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
        """No answer came in time."""
        self._finish(message, None, ("timeout", text))

    def end(self, why: str, path: str | None = None) -> None:
        """Nobody waits any more for what the modem with this port, or any, has sent."""
        for message in [message for message, (of, _) in self._asked.items() if path in (None, of)]:
            self._finish(message, None, ("preempted", why))

    def _finish(self, message: int, result: Json, fault: tuple[ErrorCode, str] | None) -> None:
        path, later = self._asked.pop(message, ("", None))
        if later is not None:
            where = path.removesuffix("received") + "range"
            later.finish(*self._now(), result, None if fault is None else Fault(*fault, where))
