"""Node reports and NAV_ variables of other vehicles; external vehicles of the world follow them.

A node report is ``NAME=henry,TYPE=auv,X=12.3,Y=-4,DEP=5,HDG=90,SPD=1.2,TIME=...``, in m, m/s and degrees.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping

from uwserver.frames import quat_from_rpy
from uwserver_adapters.moos.codec import rad

NODE_REPORTS = ("NODE_REPORT", "NODE_REPORT_LOCAL")
"""Variables with node reports: as they come from other communities, and as pNodeReporter writes them."""
LONGEST = 4096
"""Longest node report, characters. They have some hundreds."""
VARIABLES = "_*"
"""End of the name of a vehicle that is followed by its variables: ``NAV_*``."""
_PAIR = re.compile(r'\s*([A-Za-z_]\w*)\s*=\s*("[^"]*"|\{[^{}]*\}|[^,]*)(?:,|$)')
_KEYS = {"X": "X", "Y": "Y", "DEPTH": "DEP", "HEADING": "HDG", "SPEED": "SPD"}
"""Last word of a variable -> key of a node report."""

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
