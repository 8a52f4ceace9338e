"""Draws the sea floor under the tracks as a picture from above, and finds the outlines of structures."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uwserver.frames import matrix
from uwserver.physics.geometry.shapes import (
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Placed,
    Solid,
    Sphere,
    TriangleMesh,
)
from uwserver.ports.pictures import png
from uwserver.recording.report.reading import FloatArray
from uwserver.scenario.scene.scenery import SEABED_NAME

PIXELS = 640
"""Length of the longer side of the picture."""
_MOST_VERTICES = 200_000
"""Largest number of vertices that are interpolated, of a surface that is not a grid."""
_MOST_CORNERS = 5_000
_CIRCLE = 24

Area = tuple[float, float, float, float]
"""South, north, west, east, m in N."""


@dataclass(frozen=True)
class SeaFloor:
    """A picture of the sea floor.

    Attributes:
        area: area of the picture.
        png: bytes of the picture; north is up.
        shallow, deep: depths at both ends of the colour scale, m.
        contour: depth between contour lines, m.
        depths: (rows, columns) m, the first row in the south; NaN where there is no floor.
    """

    area: Area
    png: bytes
    shallow: float
    deep: float
    contour: float
    depths: FloatArray

    def below(self, north: FloatArray, east: FloatArray) -> FloatArray:
        """Return the depth of the floor at places (n), m; NaN outside the picture."""
        south, top, west, right = self.area
        rows, columns = self.depths.shape
        i = np.rint((north - south) / (top - south) * (rows - 1)).astype(int)
        j = np.rint((east - west) / (right - west) * (columns - 1)).astype(int)
        inside = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
        found: FloatArray = np.full(north.shape, np.nan)
        found[inside] = self.depths[i[inside], j[inside]]
        return found


def sea_floor(solids: Mapping[str, Solid], area: Area) -> SeaFloor | float | None:
    """Return a picture of the floor of an area, or the depth of a flat floor, m; None in open water."""
    solid = solids.get(f"static/{SEABED_NAME}")
    if solid is None:
        return None
    flat = [placed.p[2] for placed in solid.shapes if isinstance(placed.shape, HalfSpace)]
    if flat:
        return float(flat[0])
    points = [corners(placed) for placed in solid.shapes if isinstance(placed.shape, TriangleMesh)]
    if not points:
        return None
    vertices = np.concatenate(points)
    area = _within(area, vertices)
    south, north, west, east = area
    if not (north > south and east > west):
        return None
    scale = PIXELS / max(north - south, east - west)
    rows, columns = (max(2, round(side * scale)) for side in (north - south, east - west))
    depths = _interpolated(vertices, np.linspace(south, north, rows), np.linspace(west, east, columns))
    if not np.isfinite(depths).any():
        return None
    shallow, deep = float(np.nanmin(depths)), float(np.nanmax(depths))
    contour = _round_step(deep - shallow)
    picture = _coloured(depths, shallow, deep, contour, (north - south) / rows)
    return SeaFloor(area, png(picture[::-1]), shallow, deep, contour, depths)


def outlines(solids: Mapping[str, Solid]) -> list[tuple[str, FloatArray]]:
    """Return names and outlines (n, 2), north and east, of the structures: the convex hulls of their shapes, seen from above."""
    found = []
    for name, solid in solids.items():
        if name.startswith("static/") and name != f"static/{SEABED_NAME}":
            every = (corners(placed) for placed in solid.shapes)
            some = (points[:: max(1, len(points) // _MOST_CORNERS), :2] for points in every if len(points))
            found += [(name.removeprefix("static/"), hull(points)) for points in some]
    return found


def corners(placed: Placed) -> FloatArray:
    """Return points (n, 3) whose hull contains a shape, approximately; none for an infinite plane."""
    shape = placed.shape
    if isinstance(shape, Box):
        local = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * np.array(shape.half)
    elif isinstance(shape, Cylinder | Capsule):
        turn = np.linspace(0.0, 2.0 * np.pi, _CIRCLE, endpoint=False)
        ring = shape.radius * np.column_stack([np.cos(turn), np.sin(turn)])
        reach = shape.half_length + (shape.radius if isinstance(shape, Capsule) else 0.0)
        local = np.concatenate([np.column_stack([np.full(_CIRCLE, x), ring]) for x in (-reach, reach)])
    elif isinstance(shape, Sphere):
        turn = np.linspace(0.0, 2.0 * np.pi, _CIRCLE, endpoint=False)
        ring = shape.radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(_CIRCLE)])
        ball: FloatArray = np.concatenate([ring, ring[:, [0, 2, 1]]]) + np.array(
            placed.p
        )  # not turned: one ring must stay level
        return ball
    elif isinstance(shape, TriangleMesh | ConvexHull):
        local = shape.vertices if isinstance(shape, TriangleMesh) else shape.points
    else:
        return np.zeros((0, 3))
    found: FloatArray = local @ np.array(matrix(placed.q)).T + np.array(placed.p)
    return found


def _within(area: Area, vertices: FloatArray) -> Area:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    south, north, west, east = area
    return max(south, float(low[0])), min(north, float(high[0])), max(west, float(low[1])), min(east, float(high[1]))


def _interpolated(vertices: FloatArray, north: FloatArray, east: FloatArray) -> FloatArray:
    """Return depths (rows, columns) at these coordinates north and east, by interpolation between vertices."""
    x, i = np.unique(vertices[:, 0], return_inverse=True)
    y, j = np.unique(vertices[:, 1], return_inverse=True)
    if len(x) * len(y) <= 4 * len(vertices) and len(x) > 1 and len(y) > 1:  # a grid in tiles, which share their edges
        grid = np.full((len(x), len(y)), np.nan)
        grid[i, j] = vertices[:, 2]
        if np.isfinite(grid).all():
            from scipy.interpolate import RegularGridInterpolator

            points = np.stack(np.meshgrid(north, east, indexing="ij"), axis=-1)
            found: FloatArray = RegularGridInterpolator((x, y), grid, bounds_error=False)(points)
            return found
    from scipy.interpolate import LinearNDInterpolator

    some = vertices[:: max(1, len(vertices) // _MOST_VERTICES)]
    rows, columns = np.meshgrid(north, east, indexing="ij")
    between: FloatArray = LinearNDInterpolator(some[:, :2], some[:, 2])(rows, columns)
    return between


def _round_step(span: float) -> float:
    """Return a step that gives about twelve contours: 1, 2 or 5 times a power of ten."""
    rough = max(span / 12.0, 1e-3)
    power = 10.0 ** np.floor(np.log10(rough))
    return float(power * next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= rough))


_SHALLOW, _DEEP = np.array([196.0, 226.0, 222.0]), np.array([22.0, 62.0, 96.0])


def _coloured(depths: FloatArray, shallow: float, deep: float, contour: float, metres: float) -> npt.NDArray[np.uint8]:
    """Return RGBA (rows, columns, 4): lit from the north-west, with darker contours, transparent where there is no floor."""
    part = np.clip((depths - shallow) / max(deep - shallow, 1e-6), 0.0, 1.0)[..., None]
    rgb = _SHALLOW + (_DEEP - _SHALLOW) * np.nan_to_num(part)
    slope_n, slope_e = np.gradient(np.nan_to_num(depths, nan=deep), metres)
    light = np.clip(1.0 + 0.5 * (slope_n - slope_e) / np.sqrt(1.0 + slope_n**2 + slope_e**2), 0.6, 1.35)
    band = np.floor(
        depths / contour + 1e-6
    )  # so that rounding draws no lines on a level floor at the depth of a contour
    line = np.zeros(depths.shape, dtype=bool)
    line[:, 1:] |= band[:, 1:] != band[:, :-1]
    line[1:] |= band[1:] != band[:-1]
    light = np.where(line & np.isfinite(depths), light * 0.8, light)
    shaded = np.clip(rgb * light[..., None], 0.0, 255.0)
    opaque = np.where(np.isfinite(depths), 255.0, 0.0)[..., None]
    found: npt.NDArray[np.uint8] = np.rint(np.concatenate([shaded, opaque], axis=2)).astype(np.uint8)
    return found


def data_url(picture: bytes) -> str:
    """Return a data URL with a PNG."""
    return "data:image/png;base64," + base64.b64encode(picture).decode()


def hull(points: FloatArray) -> FloatArray:
    """Return the convex hull of points (n, 2), counter-clockwise; of points on a line, those in their order."""
    from scipy.spatial import ConvexHull, QhullError

    distinct: FloatArray = np.unique(points, axis=0)
    try:
        found: FloatArray = distinct[ConvexHull(distinct).vertices]
    except (QhullError, ValueError):  # fewer than three points, or all on a line
        return distinct
    return found
