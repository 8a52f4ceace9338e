"""The surface of the sea: small waves with the right slope, caustics that keep the light, the edge of Snell's window, and total reflection."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sensors.optical.camera.rig import CLEAR, floor, view

from uwserver.environment.light import REFRACTION, Daylight
from uwserver.frames import quat_from_rpy
from uwserver.sensors.optical.camera.lens import lens_of
from uwserver.sensors.optical.camera.picture import Optics
from uwserver.sensors.optical.camera.surface import LEVEL, TEXELS, TILE_M, WAVES, fill


def tile(t: float) -> np.ndarray:
    out = np.empty((TEXELS, TEXELS, 3))
    fill(t, out)
    return out


def test_a_tile_is_the_sum_of_its_waves() -> None:
    t, a, b = 1.7, 37, 101
    size, kx, ky, omega, phase = WAVES.T
    angle = (kx * a + ky * b) * (TILE_M / TEXELS) - omega * t + phase
    expected = (
        -(size * kx * np.sin(angle)).sum(),
        -(size * ky * np.sin(angle)).sum(),
        -(size * (kx**2 + ky**2) * np.cos(angle)).sum(),
    )
    np.testing.assert_allclose(tile(t)[a, b], expected, rtol=1e-9)


def test_slopes_and_curvature_fit() -> None:
    waves = tile(1.7)
    assert np.sqrt((waves[:, :, :2] ** 2).sum(axis=2).mean()) == pytest.approx(0.10, rel=0.02)
    step = TILE_M / TEXELS
    bend = (np.roll(waves[:, :, 0], -1, 0) - np.roll(waves[:, :, 0], 1, 0)) / (2 * step)
    bend += (np.roll(waves[:, :, 1], -1, 1) - np.roll(waves[:, :, 1], 1, 1)) / (2 * step)
    assert np.abs(bend - waves[:, :, 2]).max() < 0.05 * np.abs(waves[:, :, 2]).max()
    assert not np.allclose(waves, tile(2.0))


@pytest.mark.parametrize(("depth", "lively"), [(2.0, True), (12.0, False)])
def test_light_is_gathered_near_the_surface_and_not_made(depth: float, lively: bool) -> None:
    down = quat_from_rpy(0.0, -0.5 * math.pi, 0.0)
    day = Daylight(50_000.0, 1.5707, 0.0, 0.0)
    optics = Optics(lens_of((160, 160), 2.0), None)
    light = optics.form(view(floor(depth), p=(0.0, 0.0, depth - 1.5), q=down, water=CLEAR, day=day))[:, 1]
    flat = 50_000.0 * (1.0 - (0.34 / 2.34) ** 2) * 0.5 / math.pi
    assert light.mean() == pytest.approx(flat, rel=0.1)
    assert (light.std() > 0.1 * flat) == lively


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
