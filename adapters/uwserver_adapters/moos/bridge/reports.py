"""Node reports of others, which lead external vehicles of the world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from uwserver_adapters.moos.node_report import read_report

NODE_REPORTS = ("NODE_REPORT", "NODE_REPORT_LOCAL")
"""As pNodeReporter writes them, and as they come from other communities."""


class NodeReports:
    """Which external vehicle follows whom.

    Attributes:
        names: variables that mean something here.
    """

    def __init__(self, externals: Mapping[str, str]) -> None:
        """externals: names in node reports by the names of the vehicles that follow them; large and small letters are one."""
        self.names = NODE_REPORTS if externals else ()
        self._followers: dict[str, list[str]] = {}
        for vehicle, node in externals.items():
            self._followers.setdefault(node.lower(), []).append(vehicle)

    def commands(self, text: str) -> Iterator[tuple[str, Mapping[str, object]]]:
        """Ports, and what they are told by a report; none of a node that nobody follows.

        Raises:
            ValueError: it is the report of one that is followed, and says no place; the text says what is missing.
        """
        report = read_report(text)
        for vehicle in self._followers.get(report.name.lower(), ()):
            yield f"{vehicle}/pose", report.command()
