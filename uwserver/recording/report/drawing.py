"""Draws the report for papers and mails: one tall PNG, or a PDF with a page for each group. Needs matplotlib (extra `plot`)."""

from __future__ import annotations

from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from uwserver.recording.report.bathymetry import SeaFloor
from uwserver.recording.report.contents import Contents
from uwserver.recording.report.panels import Panel, decimated

_WIDTH_IN, _ROW_IN, _MAP_IN = 8.0, 1.7, 4.5
_DPI = 110
_MOST_PANELS = 40
"""Largest number of panels in one PNG. Viewers cope badly with taller pictures; a PDF has all panels."""
_MOST_EVENTS = 300


def write_png(contents: Contents, path: Path) -> int:
    """Draw the map and the first panels below each other; return how many panels are left out. Raises OSError when it cannot be written."""
    from matplotlib.figure import Figure

    chosen = contents.panels[:_MOST_PANELS]
    figure = Figure(figsize=(_WIDTH_IN, _MAP_IN + _ROW_IN * len(chosen)), layout="constrained")
    rows = figure.subplots(1 + len(chosen), 1, squeeze=False, height_ratios=[_MAP_IN, *([_ROW_IN] * len(chosen))])[:, 0]
    _map(rows[0], contents)
    for axis, panel in zip(rows[1:], chosen, strict=True):
        _panel(axis, panel, contents)
    figure.suptitle(_plain(contents.title), fontsize=10)
    figure.savefig(path, dpi=_DPI, metadata={"Software": None})
    return len(contents.panels) - len(chosen)


def write_pdf(contents: Contents, path: Path) -> int:
    """Draw a page with tables and map, and a page for each group of panels of each vehicle; return 0, as no panel is left out.

    Raises OSError when it cannot be written.
    """
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    with PdfPages(path) as pages:
        figure = Figure(figsize=(_WIDTH_IN, 11.0), layout="constrained")
        table, axis = figure.subplots(2, 1)
        table.axis("off")
        rows = [*contents.summary, *((f"{v.name}: {name}", value) for v in contents.vehicles for name, value in v.rows)]
        lines = [f"{name:<28} {value}" for name, value in rows] + list(contents.remarks)
        table.text(
            0.0, 1.0, _plain("\n".join(lines)), va="top", family="monospace", fontsize=7, transform=table.transAxes
        )
        _map(axis, contents)
        figure.suptitle(_plain(contents.title), fontsize=11)
        pages.savefig(figure)
        for (vehicle, group), some in groupby(contents.panels, key=lambda panel: (panel.vehicle, panel.group)):
            chosen = list(some)
            figure = Figure(figsize=(_WIDTH_IN, 0.6 + _ROW_IN * len(chosen)), layout="constrained")
            for axis, panel in zip(figure.subplots(len(chosen), 1, squeeze=False)[:, 0], chosen, strict=True):
                _panel(axis, panel, contents)
            figure.suptitle(_plain(f"{vehicle}: {group}"), fontsize=10)
            pages.savefig(figure)
    return 0


def _map(axis: Any, contents: Contents) -> None:
    floor = contents.floor
    if isinstance(floor, SeaFloor):
        from matplotlib.image import imread

        south, north, west, east = floor.area
        axis.imshow(imread(BytesIO(floor.png)), extent=(west, east, south, north))
    for _, outline in contents.outlines:
        axis.fill(outline[:, 1], outline[:, 0], facecolor="0.5", edgecolor="0.2", lw=0.6)
    names = [vehicle.name for vehicle in contents.vehicles]
    for track in contents.tracks:
        colour = f"C{names.index(track.vehicle)}"
        style = {"ls": ":", "lw": 0.8} if track.is_estimate else {"lw": 1.4, "label": _plain(track.vehicle)}
        axis.plot(track.p[:, 1], track.p[:, 0], color=colour, **style)
    south, north, west, east = contents.area
    axis.set(xlim=(west, east), ylim=(south, north), aspect="equal", xlabel="east, m", ylabel="north, m")
    axis.tick_params(labelsize=7)
    if any(not track.is_estimate for track in contents.tracks):
        axis.legend(fontsize=7)


def _panel(axis: Any, panel: Panel, contents: Contents) -> None:
    if panel.picture is not None:
        from matplotlib.image import imread

        p = panel.picture
        axis.imshow(
            imread(BytesIO(p.png)), extent=(p.begin, p.end, p.low, p.high), aspect="auto", interpolation="nearest"
        )
    for number, table in enumerate(panel.tables):
        t, columns = decimated(table.t, np.stack([line.y for line in table.lines], axis=1))
        if panel.band and number == len(panel.tables) - 1:
            axis.fill_between(t, columns[:, 1], columns[:, 0], color="0.85", lw=0)
            continue
        for line, y in zip(table.lines, columns.T, strict=True):
            look = {"color": "0.5", "ls": "--"} if line.is_faint else {}
            style = {"drawstyle": "steps-post"} if line.is_stepped else {}
            axis.plot(t, y, lw=0.8, label=_plain(line.label), **look, **style)
    for event in contents.events[:_MOST_EVENTS]:
        if event.event != "watchdog":
            axis.axvline(event.t_ns * 1e-9, color="C3" if event.event == "fault" else "0.4", lw=0.5, alpha=0.6)
    if panel.is_down:
        axis.invert_yaxis()
    unit = "" if panel.unit in ("", "1") else f", {panel.unit}"
    axis.set_title(
        _plain(f"{panel.vehicle}: {panel.title}{unit}" + (f" ({panel.note})" if panel.note else "")),
        fontsize=7,
        loc="left",
    )
    axis.set_xlim(0.0, max(contents.end_s, 1e-3))
    axis.tick_params(labelsize=6)
    axis.grid(alpha=0.3)
    count = sum(len(table.lines) for table in panel.tables)
    if 1 < count <= 12:
        axis.legend(fontsize=5, ncols=min(count, 6), loc="upper right")


def _plain(text: str) -> str:
    """Return text in which matplotlib finds no mathematics, without characters that no font can show."""
    return "".join(c if c.isprintable() or c == "\n" else " " for c in text).replace("$", r"\$")
