"""Reads grids of depth (.npy in metres, NetCDF in latitude and longitude), and splits them into triangles and tiles.

The files are not memory-mapped: if a mapped file is truncated meanwhile, the process is killed.
"""

from __future__ import annotations

import importlib
import io
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import numpy as np
from msgspec import UNSET

from uwserver.environment.earth import north_east
from uwserver.packages import install_command
from uwserver.physics.geometry.shapes import TILE_TRIANGLES, BadSolid, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.scenario.files.documents import is_plain, opened, why_not
from uwserver.scenario.solids.memory import check_memory
from uwserver.scenario.solids.tables import GridSeabed
from uwserver.units import deg, rad

MOST_POINTS = 4_000_000
"""Most points of a grid within `extent_m`: 8 million triangles."""
MOST_BYTES = 1_000_000_000
"""Largest classic NetCDF file."""
DEEPEST_M = 20_000.0
"""Largest distance from sea level, up or down; no place on Earth is farther."""
_DEGREE = rad(1.0) * 6_356_752.0
"""Shortest degree of latitude on the Earth, m; a degree of longitude at the equator is longer."""
_HALF_TURN = deg(math.pi)
TILE_CELLS = int((TILE_TRIANGLES / 2) ** 0.5)
"""Most cells along the edge of a tile."""
_HEAD_BYTES = 16_384
"""Most bytes of a header; that of an array of numbers has 128."""


class Grid(NamedTuple):
    """Points (n, m) of a seabed in N, m: rows to the north, columns to the east; depth positive down."""

    north: FloatArray
    east: FloatArray
    depth: FloatArray


def read_grid(table: GridSeabed, path: Path, origin: tuple[float, float] | None) -> Grid:
    """Read the grid that a table names.

    Args:
        table: table of the scenario.
        path: path of its file.
        origin: latitude and longitude (deg) of N's origin, if the scenario has them.

    Raises:
        BadSolid: the file is missing, unreadable, of a wrong form or size, lacks a variable, or has depths that are not finite.
    """
    if not is_plain(path):
        raise BadSolid(f'there is no grid file "{path}"{why_not(path)}')
    suffix = path.suffix.lower()
    if suffix == ".npy":
        grid = _from_numpy(table, path)
    elif suffix in (".nc", ".grd"):
        grid = _from_netcdf(table, path, origin)
    else:
        raise BadSolid(f'"{path.name}" has an unknown file type: use .npy or .nc')
    if table.extent_m is not UNSET:
        grid = _within(grid, table.extent_m)
    if min(grid.depth.shape) < 2:
        rows, columns = grid.depth.shape
        raise BadSolid(f'"{path.name}" has {rows} x {columns} points within extent_m; at least 2 x 2 are needed')
    if grid.depth.size > MOST_POINTS:
        raise _too_many(path, grid.depth.size)
    bad = int((~np.isfinite(grid.depth)).sum())
    if bad:
        raise BadSolid(f'{bad} of {grid.depth.size} depths in "{path.name}" are not finite: fill these gaps')
    far = int((np.abs(grid.depth) > DEEPEST_M).sum())
    if far:
        text = f"are more than {DEEPEST_M:g} m from sea level: fill these gaps, or set fill value and scale in the file"
        raise BadSolid(f'{far} of {grid.depth.size} depths in "{path.name}" {text}')
    return grid


def triangulate(grid: Grid) -> tuple[TriangleMesh, ...]:
    """Return two triangles for each cell, with their outside up, in tiles of at most `TILE_CELLS` cells a side.

    Neighbouring tiles repeat the points of their border exactly, so there is no gap.
    """
    points = np.stack(grid, axis=-1)
    rows, columns = grid.depth.shape
    meshes = []
    for i in range(0, rows - 1, TILE_CELLS):
        for j in range(0, columns - 1, TILE_CELLS):
            part = points[i : i + TILE_CELLS + 1, j : j + TILE_CELLS + 1]
            n, m = part.shape[:2]
            k = np.arange(n * m).reshape(n, m)
            a, b, c, d = k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]
            faces = np.stack([np.stack([a, d, b], axis=-1), np.stack([b, d, c], axis=-1)], axis=2).reshape(-1, 3)
            meshes.append(TriangleMesh(np.ascontiguousarray(part.reshape(-1, 3)), faces))
    return tuple(meshes)


def _from_numpy(table: GridSeabed, path: Path) -> Grid:
    if table.spacing_m is UNSET:
        raise BadSolid(f'"{path.name}" needs spacing_m: give the distance of its rows and that of its columns')
    try:
        with opened(path) as file:
            whole = Array.of(file, path.name)
            part, axes = _in_reach(table, table.spacing_m, whole.shape)
            points = math.prod(p.stop - p.start for p in part)
            if points > MOST_POINTS:
                raise _too_many(path, math.prod(whole.shape))
            check_memory(path.name, 2 * points)
            depth = whole.read(file, *part).astype(np.float64)
    except OSError as error:
        raise BadSolid(f'cannot read "{path.name}": {error.strerror}') from error
    north, east = np.meshgrid(*axes, indexing="ij")
    return Grid(north, east, -depth if table.values == "elevation" else depth)


def _in_reach(
    table: GridSeabed, spacing: tuple[float, float], shape: tuple[int, int]
) -> tuple[list[slice], list[FloatArray]]:
    """Return the rows and columns to read, and their places in N, m. The file may be much larger than the part within `extent_m`."""
    extent = [(n - 1) * step for n, step in zip(shape, spacing, strict=True)]
    first = [-0.5 * e for e in extent] if table.origin_north_east_m is UNSET else list(table.origin_north_east_m)
    part: list[slice] = []
    axes: list[FloatArray] = []
    for f, step, n in zip(first, spacing, shape, strict=True):
        low, high = 0, n
        if table.extent_m is not UNSET:
            # A little more than `_within` keeps, as the places are rounded; then exactly what it keeps.
            low = int(min(max(math.floor((-table.extent_m - f) / step) - 2, 0), n))
            high = int(min(max(math.ceil((table.extent_m - f) / step) + 3, low), n, low + MOST_POINTS + 9))
            near = low + np.flatnonzero(np.abs(f + step * np.arange(low, high)) <= table.extent_m)
            low, high = (max(int(near[0]) - 1, 0), min(int(near[-1]) + 2, n)) if len(near) else (low, low)
        part.append(slice(low, high))
        axes.append(f + step * np.arange(low, min(high, low + MOST_POINTS + 1), dtype=np.float64))
    return part, axes


def _from_netcdf(table: GridSeabed, path: Path, origin: tuple[float, float] | None) -> Grid:
    if origin is None:
        raise BadSolid(
            f'"{path.name}" is in latitude and longitude, so N needs a place: give origin_lat_deg and origin_lon_deg in [world]'
        )
    with _opened(path) as variables:
        names = (table.latitude, table.longitude, table.variable)
        missing = [name for name in names if name not in variables]
        if missing:
            there = ", ".join(sorted(variables)) or "none"
            text = f'"{path.name}" has no variable {" and no ".join(missing)}; there are: {there}'
            raise BadSolid(f"{text}; name them by variable, latitude and longitude")
        for name in names:
            _check_variable(path, name, variables[name])
        axes = [_scaled(variables[name], np.s_[...]) for name in names[:2]]
        shape = tuple(variables[table.variable].shape)
        if any(axis.ndim != 1 for axis in axes) or shape != tuple(len(axis) for axis in axes):
            raise BadSolid(
                f'"{path.name}": {table.variable} has the shape {shape}, but must be latitudes by longitudes'
            )
        for name, axis in zip(names, axes, strict=False):
            steps = np.diff(axis)
            if not (np.isfinite(axis).all() and ((steps > 0.0).all() or (steps < 0.0).all())):
                raise BadSolid(f'"{path.name}": {name} must rise from value to value, or fall')
            if len(axis) and np.abs(axis).max() > 4.0 * _HALF_TURN:
                raise BadSolid(f'"{path.name}": {name} must be in degrees, but goes up to {np.abs(axis).max():g}')
        part = _window(axes, origin, table)
        points = math.prod(len(axis[p]) for axis, p in zip(axes, part, strict=True))
        if points > MOST_POINTS:
            raise _too_many(path, shape)
        check_memory(path.name, 2 * points)
        # A global grid is never read whole.
        values = _scaled(variables[table.variable], part)
    latitude, longitude = (axis[p] for axis, p in zip(axes, part, strict=True))
    if len(latitude) and latitude[0] > latitude[-1]:
        latitude, values = latitude[::-1], values[::-1]
    if len(longitude) and longitude[0] > longitude[-1]:
        longitude, values = longitude[::-1], values[:, ::-1]
    places = np.meshgrid(latitude * rad(1.0), longitude * rad(1.0), indexing="ij")
    north, east = north_east(*places, rad(origin[0]), rad(origin[1]))
    return Grid(north, east, values if table.values == "depth" else -values)


def _too_many(path: Path, points: object) -> BadSolid:
    return BadSolid(
        f'"{path.name}" has {points} points; at most {MOST_POINTS} are allowed: set extent_m, or thin the grid out'
    )


def _window(axes: list[FloatArray], origin: tuple[float, float], table: GridSeabed) -> tuple[slice, slice]:
    """Return the rows and columns to read: a little more than `extent_m`, to which `_within` reduces them exactly."""
    if table.extent_m is UNSET:
        return slice(None), slice(None)
    reach = 1.05 * float(table.extent_m) / _DEGREE
    away = (
        np.abs(axes[0] - origin[0]),
        np.abs(np.remainder(axes[1] - origin[1] + _HALF_TURN, 2 * _HALF_TURN) - _HALF_TURN) * np.cos(rad(origin[0])),
    )
    kept = [np.flatnonzero(a <= reach) for a in away]
    first = [slice(max(int(k[0]) - 1, 0), int(k[-1]) + 2) if len(k) else slice(0, 0) for k in kept]
    return first[0], first[1]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a NetCDF file and give its variables. scipy reads the classic form (version 3), h5netcdf the one on HDF5 (version 4)."""
    try:
        with opened(path) as file:
            classic = file.read(3) == b"CDF"
            size = os.fstat(file.fileno()).st_size
    except OSError as error:
        raise BadSolid(f'cannot read "{path.name}": {error.strerror}') from error
    if classic and size > MOST_BYTES:  # scipy reads the whole file
        text = f"has {size / 1e6:.0f} MB; at most {MOST_BYTES / 1e6:.0f} MB are allowed: save it as NetCDF 4, which is read in parts"
        raise BadSolid(f'"{path.name}" {text}')
    modules = ("scipy.io",) if classic else ("h5netcdf", "h5py")
    try:
        reader, *below = (cast("Any", importlib.import_module(name)) for name in modules)
    except ImportError as error:
        extra = "solid" if classic else "netcdf"
        raise BadSolid(f'"{path.name}" needs the extra "{extra}": {install_command(f"uwserver[{extra}]")}') from error
    try:
        if classic:
            with reader.netcdf_file(str(path), mmap=False) as file:
                yield file.variables
        else:
            with below[0].File(path, "r") as whole:
                # h5netcdf reads this attribute first. If it failed there, its half-opened object would print a traceback when it is deleted.
                whole.attrs.get("_nc3_strict")
                with reader.File(whole, "r") as file:
                    yield file.variables
    except BadSolid:
        raise
    except Exception as error:  # a parser of foreign files may raise anything
        raise BadSolid(f'cannot read "{path.name}": {type(error).__name__}: {error}') from error


def _check_variable(path: Path, name: str, variable: Any) -> None:
    """Check that a variable reads no other files, and that a small file cannot ask for unlimited memory.

    Raises:
        BadSolid: it does.
    """
    dataset = getattr(variable, "_h5ds", None)  # h5netcdf has no public name for it
    if dataset is not None and (dataset.external or dataset.is_virtual):
        raise BadSolid(f'"{path.name}": the values of {name} are in other files: copy them into this file')
    if math.prod(getattr(variable, "chunks", None) or ()) > MOST_POINTS:
        raise BadSolid(
            f'"{path.name}": {name} is in chunks of {variable.chunks}; at most {MOST_POINTS} points are allowed: save it with smaller chunks'
        )
    if len(variable.shape) == 1 and variable.shape[0] > MOST_POINTS:
        raise _too_many(path, variable.shape[0])


def _scaled(variable: Any, part: Any) -> FloatArray:
    """Return a part of a variable, scaled by its attributes; fill values become NaN."""
    # h5netcdf has attrs; scipy has the attributes on the variable itself.
    attributes = variable.attrs if hasattr(variable, "attrs") else vars(variable)
    values = np.array(variable[part], dtype=np.float64)
    for name in ("_FillValue", "missing_value"):
        if name in attributes:
            values[values == _number(attributes[name])] = np.nan
    return values * _number(attributes.get("scale_factor", 1.0)) + _number(attributes.get("add_offset", 0.0))


def _number(attribute: Any) -> float:
    return float(np.asarray(attribute).ravel()[0])


def _within(grid: Grid, extent: float) -> Grid:
    """Return the rows and columns that come within `extent` (m) of the origin to north and east, and one more on each side for the border."""
    rows = np.flatnonzero((np.abs(grid.north) <= extent).any(axis=1))
    columns = np.flatnonzero((np.abs(grid.east) <= extent).any(axis=0))
    if not len(rows) or not len(columns):
        raise BadSolid(f"no point of the grid is within {extent:g} m of the origin of N: check the origin and extent_m")
    part = np.s_[max(rows[0] - 1, 0) : rows[-1] + 2, max(columns[0] - 1, 0) : columns[-1] + 2]
    return Grid(*(values[part] for values in grid))


@dataclass(frozen=True)
class Array:
    """A two-dimensional array of numbers in a file.

    Attributes:
        name: name of the file.
        shape: rows and columns.
        dtype: type of a number.
        by_columns: whether columns are contiguous, not rows.
        offset: position of the first number, bytes.
    """

    name: str
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    by_columns: bool
    offset: int

    @classmethod
    def of(cls, file: IO[bytes], name: str) -> Array:
        """Read the header, and compare it with the length of the file; `name` is for errors.

        Raises:
            BadSolid: the file does not hold such an array, or is too short.
        """
        head = io.BytesIO(file.read(_HEAD_BYTES))
        readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        try:
            version = np.lib.format.read_magic(head)
            shape, by_columns, dtype = readers[version](head)
        except KeyError:
            raise BadSolid(f'"{name}" must hold an array of numbers, in version 1 or 2 of the .npy format') from None
        except Exception as error:  # the parser of a header may raise anything
            raise BadSolid(f'"{name}" is not an array in .npy format: {error}') from error
        if len(shape) != 2 or dtype.kind not in "fiu":
            raise BadSolid(f'"{name}" must hold an array of numbers with rows and columns')
        there, needed = os.fstat(file.fileno()).st_size - head.tell(), math.prod(shape) * dtype.itemsize
        if there < needed or min(shape) < 0:
            text = f"should hold {shape[0]} x {shape[1]} numbers in {needed} bytes, but has only {there}"
            raise BadSolid(f'"{name}" {text}')
        return cls(name, shape, dtype, bool(by_columns), head.tell())

    def read(self, file: IO[bytes], rows: slice, columns: slice) -> np.ndarray[Any, Any]:
        """Read a part of the array; both slices have a start and a stop.

        Raises:
            BadSolid: the file became shorter meanwhile.
        """
        outer, inner, length = (columns, rows, self.shape[0]) if self.by_columns else (rows, columns, self.shape[1])
        part = np.empty((outer.stop - outer.start, inner.stop - inner.start), self.dtype)
        for k, line in enumerate(part, outer.start):
            file.seek(self.offset + (k * length + inner.start) * self.dtype.itemsize)
            if file.readinto(line.view(np.uint8)) < line.nbytes:  # type: ignore[attr-defined]  # every buffered file has it
                raise BadSolid(f'"{self.name}" became shorter while it was read: load it again')
        return part.T if self.by_columns else part
