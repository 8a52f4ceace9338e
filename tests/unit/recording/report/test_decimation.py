"""Fewer points: no peak is lost, and no more are left than a screen shows."""

from __future__ import annotations

import numpy as np

from uwserver.recording.report.decimation import decimated


def test_few_stay_as_they_are() -> None:
    t, y = np.arange(20.0), np.arange(40.0).reshape(20, 2)
    less = decimated(t, y, 10)
    assert less.t is t
    assert less.y is y


def test_every_peak_stays() -> None:
    rng = np.random.default_rng(1)
    t = np.sort(rng.uniform(0.0, 3600.0, 100_000))
    y = rng.normal(size=(100_000, 3))
    y[77_777, 1], y[5, 0], y[-1, 2] = 50.0, -40.0, 30.0
    less = decimated(t, y, 500)
    assert len(less.t) <= 1000
    np.testing.assert_allclose(less.y.max(axis=0), y.max(axis=0))
    np.testing.assert_allclose(less.y.min(axis=0), y.min(axis=0))
    assert (np.diff(less.t) >= 0.0).all()
    peak = less.t[int(np.argmax(less.y[:, 1]))]
    assert abs(peak - t[77_777]) < 3600.0 / 500


def test_the_order_of_the_extremes_is_theirs() -> None:
    t = np.arange(1000.0)
    less = decimated(t, np.stack([t, -t], axis=1), 10)
    assert (np.diff(less.y[:, 0]) > 0.0).all()
    assert (np.diff(less.y[:, 1]) < 0.0).all()


def test_a_gap_stays_a_gap() -> None:
    t = np.arange(10_000.0)
    y = np.ones((10_000, 1))
    y[4000:6000] = np.nan
    less = decimated(t, y, 100)
    hole = (less.t > 4200) & (less.t < 5800)
    assert hole.any()
    assert np.isnan(less.y[hole]).all()
    assert np.isfinite(less.y[~((less.t > 3800) & (less.t < 6200))]).all()
