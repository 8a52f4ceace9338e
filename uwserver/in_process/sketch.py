"""A small picture and table of a world, for notebooks: the bodies and structures from above and from the east, as SVG."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from uwserver.frames import matrix
from uwserver.in_process.vehicles import Vehicle
from uwserver.physics.geometry.shapes import Box, Capsule, HalfSpace, Placed, Solid, Sphere, TriangleMesh
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.ports.scene import NOWHERE_M, ShapeView
from uwserver.recording.report.bathymetry import corners, hull
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.scene.scenery import SEABED_NAME
from uwserver.scenario.scene.shapes import displaced_shapes
from uwserver.scenario.solids.appearance import VEHICLE

WIDE, HIGH = 320.0, 220.0
"""Size of each of the two pictures, pixels."""
LEAST_M = 5.0
"""Smallest width of a picture."""
NEAR = 4.0
"""Structures, surface and bottom are in the picture if it becomes at most so many times as wide by that."""
ROWS = 8
"""Bodies in the table."""
_VERTICES = 400
_COLUMNS = 64
_FONT = 'font-family="sans-serif" font-size="10"'


class Outline(NamedTuple):
    """A solid in N.

    Attributes:
        name: name of the body or structure; "" to leave it out.
        points: (n, 3), whose hull contains it, m.
        is_body: whether it moves.
    """

    name: str
    points: FloatArray
    is_body: bool


class View(NamedTuple):
    """One picture: what is across and down in it.

    Attributes:
        title: title of the picture.
        across, down: number of the axis in N, and its sign.
    """

    title: str
    across: tuple[int, int]
    down: tuple[int, int]

    def of(self, points: FloatArray) -> FloatArray:
        """Return points (n, 3) of N as (n, 2), m."""
        (i, s), (j, t) = self.across, self.down
        return np.column_stack([s * points[:, i], t * points[:, j]])


VIEWS = (View("from above, north up", (1, 1), (0, -1)), View("from the east, north to the right", (0, 1), (2, 1)))


def world_html(resolved: Resolved, vehicles: Mapping[str, Vehicle], likes: Mapping[str, str], title: str) -> str:
    """Return picture and table of a world.

    Args:
        resolved: its scenario.
        vehicles: its bodies.
        likes: by the name of a body that was added, that of the body of the scenario which it is a copy of.
        title: text above the picture.
    """
    here = {name: body for name, body in vehicles.items() if -body.p_NB[2] < NOWHERE_M}
    solids = body_solids(resolved)
    outlines = [Outline(name, _moved(solids[likes.get(name, name)], body), is_body=True) for name, body in here.items()]
    outlines += [
        Outline(name, _points(solid), is_body=False) for name, solid in resolved.static.items() if name != SEABED_NAME
    ]
    seabed = resolved.static.get(SEABED_NAME)
    pictures = "".join(_picture(view, outlines, seabed) for view in VIEWS) if here else ""
    return f"<div><b>{escape(title)}</b><br>{pictures}{_table(here)}</div>"


def body_solids(resolved: Resolved) -> dict[str, Solid]:
    """Return the shape in B of each body of a scenario: what it collides with, or what displaces water."""
    solids = {name: body.solid for name, body in resolved.objects.items()}
    for name, vehicle in resolved.vehicles.items():
        solids[name] = vehicle.solid or vehicle.ghost or _displaced(displaced_shapes(vehicle.vehicle, VEHICLE))
    return solids


def _displaced(shapes: Iterable[ShapeView]) -> Solid:
    placed = []
    for shape in shapes:
        form: Box | Sphere | Capsule
        if shape.size is not None:
            x, y, z = shape.size
            form = Box((x / 2.0, y / 2.0, z / 2.0))
        elif shape.length is not None:
            form = Capsule(shape.radius or 0.0, shape.length / 2.0)
        else:
            form = Sphere(shape.radius or 0.0)
        placed.append(Placed(form, shape.p, shape.q))
    return Solid("displaced", tuple(placed))


def _points(solid: Solid) -> FloatArray:
    found = [corners(placed) for placed in solid.shapes]
    return np.concatenate([points[:: max(1, len(points) // _VERTICES)] for points in found] or [np.zeros((0, 3))])


def _moved(solid: Solid, body: Vehicle) -> FloatArray:
    turned: FloatArray = _points(solid) @ np.array(matrix(body.q_NB.tolist())).T + body.p_NB
    return turned if len(turned) else body.p_NB[None]


# -- the picture ------------------------------------------------------------------------------------------------------------------------


class _Frame:
    """The part of a view that is drawn, and its scale."""

    def __init__(self, low: FloatArray, high: FloatArray) -> None:
        middle, extent = (low + high) / 2.0, np.maximum(1.25 * (high - low), (LEAST_M, LEAST_M * HIGH / WIDE))
        self.scale = float(min(WIDE / extent[0], HIGH / extent[1]))
        self._origin = middle - np.array([WIDE, HIGH]) / 2.0 / self.scale

    def pixels(self, points: FloatArray) -> FloatArray:
        found: FloatArray = (points - self._origin) * self.scale
        return found

    def across(self) -> FloatArray:
        """Return the coordinates of `_COLUMNS` columns."""
        found: FloatArray = self._origin[0] + np.linspace(0.0, WIDE / self.scale, _COLUMNS)
        return found


def _picture(view: View, outlines: Sequence[Outline], seabed: Solid | None) -> str:
    bodies = np.concatenate([view.of(outline.points) for outline in outlines if outline.is_body])
    low, high = bodies.min(axis=0), bodies.max(axis=0)
    most = NEAR * max(LEAST_M, float((high - low).max()))
    is_side = view.down[0] == 2
    further = [view.of(outline.points) for outline in outlines if not outline.is_body and len(outline.points)]
    if is_side:
        middle = (low[0] + high[0]) / 2.0
        depth = _depth(seabed, np.array([middle]), most)
        further += [np.array([[middle, z]]) for z in (0.0, *([] if depth is None else depth.tolist()))]
    for points in further:
        with_it = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        if float((with_it[1] - with_it[0]).max()) <= most:
            low, high = with_it
    frame = _Frame(low, high)
    parts = "".join(_drawn(view, frame, outlines, seabed, is_side))
    return (
        f'<svg width="{WIDE:g}" height="{HIGH:g}" viewBox="0 0 {WIDE:g} {HIGH:g}" style="margin:2px;max-width:100%" '
        f'xmlns="http://www.w3.org/2000/svg"><rect width="{WIDE:g}" height="{HIGH:g}" fill="#d3e8f0"/>{parts}'
        f'<text x="6" y="14" {_FONT} fill="#345">{view.title}</text>{_bar(frame)}</svg>'
    )


def _drawn(
    view: View, frame: _Frame, outlines: Sequence[Outline], seabed: Solid | None, is_side: bool
) -> Iterator[str]:
    if is_side:
        surface = float(frame.pixels(np.zeros((1, 2)))[0, 1])
        if surface > 0.0:
            yield f'<rect width="{WIDE:g}" height="{surface:.1f}" fill="#fbfdfe"/>'
        across = frame.across()
        depth = _depth(seabed, across, HIGH / frame.scale)
        if depth is not None:
            line = frame.pixels(np.column_stack([across, depth]))
            yield f'<polygon points="{_text(line)} {WIDE:g},{HIGH:g} 0,{HIGH:g}" fill="#cbb994"/>'
    for outline in sorted(outlines, key=lambda each: each.is_body):
        if len(outline.points):
            points = frame.pixels(hull(view.of(outline.points)))
            fill = 'fill="#e0a030" stroke="#704800"' if outline.is_body else 'fill="#8a949c" fill-opacity="0.6"'
            yield f'<polygon points="{_text(points)}" {fill}/>' if len(points) > 2 else ""
    named = [outline for outline in outlines if outline.is_body]
    for outline in named:
        if len(named) <= ROWS:
            x, y = frame.pixels(view.of(outline.points)).min(axis=0)
            yield f'<text x="{x:.1f}" y="{max(y - 3.0, 24.0):.1f}" {_FONT} fill="#222">{escape(outline.name)}</text>'


def _depth(seabed: Solid | None, north: FloatArray, window: float) -> FloatArray | None:
    """Return the depth of the bottom at places from south to north, m; None without one. A rough bottom is averaged over `window`."""
    if seabed is None:
        return None
    planes = [placed.p[2] for placed in seabed.shapes if isinstance(placed.shape, HalfSpace)]
    if planes:
        return np.full(len(north), min(planes))
    tiles = [corners(placed) for placed in seabed.shapes if isinstance(placed.shape, TriangleMesh)]
    if not tiles:
        return None
    points = np.concatenate(tiles)
    near = points[np.abs(points[:, 0] - north.mean()) <= max(window, float(np.ptp(north)))]
    bins: FloatArray = np.unique(near[:, 0])
    if not len(bins):
        return None
    sums = np.zeros(len(bins))
    places = np.searchsorted(bins, near[:, 0])
    np.add.at(sums, places, near[:, 2])
    return np.interp(north, bins, sums / np.bincount(places))


def _text(points: FloatArray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in np.clip(points, -1e4, 1e4).tolist())


def _bar(frame: _Frame) -> str:
    """Return a bar of a round length, about a quarter of the width."""
    ideal = WIDE / 4.0 / frame.scale
    power = 10.0 ** math.floor(math.log10(ideal))
    length = max(step for step in (power, 2.0 * power, 5.0 * power) if step <= ideal)
    end = 8.0 + length * frame.scale
    return (
        f'<path d="M8,{HIGH - 8:g} H{end:.1f}" stroke="#345" stroke-width="2"/>'
        f'<text x="{end + 4:.1f}" y="{HIGH - 5:g}" {_FONT} fill="#345">{length:g} m</text>'
    )


def _table(bodies: Mapping[str, Vehicle]) -> str:
    head = "".join(
        f"<th>{word}</th>" for word in ("", "model", "north, m", "east, m", "down, m", "yaw, rad", "speed, m/s")
    )
    rows = []
    for name, body in [*bodies.items()][:ROWS]:
        numbers = (*body.p_NB.tolist(), float(body.rpy[2]), math.hypot(*body.v_NB_B.tolist()))
        cells = "".join(f'<td style="text-align:right">{number + 0.0:.2f}</td>' for number in numbers)
        rows.append(f"<tr><td>{escape(name)}</td><td>{escape(body.model)}</td>{cells}</tr>")
    more = f"and {len(bodies) - ROWS} more" if len(bodies) > ROWS else ""
    return f"<table><tr>{head}</tr>{''.join(rows)}</table>{more}"
