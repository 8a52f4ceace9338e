"""Reports as files, by the command line too. Also of uwserver.recording.report.drawing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from uwserver.cli.recordings.plot import plot
from uwserver.recording.report import writing
from uwserver.recording.report.contents import Contents


def test_a_page_and_pictures(run: Path, contents: Contents, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of lines, of lines with a band and of pictures one panel each: there are dozens."""
    from matplotlib.image import imread

    kinds = {(panel.picture is None, panel.band): panel for panel in contents.panels}
    assert kinds.keys() == {(True, True), (True, False), (False, False)}
    fewer = replace(contents, panels=tuple(kinds.values()))
    monkeypatch.setattr(writing, "report_of", lambda path, vehicles: fewer)
    file = tmp_path / "out.html"
    done = CliRunner().invoke(plot, [str(run), "-o", str(file), "--png", "--pdf"])
    assert done.exit_code == 0, done.output
    assert file.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert imread(file.with_suffix(".png")).shape[1] == 880
    assert file.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".html", ".pdf", ".png"]


def test_the_name_is_that_of_the_recording(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "dive.mcap"
    copy.write_bytes(run.read_bytes())
    done = CliRunner().invoke(plot, ["report", str(copy), "--vehicle", "other"])
    assert done.exit_code == 0, done.output
    assert f"wrote {tmp_path / 'dive.html'}" in done.output


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nothing.mcap"], "nothing.mcap: No such file"),
        (["x.mcap", "--vehicle", "rovv"], 'no vehicle "rovv"'),
        (["x.mcap", "-o", "x.mcap"], "would be overwritten"),
        (["x.mcap", "-o", "/dev/null/x.html"], "/dev/null: "),
    ],
)
def test_what_cannot_be_done_is_told(run: Path, arguments: list[str], told: str) -> None:
    given = [str(run) if argument == "x.mcap" else argument for argument in arguments]
    before = run.read_bytes()
    done = CliRunner().invoke(plot, given)
    assert done.exit_code == 1
    assert told in done.output
    assert "Traceback" not in done.output
    assert run.read_bytes() == before


def test_the_folder_is_made(run: Path, tmp_path: Path) -> None:
    file = tmp_path / "results" / "today" / "x.html"
    done = CliRunner().invoke(plot, [str(run), "-o", str(file), "--vehicle", "other"])
    assert done.exit_code == 0, done.output
    assert file.is_file()


def test_a_file_that_ends_at_once_has_no_empty_reason(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"")
    done = CliRunner().invoke(plot, [str(tmp_path / "x.mcap")])
    assert done.exit_code == 1
    assert "damaged at its start" in done.output
    assert not done.output.rstrip().endswith(":")


def test_a_failed_write_leaves_what_was_there(
    contents: Contents, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "old.html"
    file.write_text("old")

    def full(path: Path, *_: object, **__: object) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space"):
        writing.write_page(contents, file)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]
