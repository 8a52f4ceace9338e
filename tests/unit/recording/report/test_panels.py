"""What is drawn over time."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.image import imread

from uwserver.recording.report.contents import Contents
from uwserver.recording.report.panels import Panel, _unwrapped
from uwserver.recording.report.reading import Recorded


def panel(contents: Contents, title: str, vehicle: str = "rov") -> Panel:
    return next(p for p in contents.panels if p.vehicle == vehicle and p.title == title)


def test_each_group_stands_together(contents: Contents) -> None:
    groups = [(p.vehicle, p.group) for p in contents.panels]
    assert len(dict.fromkeys(groups)) == sum(a != b for a, b in zip(groups, [None, *groups], strict=False))
    assert [group for vehicle, group in dict.fromkeys(groups) if vehicle == "rov"] == [
        "Motion", "Battery", "DVL", "Sonar", "Errors against the truth", "Other sensors",
    ]  # fmt: skip


def test_depth_shows_truth_floor_and_sensors(contents: Contents) -> None:
    depth = panel(contents, "Depth")
    assert depth.is_down
    lines = {line.label: line.y for table in depth.tables for line in table.lines}
    assert lines.keys() == {"true", "sea floor", "depth_noisy", "depth"}
    assert float(np.nanmin(lines["sea floor"])) > 12.0


def test_a_band_of_three_sigma_lies_around_zero(contents: Contents) -> None:
    errors = panel(contents, "depth_noisy depth")
    assert errors.band
    upper, lower = errors.tables[-1].lines
    np.testing.assert_allclose(upper.y, 0.03)
    np.testing.assert_allclose(lower.y, -0.03)
    assert "within 3 sigma" in errors.note


def test_exact_sensors_have_no_plot_of_rounding(contents: Contents) -> None:
    titles = {p.title for p in contents.panels if p.group == "Errors against the truth"}
    assert "mocap position" not in titles
    assert "gps_noisy position" in titles


def test_the_waterfall_is_of_the_pings(contents: Contents, recorded: Recorded) -> None:
    picture = panel(contents, "sonar range").picture
    bins = recorded.series["rov/sonar"].columns["bins"]
    assert picture is not None
    assert (picture.low, picture.high) == (0.0, 12.0)
    assert picture.most == np.nanmax(bins)
    pixels = imread(io.BytesIO(picture.png))[..., :3].sum(axis=2)
    assert pixels.shape == (60, min(1200, len(bins)))
    # Its first row is the far end.
    row, column = np.unravel_index(np.argmax(pixels), pixels.shape)
    strongest = np.unravel_index(np.nanargmax(bins), bins.shape)
    assert (column, 59 - row) == strongest


def test_headings_go_through_north_without_a_jump() -> None:
    told = np.array([350.0, 358.0, 5.0, np.nan, 12.0]) - 360.0 * np.array([0, 0, 0, 0, 0])
    first, start = _unwrapped(told, None)
    np.testing.assert_allclose(first, [350.0, 358.0, 365.0, np.nan, 372.0])
    second, _ = _unwrapped(np.array([-9.0, -1.0, 6.0]), start)
    np.testing.assert_allclose(second, [351.0, 359.0, 366.0])
