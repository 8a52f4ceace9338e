"""Tables of the pages that `make docs` writes and `make docs-check` proves to be what the simulation does, read back for tests of their figures."""

from __future__ import annotations

import functools
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"

Table = list[dict[str, str]]
"""Rows: cells by the head of their column."""


@functools.cache
def tables(path: Path) -> dict[str, Table]:
    """The first table below each heading of a page; empty where there is none."""
    found: dict[str, Table] = {}
    for part in path.read_text(encoding="utf-8").split("\n## ")[1:]:
        title, _, text = part.partition("\n")
        lines = [
            [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")
        ]
        found[title] = [dict(zip(lines[0], cells, strict=True)) for cells in lines[2:]]
    return found


def of_vehicle(name: str) -> dict[str, Table]:
    """The tables of a shipped vehicle's page."""
    return tables(DOCS / "vehicles" / f"{name}.md")


def column(table: Table, head: str) -> dict[str, float]:
    """Figures of one column by condition, in the unit of its head; what was not reached is left out."""
    return {row[""]: float(row[head]) for row in table if row[head] != "-"}
