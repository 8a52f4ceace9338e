"""The manoeuvre report as a page: Markdown for documents, aligned tables for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from uwserver.units import deg
from uwserver.validation.manoeuvres.report import Comparison, Report
from uwserver.validation.manoeuvres.runs import Trial, Value

NONE_FOUND = "none found"
NOTHING = "Nothing stands out in buoyancy, trim, righting arm, attitude and course at full ahead, energy, and beside published figures."
_HEAD_WIDTHS = (12, 9, 6)
"""Widths to which titles of narrow columns are wrapped on a terminal, characters: the first with which the table fits."""
_LAST_WIDTH = 24
"""Least width to which the last column is wrapped."""
_NARROWEST = 60
Style = Callable[[str, str], str]
"""Returns a text in a style: "title" or "verdict"."""


@dataclass(frozen=True)
class Section:
    """A part of a report: a title, a text, a list of points, and a table with its head."""

    title: str
    text: str = ""
    points: tuple[str, ...] = ()
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


def sections(report: Report) -> Iterator[Section]:
    """Yield all parts of a report, the verdict first."""
    told = tuple(
        f"{verdict.text[:1].upper()}{verdict.text[1:]}{str(verdict)[len(verdict.text) :]}."
        for verdict in report.verdicts
    )
    yield Section("Verdict", "" if told else NOTHING, told)
    share = f"{report.guesses} of {report.groups} groups of numbers of hull, thrusters and fins are guesses"
    water = f"In water of {report.density_kgpm3:g} kg/m3; signs and axes forward, right, down."
    numbers = [(p.name, ", ".join(_digits(v) for v in p.values), p.unit, p.status or "-") for p in report.particulars]
    yield Section("Numbers", f"{water} {share}.", (), ("number", "value", "unit", "status"), tuple(numbers))
    rows = [row for comparison in report.comparisons for row in _compared(comparison)]
    head = ("quantity", "condition", "simulated", "published", "status", "source")
    yield Section("Beside the real vehicle", "", (), head, tuple(rows))
    yield from map(_section, report.trials)


def _section(trial: Trial) -> Section:
    if not trial.rows:
        return Section(trial.title, f"Does not apply: {trial.reason}.")
    head = ("", *(f"{column.name}{_unit(column.unit)}" for column in trial.columns))
    rows = [
        (row.condition, *(_shown(v, c.unit) for v, c in zip(row.values, trial.columns, strict=True)))
        for row in trial.rows
    ]
    return Section(trial.title, trial.text, (), head, tuple(rows))


def markdown(report: Report, picture: str = "") -> str:
    """Return the report as Markdown. `picture` is the path of a picture of the vehicle from there."""
    lines = [f"# {report.name}", "", report.description + ".", ""]
    if picture:
        lines += [f"![Shapes and thrusters of {report.name}]({picture})", ""]
    for section in sections(report):
        lines += [f"## {section.title}", ""]
        if section.text:
            lines += [section.text, ""]
        if section.points:
            lines += [*(f"- {point}" for point in section.points), ""]
        if section.rows:
            lines += [_row(section.head), "|" + "---|" * len(section.head), *map(_row, section.rows), ""]
    return "\n".join(lines)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def plain(report: Report, width: int, styled: Style) -> str:
    """Return the report for a terminal.

    Args:
        report: to be shown.
        width: width of the terminal, characters.
        styled: gives titles and verdicts their style.
    """
    width = max(width, _NARROWEST)
    lines = [styled(report.name, "title"), *textwrap.wrap(f"{report.description}.", width)]
    for section in sections(report):
        lines += ["", styled(section.title, "title")]
        lines += textwrap.wrap(" ".join(section.text.split()), width)
        for point in section.points:
            wrapped = textwrap.wrap(point, width - 2)
            lines += [f"{'- ' if k == 0 else '  '}{styled(line, 'verdict')}" for k, line in enumerate(wrapped)]
        if section.rows:
            lines += aligned(section.head, section.rows, width)
    return "\n".join(lines) + "\n"


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return the lines of a table. Columns of numbers are on the right; titles are wrapped, and so is the last column if the line is too long."""
    columns = list(zip(*rows, strict=True))
    body = [max(map(len, column)) for column in columns]
    right = [
        k > 0 and all(map(_is_number, column)) and any(cell[-1:].isdigit() for cell in column)
        for k, column in enumerate(columns)
    ]
    for narrowest in _HEAD_WIDTHS:
        titles = [textwrap.wrap(title, max(size, narrowest)) or [""] for title, size in zip(head, body, strict=True)]
        widths = [max(size, *map(len, title)) for size, title in zip(body, titles, strict=True)]
        least = widths[-1] if right[-1] else min(widths[-1], _LAST_WIDTH)
        if sum(widths[:-1]) + least + 2 * (len(widths) - 1) <= width:
            break
    rest = width - sum(widths[:-1]) - 2 * (len(widths) - 1)
    if widths[-1] > rest and not right[-1]:
        widths[-1] = max(rest, _LAST_WIDTH)
    lines = []
    tall = max(map(len, titles))
    for k in range(tall):
        # The lines of a title stand at its bottom.
        cells = [title[k - tall + len(title)] if k >= tall - len(title) else "" for title in titles]
        lines.append(_line(cells, widths, right))
    lines.append(_line(["-" * size for size in widths], widths, right))
    for row in rows:
        first, *more = textwrap.wrap(row[-1], widths[-1]) or [""]
        lines.append(_line([*row[:-1], first], widths, right))
        lines += [_line([*[""] * (len(row) - 1), text], widths, right) for text in more]
    return lines


def _line(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    padded = (
        cell.rjust(size) if to_right else cell.ljust(size)
        for cell, size, to_right in zip(cells, widths, right, strict=True)
    )
    return "  ".join(padded).rstrip()


def _is_number(cell: str) -> bool:
    return cell in ("-", NONE_FOUND) or cell.lstrip("-")[:1].isdigit()


def _compared(comparison: Comparison) -> list[tuple[str, ...]]:
    begin = (comparison.quantity, comparison.condition or "-", _shown(comparison.simulated, ""))
    if not comparison.published:
        return [(*begin, NONE_FOUND, "-", "-")]
    return [(*begin, _digits(p.value), p.status, p.source) for p in comparison.published]


def _unit(unit: str) -> str:
    return "" if unit == "1" else f", {unit.replace('rad', 'deg')}"


def _shown(value: Value, unit: str) -> str:
    if value is None:
        return "-"
    if unit.startswith("rad"):
        return f"{deg(value) + 0.0:.1f}".replace("-0.0", "0.0")
    return _digits(value)


def _digits(value: float) -> str:
    """Return a number with three digits; less than half a thousandth is 0."""
    if abs(value) < 5e-4:
        return "0"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
