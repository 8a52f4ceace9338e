"""Messages for people who watch a mission: a warning when the world is too slow for the warp, and an appcast for uMAC and pMarineViewer."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping

from uwserver_adapters.moos.codec import Pairs, finite, seconds

log = logging.getLogger(__name__)

RTF = "UWSERVER_RTF"
WARNING = "UWSERVER_WARNING"
APPCAST = "APPCAST"
APPCAST_REQUEST = "APPCAST_REQ"
NAME = "uwserver"
"""Name of the program in appcasts."""

KEPT = 0.95
"""Share of the wanted speed below which the world is too slow."""
SLOW_ROUNDS = 3
"""Rounds of a second in which the world is too slow before that is told."""
TELL_S = 60.0
"""Wall time between two such lines in the log."""
LONGEST_REQUEST_S = 30.0
"""Longest wall time for which one request asks for appcasts."""
KEYS = 16
"""Most programs that may ask for appcasts at the same time."""
_TEXT_LIMIT = 512


class Pace:
    """Compares simulated with wall time, once a second.

    Attributes:
        warning: text while the world is too slow; "" while it keeps its speed.
        factor: simulated seconds in a second of wall time, in the last round; NaN before the second round.
        rounds: rounds in which it was too slow, since the start.
    """

    def __init__(self) -> None:
        self.warning = ""
        self.factor = math.nan
        self.rounds = 0
        self._last: tuple[float, float, bool] | None = None
        self._slow = 0
        self._told_at = -math.inf

    def observe(self, status: Mapping[str, object], wall_s: float, name: str) -> Pairs:
        """Compare the times since the last round.

        Args:
            status: the answer of ``world/status``.
            wall_s: wall time, by a steady clock.
            name: of the adapter, for the log.

        Returns:
            Variables to publish.
        """
        t_ns, speed = status.get("t_ns"), status.get("speed")
        if not isinstance(t_ns, int) or not isinstance(speed, int | float):
            return []
        t_s, is_paused = seconds(t_ns), bool(status.get("paused"))
        last, self._last = self._last, (t_s, wall_s, is_paused)
        if last is None or wall_s <= last[1] or t_s < last[0]:  # the first round, or the world was set back
            return []
        self.factor = (t_s - last[0]) / (wall_s - last[1])
        pairs: Pairs = [(RTF, self.factor)]
        is_slow = status.get("mode") == "realtime" and not is_paused and not last[2] and self.factor < KEPT * speed
        self._slow = self._slow + 1 if is_slow else 0
        self.rounds += is_slow
        was = self.warning
        if self._slow >= SLOW_ROUNDS:
            self.warning = (
                f"the world runs at {self.factor:.3g} of the wanted {speed:g}: lower [world.clock] speed and MOOSTimeWarp alike, "
                "or give the machine less to do"
            )
            if wall_s - self._told_at >= TELL_S:
                self._told_at = wall_s
                log.warning("%s: %s", name, self.warning)
        elif not is_slow:
            self.warning = ""
        if bool(was) != bool(self.warning):
            pairs.append((WARNING, self.warning))
        return pairs


class AppCasts:
    """Makes appcasts while some program asks for them.

    Attributes:
        node: name of the community.
    """

    def __init__(self) -> None:
        self.node = ""
        self._until: dict[str, float] = {}
        self._round = 0

    def ask(self, text: str, wall_s: float) -> None:
        """Take a request: ``node=,app=,duration=,key=,thresh=``. One for other programs, or without a key, is passed over, as MOOS programs do."""
        given = dict(part.split("=", 1) for part in text[:_TEXT_LIMIT].split(",") if "=" in part)
        said = {key.strip().lower(): value.strip() for key, value in given.items()}
        if said.get("node", "all") not in (self.node, "all") or said.get("app", "all") not in (NAME, "all"):
            return
        key = said.get("key", "")
        try:
            duration = finite(said.get("duration", ""))
        except ValueError:
            return
        if key and (key in self._until or len(self._until) < KEYS):
            self._until[key] = wall_s + min(max(duration, 0.0), LONGEST_REQUEST_S)

    def due(self, wall_s: float) -> bool:
        """Return whether a program still wants appcasts; to be called once a second."""
        self._round += 1
        self._until = {key: until for key, until in self._until.items() if wall_s <= until}
        return bool(self._until)

    def text(self, lines: list[str], pace: Pace) -> str:
        """Return an appcast.

        Args:
            lines: its text.
            pace: gives the run-time warning.
        """
        lines_ = "".join(f"{_plain(line)}!@" for line in lines)
        parts = [f"proc={NAME}", f"iter={self._round}", f"node={_plain(self.node)}", f"messages={lines_}"]
        parts += ["events_total=0", f"run_warning_total={pace.rounds if pace.warning else 0}"]
        if pace.warning:
            parts.append(f"run_warnings={pace.rounds}:{_plain(pace.warning)}")
        return "!@#".join(parts)


def _plain(text: str) -> str:
    """Return a text without the separators of an appcast."""
    return text.replace("!@", "").replace("\n", " ")
