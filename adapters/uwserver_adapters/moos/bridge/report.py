"""Reports: node reports and NAV_ variables of other vehicles that come in, and messages for people who watch a mission.

A node report is ``NAME=henry,TYPE=auv,X=12.3,Y=-4,DEP=5,HDG=90,SPD=1.2,TIME=...``, in m, m/s and degrees; external vehicles of the world follow it.
People get a warning when the world is too slow for the warp, and an appcast for uMAC and pMarineViewer.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator, Mapping

from uwserver.frames import quat_from_rpy
from uwserver_adapters.moos.codec import Pairs, finite, rad, seconds

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
NODE_REPORTS = ("NODE_REPORT", "NODE_REPORT_LOCAL")
"""Variables with node reports: as they come from other communities, and as pNodeReporter writes them."""
LONGEST = 4096
"""Longest node report, characters. They have some hundreds."""
VARIABLES = "_*"
"""End of the name of a vehicle that is followed by its variables: ``NAV_*``."""
_PAIR = re.compile(r'\s*([A-Za-z_]\w*)\s*=\s*("[^"]*"|\{[^{}]*\}|[^,]*)(?:,|$)')
_KEYS = {"X": "X", "Y": "Y", "DEPTH": "DEP", "HEADING": "HDG", "SPEED": "SPD"}
"""Last word of a variable -> key of a node report."""


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
            name: name of the adapter, for the log.

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


Commands = Iterator[tuple[str, Mapping[str, object]]]
"""Paths of ports, and the fields of their commands."""


def read_report(text: str) -> tuple[str, dict[str, float]]:
    """Return the name in a node report ("" where it has none), and its finite numbers by key in upper case.

    Raises:
        ValueError: the text is too long.
    """
    if len(text) > LONGEST:
        raise ValueError(f"a node report of {len(text)} characters: at most {LONGEST} are read")
    name, numbers = "", dict[str, float]()
    for key, value in _PAIR.findall(text):
        if key.upper() == "NAME":
            name = value.strip()
            continue
        try:
            number = float(value)
        except ValueError:
            continue
        if math.isfinite(number):
            numbers[key.upper()] = number
    return name, numbers


def pose_command(name: str, numbers: Mapping[str, float]) -> dict[str, object]:
    """Return the fields of a command to a port `pose`: level, and moving ahead at the reported speed.

    Raises:
        ValueError: there is no position.
    """
    if missing := [key for key in ("X", "Y") if key not in numbers]:
        raise ValueError(f"the report of {name} has no {' and no '.join(missing)}")
    value: dict[str, object] = {"p_NB": [numbers["Y"], numbers["X"], numbers.get("DEP", 0.0)]}
    if "HDG" in numbers:
        value["q_NB"] = list(quat_from_rpy(0.0, 0.0, rad(numbers["HDG"])))
    if "SPD" in numbers:
        value["v_NB_B"] = [numbers["SPD"], 0.0, 0.0]
    return value


class NodeReports:
    """Moves external vehicles as others report.

    Args:
        externals: name of an external vehicle -> what it follows: the name in node reports, in which large and small letters are the same; or the
            beginning of variables, ``NAV_*``.

    Attributes:
        names: variables that mean something here.
    """

    def __init__(self, externals: Mapping[str, str]) -> None:
        self._nodes: dict[str, list[str]] = {}
        self._variables: dict[str, tuple[str, str]] = {}
        self._followed = externals
        self._newest: dict[str, dict[str, float]] = {vehicle: {} for vehicle in externals}
        self._fresh: dict[str, set[str]] = {vehicle: set() for vehicle in externals}
        for vehicle, followed in externals.items():
            if followed.endswith(VARIABLES):
                start = followed.removesuffix("*")
                self._variables.update({start + word: (vehicle, key) for word, key in _KEYS.items()})
            else:
                self._nodes.setdefault(followed.lower(), []).append(vehicle)
        self.names = (*(NODE_REPORTS if self._nodes else ()), *self._variables)

    def commands(self, name: str, value: float | str) -> Commands:
        """Yield the commands that follow from a variable.

        The report of a node that nobody follows causes none. Of single variables, both X and Y must have come since the last command.

        Raises:
            ValueError: the report of a followed node has no position, or a text comes instead of a number; the text says what is wrong.
        """
        if name in self._variables:
            vehicle, key = self._variables[name]
            if isinstance(value, str) or not math.isfinite(value):
                raise ValueError(f'"{str(value)[:40]}" is no number')
            self._newest[vehicle][key] = value
            fresh = self._fresh[vehicle]
            fresh.add(key)
            if {"X", "Y"} <= fresh:
                fresh.clear()
                yield f"{vehicle}/pose", pose_command(self._followed[vehicle], self._newest[vehicle])
            return
        node, numbers = read_report(str(value))
        for vehicle in self._nodes.get(node.lower(), ()):
            yield f"{vehicle}/pose", pose_command(node, numbers)
