"""Writes a report to a file: as an HTML page, or as a picture.

The page contains everything it needs and loads nothing. Content of the recording is data, not markup. It is JSON in a script element that is never
run, with every character escaped that could end the element, and the page inserts it as text. A Content-Security-Policy allows only the page's own
script to run.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import html
import os
import re
from collections.abc import Callable, Collection
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from uwserver.recording.report.bathymetry import SeaFloor, data_url
from uwserver.recording.report.contents import Contents, Track, contents_of
from uwserver.recording.report.panels import Panel, Picture, Table, decimated
from uwserver.recording.report.reading import FloatArray, read_recording

_HERE = Path(__file__).parent
_EXPORT = re.compile(r"^export \{ (\w+) as default \};\s*$", re.MULTILINE)
_EXPORTED = re.compile(r"^export (?=function|const|class)", re.MULTILINE)
_ESCAPED = {
    b"<": b"\\u003c",
    b">": b"\\u003e",
    b"&": b"\\u0026",
    "\u2028".encode(): b"\\u2028",
    "\u2029".encode(): b"\\u2029",
}


def report_of(path: Path, vehicles: Collection[str] = ()) -> Contents:
    """Read a recording and return the contents of its report.

    Args:
        path: path of the recording.
        vehicles: the vehicles in the report; all if empty.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not a recording of ours, or there is no such vehicle.
    """
    return contents_of(read_recording(path), vehicles)


def write_page(contents: Contents, path: Path) -> None:
    """Write the HTML page. Raises OSError when it cannot be written; an old file then stays."""
    _replaced(path, lambda file: file.write_text(page(contents), encoding="utf-8"))


def write_picture(contents: Contents, path: Path) -> int:
    """Write a PDF if the path ends in .pdf, else a PNG; return how many panels are left out.

    Raises OSError as `write_page`, and ImportError without matplotlib.
    """
    from uwserver.recording.report.drawing import write_pdf, write_png

    return _replaced(path, lambda file: (write_pdf if path.suffix.lower() == ".pdf" else write_png)(contents, file))


def _replaced(path: Path, write: Callable[[Path], int]) -> int:
    """Write a new file beside the old one, then put it in its place, so that a full disk leaves no half report. The folder is made."""
    beside = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        result = write(beside)
        beside.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise
    return result


def page(contents: Contents) -> str:
    """Return the whole page."""
    script, style = _script(), _style()
    policy = f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; img-src data:"
    head = (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        f'<meta name="viewport" content="width=device-width">\n<link rel="icon" href="data:,">\n'
        f"<title>{html.escape(contents.title)}</title>\n<style>{style}</style>\n</head>\n"
    )
    data = f'<script type="application/json" id="data">{_json(_data(contents))}</script>'
    return f"{head}<body>\n{data}\n<script>{script}</script>\n</body>\n</html>\n"


def _json(data: dict[str, Any]) -> str:
    text = msgspec.json.encode(data)
    for character, escaped in _ESCAPED.items():
        text = text.replace(character, escaped)
    return text.decode()


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _vendored(name: str) -> str:
    """Read a file of uPlot. In an installed package it is beside this module, in a checkout it is with the files of the web view."""
    beside = _HERE / "uplot"
    folder = beside if beside.is_dir() else _HERE.parents[2] / "clients" / "web" / "vendor" / "uplot-1.6.32"
    return (folder / "dist" / name).read_text(encoding="utf-8")


@cache
def _script() -> str:
    library = _vendored("uPlot.esm.js")
    name = _EXPORT.search(library)
    if name is None:
        raise RuntimeError("uPlot.esm.js has no default export: reinstall uwserver")
    plain = _EXPORTED.sub("", _EXPORT.sub("", library))
    wrapped = f"const uPlot = (() => {{\n{plain}\nreturn {name[1]};\n}})();\n"
    return wrapped + (_HERE / "page.js").read_text(encoding="utf-8")


@cache
def _style() -> str:
    return _vendored("uPlot.min.css") + "\n" + (_HERE / "page.css").read_text(encoding="utf-8")


def _data(contents: Contents) -> dict[str, Any]:
    return {
        "title": contents.title,
        "summary": contents.summary,
        "remarks": contents.remarks,
        "end": contents.end_s,
        "vehicles": [{"name": v.name, "model": v.model, "rows": v.rows} for v in contents.vehicles],
        "events": [(round(e.t_ns * 1e-9, 4), e.event, e.text) for e in contents.events],
        "errors": [
            {
                "vehicle": e.path.partition("/")[0],
                "path": e.path,
                "what": e.title,
                "count": str(len(e.t)),
                "rms": f"{e.rms:.3g} {e.unit}",
                "inside": "no sigma given" if e.inside is None else f"{e.inside:.1%}",
            }
            for e in contents.errors
        ],
        "panels": [_panel(panel) for panel in contents.panels],
        "map": _map(contents),
    }


def _panel(panel: Panel) -> dict[str, Any]:
    data: dict[str, Any] = {
        "vehicle": panel.vehicle,
        "group": panel.group,
        "title": panel.title,
        "unit": panel.unit,
        "down": panel.is_down,
        "band": panel.band,
        "note": panel.note,
    }
    if panel.picture is not None:
        return {**data, "picture": _picture(panel.picture)}
    return {**data, "tables": [_table(table) for table in panel.tables]}


def _table(table: Table) -> dict[str, Any]:
    t, columns = decimated(table.t, np.stack([line.y for line in table.lines], axis=1))
    return {
        "t": _numbers(t),
        "lines": [
            {"label": line.label, "y": _numbers(y), "step": line.is_stepped, "faint": line.is_faint}
            for line, y in zip(table.lines, columns.T, strict=True)
        ],
    }


def _numbers(values: FloatArray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def _picture(picture: Picture) -> dict[str, Any]:
    data = {name: getattr(picture, name) for name in ("begin", "end", "low", "high", "least", "most", "unit")}
    return {**data, "png": data_url(picture.png)}


def _map(contents: Contents) -> dict[str, Any]:
    floor, names = contents.floor, [v.name for v in contents.vehicles]
    picture = None
    if isinstance(floor, SeaFloor):
        picture = {
            "area": floor.area,
            "png": data_url(floor.png),
            "shallow": floor.shallow,
            "deep": floor.deep,
            "contour": floor.contour,
        }
    return {
        "area": contents.area,
        "picture": picture,
        "flat": floor if isinstance(floor, float) else None,
        "outlines": [{"name": name, "points": points.round(3).tolist()} for name, points in contents.outlines],
        "tracks": [_track(track, names.index(track.vehicle)) for track in contents.tracks],
    }


def _track(track: Track, colour: int) -> dict[str, Any]:
    return {
        "vehicle": track.vehicle,
        "colour": colour,
        "faint": track.is_estimate,
        "t": _numbers(track.t),
        "n": _numbers(track.p[:, 0]),
        "e": _numbers(track.p[:, 1]),
    }
