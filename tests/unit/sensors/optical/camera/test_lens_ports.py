"""Ports: Snell's closed form for a flat one, and a dome that bends nothing about its centre."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwserver.sensors.optical.camera.lens import WATER_INDEX, DomePort, FlatPort, lens_of, outside

LENS = lens_of((640, 480), 1.2)


def snell_radius(port: FlatPort, ahead: float, across: float) -> float:
    """Focal lengths from the middle at which a point is seen behind a flat port, by bisection of the closed form."""

    def reached(a: float) -> float:
        glass, water = math.asin(math.sin(a) / port.index), math.asin(math.sin(a) / WATER_INDEX)
        way = ahead - port.distance_m - port.thickness_m
        return port.distance_m * math.tan(a) + port.thickness_m * math.tan(glass) + way * math.tan(water)

    low, high = 0.0, 1.5
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reached(middle) < across else (low, middle)
    return math.tan(low)


@pytest.mark.parametrize("away", [0.15, 0.6, 5.0])
def test_a_flat_port_is_snells_within_a_tenth_of_a_pixel(away: float) -> None:
    port = FlatPort(distance_m=0.03, thickness_m=0.012)
    u = np.array((10.0, 200.0, 330.0, 500.0, 639.0))
    v = np.array((5.0, 400.0, 240.0, 100.0, 479.0))
    bundle = outside(port, LENS.directions(u, v))
    reach = (away - bundle.origin[:, :1]) / bundle.direction[:, :1]
    points = bundle.origin + reach * bundle.direction
    for k, (x, y, z) in enumerate(points.tolist()):
        r = snell_radius(port, x, math.hypot(y, z)) * LENS.fx
        turn = math.atan2(z, y)
        assert math.hypot(r * math.cos(turn) + LENS.cx - u[k], r * math.sin(turn) + LENS.cy - v[k]) < 0.1


def test_a_flat_port_narrows_the_view_by_the_index() -> None:
    bundle = outside(
        FlatPort(distance_m=0.01, thickness_m=0.0), LENS.directions(np.array((639.0,)), np.array((LENS.cy,)))
    )
    into = math.asin(math.sin(0.6) / WATER_INDEX)
    assert math.atan2(bundle.direction[0, 1], bundle.direction[0, 0]) == pytest.approx(into, abs=1e-9)
    assert outside(FlatPort(distance_m=0.01, thickness_m=0.0), LENS.table()[:1], 1.0).direction[0] == pytest.approx(
        LENS.table()[0], abs=1e-9
    )


def test_a_dome_about_the_pupil_bends_nothing() -> None:
    rays = LENS.table()[::997]
    bundle = outside(DomePort(thickness_m=0.004), rays)
    np.testing.assert_allclose(bundle.direction, rays, atol=1e-12)
    np.testing.assert_allclose(bundle.origin, 0.05 * rays, atol=1e-12)


def test_a_dome_off_its_centre_bends_to_both_sides_alike() -> None:
    rays = LENS.directions(np.array((100.0, 539.0)), np.array((LENS.cy, LENS.cy)))
    bundle = outside(DomePort(thickness_m=0.004, offset_m=0.01), rays)
    assert bundle.direction[0, 1] == pytest.approx(-bundle.direction[1, 1])
    assert abs(bundle.direction[0, 1] - rays[0, 1]) > 1e-3
    # The rays reach the outer face.
    np.testing.assert_allclose(np.linalg.norm(bundle.origin - (0.01, 0.0, 0.0), axis=1), 0.05, rtol=1e-12)


def test_what_lets_no_light_in_is_refused() -> None:
    sideways = lens_of((641, 361), 3.4, "fisheye").directions(np.array((640.0,)), np.array((180.0,)))
    with pytest.raises(ValueError, match="flat port"):
        outside(FlatPort(distance_m=0.01, thickness_m=0.0), sideways)
    with pytest.raises(ValueError, match="outside the dome"):
        outside(DomePort(thickness_m=0.004, offset_m=0.06), LENS.table()[:1])
