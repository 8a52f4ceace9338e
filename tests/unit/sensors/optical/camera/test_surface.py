"""The surface from below: an edge of Snell's window without blocks, and where all is mirrored."""

from __future__ import annotations

import math

import numpy as np
from sensors.optical.camera.rig import CLEAR, view

from uwserver.environment.light import REFRACTION, Daylight
from uwserver.frames import quat_from_rpy
from uwserver.sensors.optical.camera.caustics import WAVES
from uwserver.sensors.optical.camera.lens import lens_of
from uwserver.sensors.optical.camera.picture import Optics
from uwserver.sensors.optical.camera.surface import LEVEL


def test_the_edge_of_the_window_is_not_made_of_blocks() -> None:
    """Waves are small there: a pixel has about the mean of the nine that a finer camera has in its place."""
    up, day = quat_from_rpy(0.0, 0.9, 0.0), Daylight(50_000.0, 0.3, math.pi, 0.9)
    coarse, fine = (
        Optics(lens_of((width, width * 3 // 4), 1.4), None)
        .form(view(p=(0.0, 0.0, 9.5), q=up, water=CLEAR, day=day))[:, 1]
        .reshape(width * 3 // 4, width)
        .copy()
        for width in (120, 360)
    )
    mean = fine.reshape(90, 3, 120, 3).mean(axis=(1, 3))
    edge = (mean > 0.2 * mean.max()) & (mean < 0.8 * mean.max())
    assert edge.sum() > 500
    assert np.abs(coarse - mean)[edge].mean() < 0.04 * mean.max()


def test_rays_that_are_nearly_level_are_mirrored_by_all_waves() -> None:
    """So their pixels look at the surface once, and not in four places."""
    steepest = float(np.sum(WAVES[:, 0] * np.hypot(WAVES[:, 1], WAVES[:, 2])))
    critical = math.sqrt(1.0 - 1.0 / REFRACTION**2)
    for slope in np.linspace(0.0, steepest, 50):
        level = LEVEL + 0.005  # and a pixel more
        assert (slope * math.sqrt(1.0 - level**2) + level) / math.hypot(1.0, slope) < critical
