"""Node reports of others, and their NAV_ variables, which lead external vehicles of the world."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from uwserver_adapters.moos.node_report import NodeReport, read_report

NODE_REPORTS = ("NODE_REPORT", "NODE_REPORT_LOCAL")
"""As pNodeReporter writes them, and as they come from other communities."""
VARIABLES = "_*"
"""Ends the name of one who is followed by its variables: ``NAV_*``."""
_KEYS = {"X": "X", "Y": "Y", "DEPTH": "DEP", "HEADING": "HDG", "SPEED": "SPD"}
"""Last words of variables, and the same in node reports."""

Told = Iterator[tuple[str, Mapping[str, object]]]
"""Ports, and what they are told."""


class NodeReports:
    """Which external vehicle follows whom.

    Attributes:
        names: variables that mean something here.
    """

    def __init__(self, externals: Mapping[str, str]) -> None:
        """externals: by the names of the vehicles that follow them, names in node reports, whose large and small letters are one; or beginnings
        of variables, ``NAV_*``."""
        self._nodes: dict[str, list[str]] = {}
        self._variables: dict[str, tuple[_Newest, str]] = {}
        for vehicle, followed in externals.items():
            if followed.endswith(VARIABLES):
                newest = _Newest(vehicle, followed)
                for word, key in _KEYS.items():
                    self._variables[followed.removesuffix("*") + word] = newest, key
            else:
                self._nodes.setdefault(followed.lower(), []).append(vehicle)
        self.names = (*(NODE_REPORTS if self._nodes else ()), *self._variables)

    def commands(self, name: str, value: float | str) -> Told:
        """What follows from a variable; nothing from the report of a node that nobody follows, nor from half a place.

        Raises:
            ValueError: it is the report of one that is followed, and says no place, or a text for a number; the text says what is wrong.
        """
        if name in self._variables:
            newest, key = self._variables[name]
            yield from newest.hear(key, value)
            return
        report = read_report(str(value))
        for vehicle in self._nodes.get(report.name.lower(), ()):
            yield f"{vehicle}/pose", report.command()


class _Newest:
    """The newest values of variables that come one by one; a place is one when both X and Y are newer than the last."""

    def __init__(self, vehicle: str, followed: str) -> None:
        self._vehicle, self._followed = vehicle, followed
        self._found: dict[str, float] = {}
        self._fresh: set[str] = set()

    def hear(self, key: str, value: float | str) -> Told:
        if isinstance(value, str) or not math.isfinite(value):
            raise ValueError(f'"{str(value)[:40]}" is no number')
        self._found[key] = value
        self._fresh.add(key)
        if {"X", "Y"} <= self._fresh:
            self._fresh.clear()
            yield f"{self._vehicle}/pose", NodeReport(self._followed, dict(self._found)).command()
