"""Grids of depth: where each point lies in N, what is cut off, how the surface is made, and parts of .npy files of any layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.scenario.solids import bathymetry
from uwserver.scenario.solids.bathymetry import Array, Grid, read_grid, triangulate
from uwserver.scenario.solids.tables import GridSeabed

DEPTH = 10.0 + np.arange(12.0).reshape(3, 4)


@pytest.fixture
def read(tmp_path: Path):
    """Reads an array that it writes as .npy, with keys of the table."""

    def run(array: Any = DEPTH, **keys: Any) -> Grid:
        np.save(tmp_path / "g.npy", array)
        table = msgspec.convert({"kind": "grid", "file": "g.npy", "spacing_m": [10, 20], **keys}, GridSeabed)
        return read_grid(table, tmp_path / "g.npy", None)

    return run


# -- where it lies ----------------------------------------------------------------------------------------------------------------------


def test_rows_go_north_and_columns_east_about_the_middle(read) -> None:
    grid = read()
    assert grid.north[:, 0].tolist() == [-10.0, 0.0, 10.0]
    assert grid.east[0].tolist() == [-30.0, -10.0, 10.0, 30.0]
    assert (grid.depth == DEPTH).all()


def test_the_first_point_can_be_placed(read) -> None:
    grid = read(origin_north_east_m=[100, -50])
    assert (grid.north[0, 0], grid.east[0, 0]) == (100.0, -50.0)
    assert (grid.north[-1, -1], grid.east[-1, -1]) == (120.0, 10.0)


@pytest.mark.parametrize(("values", "sign"), [("depth", 1.0), ("elevation", -1.0)])
def test_depth_is_down(values: str, sign: float, read) -> None:
    assert (read(values=values).depth == sign * DEPTH).all()


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<i2", "<u1"])
def test_numbers_of_any_kind_become_doubles(dtype: str, read) -> None:
    grid = read(DEPTH.astype(dtype))
    assert grid.depth.dtype == np.float64
    assert grid.depth == pytest.approx(DEPTH)


@pytest.mark.parametrize(
    ("extent", "north", "east"),
    [(1000.0, (-10, 10), (-30, 30)), (10.0, (-10, 10), (-30, 30)), (9.0, (-10, 10), None), (30.0, (-10, 10), (-30, 30))],
)  # fmt: skip
def test_a_cut_keeps_a_border_around_what_is_in_reach(extent: float, north: Any, east: Any, read) -> None:
    if east is None:
        with pytest.raises(BadSolid, match=f"no point of the grid is within {extent:g} m of the origin of N"):
            read(extent_m=extent)
        return
    grid = read(extent_m=extent)
    assert (grid.north.min(), grid.north.max()) == north
    assert (grid.east.min(), grid.east.max()) == east


def test_a_cut_of_a_large_grid_is_small(read) -> None:
    grid = read(np.full((201, 101), 30.0), extent_m=25.0)
    assert (grid.north[0, 0], grid.north[-1, 0]) == (-30.0, 30.0)
    assert (grid.east[0, 0], grid.east[0, -1]) == (-40.0, 40.0)


# -- refusals ---------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "text"),
    [
        (np.zeros(5), '"g.npy" must hold an array of numbers with rows and columns'),
        (np.zeros((2, 2, 2)), "rows and columns"),
        (np.array([["a", "b"], ["c", "d"]]), "array of numbers"),
        (np.zeros((2, 2), dtype=complex), "array of numbers"),
        (np.zeros((1, 9)), '"g.npy" has 1 x 9 points within extent_m; at least 2 x 2 are needed'),
        (np.zeros((0, 0)), "0 x 0 points within extent_m"),
        (np.array([[1.0, np.nan], [np.inf, 1.0]]), '2 of 4 depths in "g.npy" are not finite: fill these gaps'),
    ],
)
def test_what_is_no_grid_is_refused(values: Any, text: str, read) -> None:
    with pytest.raises(BadSolid) as caught:
        read(values)
    assert text in str(caught.value)


def test_an_array_of_python_objects_is_never_unpickled(read) -> None:
    with pytest.raises(BadSolid, match="must hold an array of numbers"):
        read(np.array([[{}, {}], [{}, {}]], dtype=object))


def test_too_many_points_are_refused_unless_they_are_cut(read, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bathymetry, "MOST_POINTS", 30)
    with pytest.raises(BadSolid, match="has 400 points; at most 30 are allowed: set extent_m, or thin the grid out"):
        read(np.full((20, 20), 5.0))
    assert read(np.full((20, 20), 5.0), extent_m=12.0).depth.size == 16
    with pytest.raises(BadSolid, match="at most 30"):
        read(np.full((20, 20), 5.0), extent_m=80.0)


def test_a_file_of_another_kind_or_none_is_refused(tmp_path: Path) -> None:
    table = GridSeabed(file="x")
    with pytest.raises(BadSolid, match="there is no grid file"):
        read_grid(table, tmp_path / "x.npy", None)
    (tmp_path / "x.csv").write_text("1,2")
    with pytest.raises(BadSolid, match=r"an unknown file type: use \.npy or \.nc"):
        read_grid(table, tmp_path / "x.csv", None)
    np.save(tmp_path / "x.npy", DEPTH)
    with pytest.raises(BadSolid, match="needs spacing_m: give the distance of its rows and that of its columns"):
        read_grid(table, tmp_path / "x.npy", None)


# -- latitude and longitude -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def netcdf(tmp_path: Path):
    """Reads elevations at latitudes and longitudes from a classic NetCDF file that it writes."""

    def run(lat: Any, lon: Any, values: Any, origin: Any, attributes: Any = None, **keys: Any) -> Grid:
        from scipy.io import netcdf_file

        file = netcdf_file(str(tmp_path / "g.nc"), "w")
        for name, axis in (("lat", lat), ("lon", lon)):
            file.createDimension(name, len(axis))
            file.createVariable(name, "f8", (name,))[:] = axis
        variable = file.createVariable("elevation", np.asarray(values).dtype, ("lat", "lon"))
        variable[:] = values
        for key, value in (attributes or {}).items():
            setattr(variable, key, value)
        file.close()
        return read_grid(
            msgspec.convert({"kind": "grid", "file": "g.nc", **keys}, GridSeabed), tmp_path / "g.nc", origin
        )

    return run


LAT, LON = np.array([63.40, 63.41, 63.42]), np.array([10.38, 10.40, 10.42, 10.44])
HERE = (63.41, 10.40)


def test_elevations_come_to_lie_about_the_origin(netcdf) -> None:
    grid = netcdf(LAT, LON, -DEPTH, HERE)
    assert (grid.depth == DEPTH).all()
    assert (grid.north[1, 1], grid.east[1, 1]) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert grid.north[2, 1] == pytest.approx(0.01 * 111_430, rel=2e-3)
    assert grid.east[1, 2] == pytest.approx(0.02 * 111_320 * np.cos(np.radians(63.41)), rel=4e-3)


@pytest.mark.parametrize(("flip_lat", "flip_lon"), [(True, False), (False, True), (True, True)])
def test_axes_may_fall(flip_lat: bool, flip_lon: bool, netcdf) -> None:
    straight = netcdf(LAT, LON, -DEPTH, HERE)
    values = (-DEPTH)[:: -1 if flip_lat else 1, :: -1 if flip_lon else 1]
    turned = netcdf(LAT[:: -1 if flip_lat else 1], LON[:: -1 if flip_lon else 1], values, HERE)
    for one, other in zip(straight, turned, strict=True):
        assert one == pytest.approx(other)


def test_fill_values_and_scales_of_the_file_hold(netcdf) -> None:
    packed = np.array([[-100, -110], [-120, -130]], dtype=np.int16)
    grid = netcdf(LAT[:2], LON[:2], packed, HERE, {"scale_factor": 0.1, "add_offset": -5.0})
    assert grid.depth == pytest.approx(np.array([[15.0, 16.0], [17.0, 18.0]]))
    with pytest.raises(BadSolid, match="1 of 4 depths"):
        netcdf(LAT[:2], LON[:2], packed, HERE, {"_FillValue": np.int16(-120)})


@pytest.mark.parametrize(
    ("depth", "text"), [(1e300, "1 of 12 depths"), (-25_000.0, "more than 20000 m from sea level")]
)
def test_a_fill_value_that_nobody_named_is_no_depth(depth: float, text: str, netcdf) -> None:
    filled = DEPTH.copy()
    filled[1, 1] = depth
    with pytest.raises(BadSolid, match=text):
        netcdf(LAT, LON, -filled, HERE)


def test_metres_are_no_degrees(netcdf) -> None:
    with pytest.raises(BadSolid, match="lon must be in degrees, but goes up to 510000"):
        netcdf(LAT, np.array([480_000.0, 490_000.0, 500_000.0, 510_000.0]), -DEPTH, HERE)


def test_a_cut_across_the_date_line(netcdf) -> None:
    lon = np.linspace(-180.0, 180.0, 361)
    values = np.full((3, 361), -7.0)
    grid = netcdf(np.array([-1.0, 0.0, 1.0]), lon, values, (0.0, 0.0), extent_m=300_000.0)
    assert grid.depth.shape == (3, 7)
    assert abs(grid.east).max() < 400_000.0


def test_without_an_origin_it_lies_nowhere(netcdf) -> None:
    with pytest.raises(BadSolid, match=r"give origin_lat_deg and origin_lon_deg in \[world\]"):
        netcdf(LAT, LON, -DEPTH, None)


# -- triangles --------------------------------------------------------------------------------------------------------------------------


def plane(rows: int, columns: int) -> Grid:
    north, east = np.meshgrid(np.arange(float(rows)), np.arange(float(columns)), indexing="ij")
    return Grid(north, east, 20.0 + 0.5 * north - 0.25 * east)


def test_each_cell_is_two_triangles_that_look_up() -> None:
    (mesh,) = triangulate(plane(4, 6))
    assert mesh.oriented
    assert mesh.vertices.shape == (24, 3)
    assert mesh.faces.shape == (2 * 3 * 5, 3)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    assert (normals[:, 2] < 0.0).all()
    assert 0.5 * np.abs(normals[:, 2]).sum() == pytest.approx(3 * 5)
    assert mesh.vertices[:, 2] == pytest.approx(20.0 + 0.5 * mesh.vertices[:, 0] - 0.25 * mesh.vertices[:, 1])


@pytest.mark.parametrize(("rows", "columns", "tiles"), [(5, 5, 1), (6, 5, 2), (9, 9, 4), (10, 5, 3)])
def test_tiles_share_the_points_of_their_border(
    rows: int, columns: int, tiles: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bathymetry, "TILE_CELLS", 4)
    meshes = triangulate(plane(rows, columns))
    assert len(meshes) == tiles
    assert sum(len(mesh.faces) for mesh in meshes) == 2 * (rows - 1) * (columns - 1)
    area = 0.0
    for mesh in meshes:
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        area += 0.5 * np.abs(np.cross(b - a, c - a)[:, 2]).sum()
    assert area == pytest.approx((rows - 1) * (columns - 1))


VALUES = np.arange(35.0).reshape(5, 7)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f4", ">i8", "<u2"])
@pytest.mark.parametrize("part", [np.s_[0:5, 0:7], np.s_[1:3, 2:6], np.s_[4:5, 0:1], np.s_[2:2, 0:7]])
def test_a_part_is_that_of_numpy(order: str, dtype: str, part: tuple[slice, slice], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.asarray(VALUES, dtype=dtype, order=order))
    with (tmp_path / "a.npy").open("rb") as file:
        array = Array.of(file, "a.npy")
        found = array.read(file, *part)
    assert array.shape == (5, 7)
    assert found.dtype == dtype
    assert np.array_equal(found, VALUES[part])


def test_a_file_that_is_cut_while_it_is_read_is_told(tmp_path: Path) -> None:
    """A mapped one would end the process by a signal."""
    np.save(tmp_path / "a.npy", np.zeros((1000, 100)))
    with (tmp_path / "a.npy").open("rb") as file:
        array = Array.of(file, "a.npy")
        (tmp_path / "a.npy").open("wb").close()
        with pytest.raises(BadSolid, match="became shorter while it was read"):
            array.read(file, slice(500, 1000), slice(0, 100))


def test_a_later_version_of_the_format_is_refused_as_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x03\x00" + bytes(100))
    with (tmp_path / "a.npy").open("rb") as file, pytest.raises(BadSolid, match="array of numbers"):
        Array.of(file, "a.npy")
