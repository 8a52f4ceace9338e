"""What is drawn over time."""

from __future__ import annotations

import base64
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from uwserver.recording.report.contents import Contents
from uwserver.recording.report.panels import Panel, _unwrapped, decimated
from uwserver.recording.report.reading import ACROSS, Recorded


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
    from matplotlib.image import imread

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


def test_an_imaging_sonar_has_its_strongest_beam_over_range(contents: Contents, recorded: Recorded, run: Path) -> None:
    """In dB, as pressures change by many powers of ten; of 300 bins the peaks of 256 are kept."""
    found = panel(contents, "imaging range")
    rows = recorded.series["rov/imaging"].columns["image"]
    images = [np.frombuffer(base64.b64decode(m["value"]["image"]["base64"]), "<f4") for m in told(run, "rov/imaging")]
    assert rows.shape == (len(images), ACROSS)
    np.testing.assert_allclose(rows.max(axis=1), [image.max() for image in images])
    strongest = images[0].reshape(300, 24).max(axis=1)
    k = int(strongest.argmax())
    assert int(rows[0].argmax()) == pytest.approx(k * ACROSS / 300, abs=1.0)
    assert found.picture is not None
    assert (found.picture.low, found.picture.high, found.picture.unit) == (0.0, 24.0, "dB re 1 uPa")
    assert found.picture.most == pytest.approx(20.0 * math.log10(rows.max() * 1e6))
    assert "strongest beam" in found.note


def test_a_side_scan_shows_both_sides(contents: Contents, recorded: Recorded, run: Path) -> None:
    """Starboard above, port below, nearest in the middle; the water column between them is dark."""
    from matplotlib.image import imread

    picture = panel(contents, "side range").picture
    assert picture is not None
    assert (picture.low, picture.high, picture.unit) == (-40.0, 40.0, "1")
    pixels = imread(io.BytesIO(picture.png))[..., :3].sum(axis=2)
    first = told(run, "rov/side")[0]["value"]
    port, starboard = (
        np.frombuffer(base64.b64decode(first[side]["base64"]), np.uint8) for side in ("port", "starboard")
    )
    assert pixels.shape[0] == 2 * ACROSS
    shown = pixels[:, 0]
    for row, half in ((starboard, shown[:ACROSS][::-1]), (port, shown[ACROSS:])):
        wide = row[np.arange(ACROSS) * 200 // ACROSS].astype(float)
        assert np.corrcoef(wide, half)[0, 1] > 0.95
    assert np.array_equal(recorded.series["rov/side"].columns["port"][0], port[np.arange(ACROSS) * 200 // ACROSS])


def told(run: Path, path: str) -> list[dict[str, Any]]:
    """The messages of a port."""
    with run.open("rb") as file:
        found = [json.loads(message.data) for _, _, message in make_reader(file).iter_messages(topics=[path])]
    return sorted(found, key=lambda message: int(message["t_ns"]))


def test_headings_go_through_north_without_a_jump() -> None:
    told = np.array([350.0, 358.0, 5.0, np.nan, 12.0]) - 360.0 * np.array([0, 0, 0, 0, 0])
    first, start = _unwrapped(told, None)
    np.testing.assert_allclose(first, [350.0, 358.0, 365.0, np.nan, 372.0])
    second, _ = _unwrapped(np.array([-9.0, -1.0, 6.0]), start)
    np.testing.assert_allclose(second, [351.0, 359.0, 366.0])


def test_few_stay_as_they_are() -> None:
    t, y = np.arange(20.0), np.arange(40.0).reshape(20, 2)
    less_t, less_y = decimated(t, y, 10)
    assert less_t is t
    assert less_y is y


def test_every_peak_stays() -> None:
    rng = np.random.default_rng(1)
    t = np.sort(rng.uniform(0.0, 3600.0, 100_000))
    y = rng.normal(size=(100_000, 3))
    y[77_777, 1], y[5, 0], y[-1, 2] = 50.0, -40.0, 30.0
    less_t, less_y = decimated(t, y, 500)
    assert len(less_t) <= 1000
    np.testing.assert_allclose(less_y.max(axis=0), y.max(axis=0))
    np.testing.assert_allclose(less_y.min(axis=0), y.min(axis=0))
    assert (np.diff(less_t) >= 0.0).all()
    peak = less_t[int(np.argmax(less_y[:, 1]))]
    assert abs(peak - t[77_777]) < 3600.0 / 500


def test_the_order_of_the_extremes_is_theirs() -> None:
    t = np.arange(1000.0)
    _, less_y = decimated(t, np.stack([t, -t], axis=1), 10)
    assert (np.diff(less_y[:, 0]) > 0.0).all()
    assert (np.diff(less_y[:, 1]) < 0.0).all()


def test_a_gap_stays_a_gap() -> None:
    t = np.arange(10_000.0)
    y = np.ones((10_000, 1))
    y[4000:6000] = np.nan
    less_t, less_y = decimated(t, y, 100)
    hole = (less_t > 4200) & (less_t < 5800)
    assert hole.any()
    assert np.isnan(less_y[hole]).all()
    assert np.isfinite(less_y[~((less_t > 3800) & (less_t < 6200))]).all()
