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
    """Read a recording and return the contents of its report.

    Args:
        path: of the recording.
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
