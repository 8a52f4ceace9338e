"""The sea floor of a report, and its pictures."""

from __future__ import annotations

import io

import numpy as np
import pytest

from uwserver.physics.geometry.shapes import Box, Cylinder, HalfSpace, Placed, Solid, Sphere, TriangleMesh
from uwserver.ports.pictures import png
from uwserver.recording.report.bathymetry import SeaFloor, corners, outlines, sea_floor
from uwserver.recording.report.contents import Contents


def test_the_floor_under_the_tracks_is_that_of_the_scenario(contents: Contents) -> None:
    from matplotlib.image import imread

    floor = contents.floor
    assert isinstance(floor, SeaFloor)
    # 40 x 40 depths 4 m apart about the origin: 12 + 0.1 i + 0.05 j.
    north, east = np.array([0.0, 6.0, -5.0]), np.array([0.0, 3.0, 7.0])
    expected = 12.0 + 0.1 * (north / 4.0 + 19.5) + 0.05 * (east / 4.0 + 19.5)
    np.testing.assert_allclose(floor.below(north, east), expected, atol=0.01)
    assert np.isnan(floor.below(np.array([1e6]), np.array([0.0]))).all()
    picture = imread(io.BytesIO(floor.png))
    assert picture.shape[2] == 4
    south = picture[-1, :, :3].mean()
    assert south > picture[0, :, :3].mean()  # shallow is light, and the first row is the deep north


def test_a_mesh_that_is_no_grid_is_interpolated() -> None:
    rng = np.random.default_rng(3)
    vertices = np.column_stack([rng.uniform(-50, 50, (60, 2)), np.zeros(60)])
    vertices[:, 2] = 10.0 + 0.1 * vertices[:, 0]
    solid = Solid("seabed", (Placed(TriangleMesh(vertices, np.array([[0, 1, 2]]))),))
    floor = sea_floor({"static/seabed": solid}, (-20.0, 20.0, -20.0, 20.0))
    assert isinstance(floor, SeaFloor)
    assert floor.below(np.array([5.0]), np.array([5.0]))[0] == pytest.approx(10.5, abs=0.02)


def test_flat_and_open_water() -> None:
    flat = Solid("seabed", (Placed(HalfSpace(), (0.0, 0.0, 20.0)),))
    assert sea_floor({"static/seabed": flat}, (-1.0, 1.0, -1.0, 1.0)) == 20.0
    assert sea_floor({}, (-1.0, 1.0, -1.0, 1.0)) is None


@pytest.mark.parametrize(
    ("shape", "area"), [(Box((1.0, 2.0, 3.0)), 8.0), (Sphere(2.0), np.pi * 4.0), (Cylinder(0.5, 2.0), 4.0)]
)
def test_outlines_are_as_large_as_the_things(shape: Box | Sphere | Cylinder, area: float) -> None:
    placed = Placed(shape, (10.0, -4.0, 3.0))
    ((name, outline),) = outlines(
        {"static/thing": Solid("thing", (placed,)), "objects/crate": Solid("crate", (placed,))}
    )
    x, y = outline.T
    assert name == "thing"
    assert 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) == pytest.approx(area, rel=0.03)
    np.testing.assert_allclose(corners(placed).mean(axis=0), (10.0, -4.0, 3.0), atol=1e-9)


def test_a_png_reads_back() -> None:
    from matplotlib.image import imread

    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (5, 7, 4), dtype=np.uint8)
    pixels[..., 3] = 255
    np.testing.assert_allclose(imread(io.BytesIO(png(pixels))), pixels / 255.0, atol=1e-6)
    palette = bytes(np.repeat(np.arange(256, dtype=np.uint8), 3))
    numbers = rng.integers(0, 256, (4, 3), dtype=np.uint8)
    np.testing.assert_allclose(imread(io.BytesIO(png(numbers, palette)))[..., 0], numbers / 255.0, atol=1e-6)
