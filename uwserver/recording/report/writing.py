"""Writes reports to files."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Collection
from pathlib import Path

from uwserver.recording.report.contents import Contents, contents_of
from uwserver.recording.report.page import page
from uwserver.recording.report.reading import read_recording


def report_of(path: Path, vehicles: Collection[str] = ()) -> Contents:
    """What a report of a recording shows.

    Args:
        path: of the recording.
        vehicles: that it is about; all without.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no recording of ours, or there is no such vehicle.
    """
    return contents_of(read_recording(path), vehicles)


def write_page(contents: Contents, path: Path) -> None:
    """The HTML page. OSError when it cannot be written; what was there before stays then."""
    _replaced(path, lambda file: file.write_text(page(contents), encoding="utf-8"))


def write_picture(contents: Contents, path: Path) -> int:
    """A PNG, or by its ending a PDF; returns how many panels a PNG leaves out. OSError as `write_page`; ImportError without matplotlib."""
    from uwserver.recording.report.drawing import write_pdf, write_png

    left_out = 0

    def draw(file: Path) -> None:
        nonlocal left_out
        if path.suffix.lower() == ".pdf":
            write_pdf(contents, file)
        else:
            left_out = write_png(contents, file)

    _replaced(path, draw)
    return left_out


def _replaced(path: Path, write: Callable[[Path], object]) -> None:
    """Write beside the file, then put it in its place: a full disk leaves no half report. Its folder is made."""
    beside = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        write(beside)
        beside.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise
