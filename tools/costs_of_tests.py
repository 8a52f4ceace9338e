"""Writes into CONTRIBUTING.md what `make test` takes and which tests are the dearest, from its last run: ``python tools/costs_of_tests.py``.

The figures come from ``build/tests``: the parts as tools/run_parts.py has measured them, and the results of pytest. What a test proves is the first
sentence of its docstring, or else its name.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "build" / "tests"
DOCUMENT = ROOT / "CONTRIBUTING.md"
BEGIN, END = "<!-- tools/costs_of_tests.py: begin -->\n", "<!-- tools/costs_of_tests.py: end -->\n"
DEAREST = 30


class Cost(NamedTuple):
    """A test with all its parameters: where it stands, how many cases it has, and what these took in seconds."""

    file: str
    name: str
    cases: int
    wall_s: float
    cpu_s: float


def costs(results: Path) -> list[Cost]:
    """The tests of one run of pytest, the dearest first: by time of the processors, with fixtures that begin or end with a test."""
    found: dict[tuple[str, str], list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    for case in ElementTree.parse(results).iter("testcase"):
        name = (case.get("name") or "").partition("[")[0]
        sums = found[(_file(case.get("classname") or ""), name)]
        took = next((p.get("value", "0") for p in case.iter("property") if p.get("name") == "processor_s"), "0")
        for k, value in enumerate((1.0, float(case.get("time", "0")), float(took))):
            sums[k] += value
    every = [Cost(file, name, int(n), wall, cpu) for (file, name), (n, wall, cpu) in found.items()]
    return sorted(every, key=lambda cost: -cost.cpu_s)


def _file(dotted: str) -> str:
    """Path of the module of a test, which pytest names with dots."""
    return dotted.replace(".", "/") + ".py"


def proves(cost: Cost, root: Path = ROOT) -> str:
    """What a test is there for, in one sentence."""
    path = root / cost.file
    if path.is_file():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name == cost.name:
                text = ast.get_docstring(node)
                if text:
                    first = re.split(r"(?<=[.:;])\s|\n\n", text, maxsplit=1)[0]
                    return " ".join(first.split()).rstrip(":;").replace("|", "\\|")
    return cost.name.removeprefix("test_").replace("_", " ")


def folders(every: Iterable[Cost]) -> list[tuple[str, int, float, float]]:
    """Folder, number of tests, and what they took; the dearest first."""
    sums: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    for cost in every:
        parts = cost.file.split("/")
        folder = "/".join(parts[: 3 if parts[1] == "unit" else 2][: len(parts) - 1])
        for k, value in enumerate((float(cost.cases), cost.wall_s, cost.cpu_s)):
            sums[folder][k] += value
    return sorted(((name, int(n), wall, cpu) for name, (n, wall, cpu) in sums.items()), key=lambda row: -row[3])


def markdown(parts: Iterable[dict[str, object]], every: list[Cost], root: Path = ROOT) -> str:
    """The three tables."""
    lines = ["| part | on the wall, s | of the processors, s |", "|---|---|---|"]
    lines += [f"| `{p['part']}` | {p['wall_s']:.0f} | {p['cpu_s']:.0f} |" for p in parts]
    lines += ["", "| tests in | cases | of the processors, s |", "|---|---|---|"]
    lines += [f"| {name} | {cases} | {cpu:.0f} |" for name, cases, _, cpu in folders(every) if cpu >= 1.0]
    lines += ["", "| test | cases | of the processors, s | what it proves |", "|---|---|---|---|"]
    lines += [
        f"| [{cost.name.removeprefix('test_')}]({cost.file}) | {cost.cases} | {cost.cpu_s:.1f} | {proves(cost, root)} |"
        for cost in every[:DEAREST]
    ]
    return "\n".join(lines) + "\n"


def with_tables(document: str, tables: str) -> str:
    """A document with the text between its two marks replaced."""
    before, _, rest = document.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise SystemExit(f"{DOCUMENT.name} has lost its marks: {BEGIN.strip()} and {END.strip()}")
    return before + BEGIN + tables + END + after


def main() -> int:
    """Exit status."""
    results = FIGURES / "tests.xml"
    if not (results.is_file() and (FIGURES / "parts.json").is_file()):
        sys.stderr.write("there are no figures below build/tests: run make test\n")
        return 1
    parts = json.loads((FIGURES / "parts.json").read_text(encoding="utf-8"))
    text = with_tables(DOCUMENT.read_text(encoding="utf-8"), markdown(parts, costs(results)))
    DOCUMENT.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
