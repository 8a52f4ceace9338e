"""Makes a picture: from a snapshot of a world to light on the chip. It only changes its own arrays, so a worker thread can do it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uwserver.environment.light import AIR, WaterLight
from uwserver.frames import Vec3, matrix, multiply, rotate
from uwserver.physics.kernel.arrays import FloatArray
from uwserver.sensors.job import Pieces, whole
from uwserver.sensors.optical.camera import formation, rays, snow
from uwserver.sensors.optical.camera.lamps import (
    COARSE,
    LAMP,
    RANGES,
    SHADOW,
    candelas,
    exponent_of,
    light_rays,
    veil_of,
)
from uwserver.sensors.optical.camera.lens import WATER_INDEX, FlatPort, Lens, Window, outside
from uwserver.sensors.optical.camera.rays import Balls, Cone, cone_of
from uwserver.sensors.optical.camera.view import View, quat_of
from uwserver.sensors.optical.camera.visible import Plane, Visible

_LEAST_LUX = 0.02
"""Shadows of a lamp are left out where its light is weaker than this."""
_SHADOWED = 0.03
"""They are also left out where its light is weaker than this part of the daylight."""
_SNOW_REACH_M = 2.0
_PIECE = 1 << 15
"""Pixels in a band of rows, about. A band is cast and lit in one piece, which takes a few milliseconds."""


class Optics:
    """A lens behind its port: the rays of all pixels, in water and in air, and the arrays for one picture at a time."""

    def __init__(self, lens: Lens, window: Window, snow_density: float = 0.0, seat: Vec3 = (0.0, 0.0, 0.0)) -> None:
        """Prepare a camera at the position `seat` on its body (B, m).

        Raises:
            ValueError: no light reaches a pixel.
        """
        self.lens, self._window, self._seat = lens, window, np.array(seat)
        self._bundles: dict[bool, tuple[Any, Any, Cone]] = {}
        self._directions = lens.table()
        self._bundle(True)
        rows = max(_PIECE // lens.width // COARSE, 1) * COARSE
        self.buffers = rays.Buffers(lens.width * lens.height, rows * lens.width)
        self._bands = [
            (
                slice(row, row + rows),
                place := slice(row * lens.width, (row + rows) * lens.width),
                self.buffers.part(place),
            )
            for row in range(0, lens.height, rows)
        ]
        self.radiance: Any = np.zeros((lens.width * lens.height, 3), np.float32)
        self._flakes = snow.flakes(snow_density)
        self._known: tuple[Visible, list[rays.Placed]] | None = None

    def _bundle(self, wet: bool) -> tuple[Any, Any, Cone]:
        """Return directions and origins of all pixels in S, float32, and the cone around them."""
        if wet not in self._bundles:
            found = outside(self._window, self._directions, WATER_INDEX if wet else 1.0)
            origin = found.origin if self._window is not None else np.zeros((1, 3))
            self._bundles[wet] = (
                found.direction.astype(np.float32),
                origin.astype(np.float32),
                cone_of(found.direction, origin),
            )
        return self._bundles[wet]

    def cast(self, view: View) -> Pieces[tuple[FloatArray, Any, Cone]]:
        """Find what each pixel sees. Returns the base of the picture (3, N), THING, and the cone of all rays."""
        width, visible = self.lens.width, view.scene.made()
        base = np.array(view.first.p)
        table, start, cone = self._bundle(view.depth > 0.0)
        R, p = _rows(view, self.lens.height, base)
        things, cone = visible.placed(view.state, base), _seen_from(cone, view)
        scenes = [placed for placed in self._scenes(view) if cone.meets(_balls(placed, things))]
        for rows, pixels, part in self._bands:
            begin = start if len(start) == 1 else start[pixels]
            rays.turn(table[pixels], begin, width, R[rows], p[rows], part.origin, part.direction)
            part.clear()
            for plane in visible.planes:
                _meet_plane(part, plane, base)
            for placed in scenes:
                part.cast(placed, things, visible.faces)
            yield
        rays.end_inside(self.buffers.direction, visible.faces, things, self.buffers.distance, self.buffers.face)
        return base, things, cone

    def _scenes(self, view: View) -> list[rays.Placed]:
        """Return the scenes that rays are cast at. Of the camera's own vehicle only faces towards the camera count: it is inside the others."""
        visible, own = view.scene.made(), view.own
        if self._known is None or self._known[0] is not visible:
            others = [placed for placed in visible.scenes if own < 0 or visible.rows[placed.thing] != own]
            mine = [
                visible.facing(placed, self._seat)
                for placed in visible.scenes
                if own >= 0 and visible.rows[placed.thing] == own
            ]
            self._known = visible, [*others, *(placed for placed in mine if placed is not None)]
        return self._known[1]

    def form(self, view: View, shadows: bool = True) -> Any:
        """Return the radiance (n, 3) of a picture, lux/sr. The next picture overwrites it."""
        return whole(self.light(view, shadows))

    def light(self, view: View, shadows: bool) -> Pieces[Any]:
        """Do the same as `form`, in pieces."""
        base, things, _ = yield from self.cast(view)
        lens, buffers, visible = self.lens, self.buffers, view.scene.made()
        north, east, down = base.tolist()
        water = view.water if view.depth > 0.0 else AIR
        sea = formation.sea_row(view.t, view.water, view.day, (north, east, down), view.depth, 1.0 / lens.fx)
        lamps = lamp_rows(view, base)
        cells = -(-lens.width // SHADOW) * -(-lens.height // SHADOW)
        lit: Any = np.ones((len(lamps), cells), np.uint8)
        if shadows:
            yield from self._shadows(view, things, lamps, lit, water)
        veil = veil_of(lamps[:0] if water is AIR else lamps, (buffers.origin, buffers.direction), lens.width, water)
        for rows, pixels, part in self._bands:
            formation.form(
                sea, part.origin, part.direction, part.distance, part.face, visible.faces, things, visible.centres,
                visible.atlas.texels, visible.atlas.levels, lamps, lit, veil, RANGES, lens.width, rows.start, self.radiance[pixels],
            )  # fmt: skip
            yield
        if len(self._flakes) and view.depth > 0.0:
            wide = lens.fx * (WATER_INDEX if isinstance(self._window, FlatPort) else 1.0)
            snow.add_flakes(
                self._flakes, snow.drifted((north, east, down), view.current, view.t), snow.CUBE_M, np.array(matrix(view.first.q)),
                np.array((wide, wide * lens.fy / lens.fx, lens.cx, lens.cy)), lens.width, lens.height, 0.5 * _SNOW_REACH_M, sea, lamps,
                buffers.distance, snow.ALBEDO, self.radiance,
            )  # fmt: skip
        return self.radiance

    def _shadows(self, view: View, things: Any, lamps: Any, lit: Any, water: WaterLight) -> Pieces[None]:
        """Set `lit` to 0 where lamps do not reach. The shapes of a vehicle cast no shadow of its own lamps."""
        buffers = self.buffers
        if not len(lamps):
            return
        cells = lit.shape[1]
        points, towards = np.empty((cells, 3), np.float32), np.empty((cells, 3), np.float32)
        reach: FloatArray = np.empty(cells)
        day = view.day.illuminance * math.exp(-min(water.fading) * max(view.depth, 0.0))
        for k in range(len(lamps)):
            least = max(_LEAST_LUX, _SHADOWED * day)
            light_rays(
                lamps[k : k + 1], buffers.origin, buffers.direction, buffers.distance, self.lens.width, SHADOW, least,
                min(water.dimming()), points, towards, reach,
            )  # fmt: skip
            for placed in view.scene.made().scenes:
                row = things["row"][placed.thing]
                if row < 0 or row != lamps["row"][k]:
                    for first in range(0, cells, buffers.piece):
                        some = slice(first, first + buffers.piece)
                        buffers.shade(placed, things, points[some], towards[some], reach[some], lit[k, some])
            yield

    def depth_mm(self, view: View) -> Any:
        """Return (h, w) uint16: distance along the optical axis from the pupil, mm; 0 if nothing is nearer than 65.5 m."""
        return whole(self.depths(view))

    def depths(self, view: View) -> Pieces[Any]:
        """Do the same as `depth_mm`, in pieces."""
        yield from self.cast(view)
        out: Any = np.empty(self.buffers.n, np.uint16)
        table, start, _ = self._bundle(view.depth > 0.0)
        rays.depths(table, start, self.buffers.distance, out)
        return out.reshape(self.lens.height, self.lens.width)

    def ids(self, view: View) -> tuple[Any, FloatArray]:
        """Return (h, w) uint16 ids of the objects, 0 for none; and (objects, 2) visible pixels of each, and the pixels that it would have alone."""
        return whole(self.owners(view))

    def owners(self, view: View) -> Pieces[tuple[Any, FloatArray]]:
        """Do the same as `ids`, in pieces."""
        base, things, cone = yield from self.cast(view)
        buffers, visible = self.buffers, view.scene.made()
        out: Any = np.empty(buffers.n, np.uint16)
        rays.owners(buffers.face, visible.faces, things, out)
        counts: FloatArray = np.zeros((len(visible.names), 2))
        counts[:, 0] = np.bincount(out, minlength=len(visible.names))
        sees = np.full(buffers.n, rays.NOTHING)
        sees[buffers.face >= 0] = visible.faces["thing"][buffers.face[buffers.face >= 0]]
        for plane in visible.planes:
            buffers.clear()
            _meet_plane(buffers, plane, base)
            counts[visible.ids[plane.thing], 1] += np.count_nonzero(buffers.face >= 0)
        for number, thing, scene in visible.alone():
            first = int(np.argmax(visible.faces["thing"] == thing))
            placed, there = rays.Placed(scene, thing, first), sees == thing
            counts[number, 1] += np.count_nonzero(there)
            # Nothing is between a camera and the body that carries it.
            if visible.rows[thing] == view.own >= 0 or not cone.meets(_balls(placed, things)):
                continue
            for _, pixels, part in self._bands:
                counts[number, 1] += part.count(placed, things, visible.faces, there[pixels])
                yield
        return out.reshape(self.lens.height, self.lens.width), counts


def _meet_plane(part: rays.Buffers, plane: Plane, base: FloatArray) -> None:
    """Let the rays of a part hit a half-space."""
    rays.meet_floor(
        part.origin, part.direction, plane.p - base, plane.normal, plane.face, part.distance, part.face
    )  # fmt: skip


def _seen_from(cone: Cone, view: View) -> Cone:
    """Return the cone in N about the base, widened by the motion of the camera while its rows are read."""
    turned = 2.0 * math.acos(min(abs(float(np.dot(view.first.q, view.last.q))), 1.0))
    return Cone(
        np.array(matrix(view.first.q)) @ cone.axis,
        cone.half + turned,
        cone.slack + math.dist(view.first.p, view.last.p),
    )


def _balls(placed: rays.Placed, things: Any) -> Balls:
    """Return the balls around the parts of a scene, in N about the base."""
    centre, radius = placed.scene.balls
    return Balls(centre @ things["R"][placed.thing].T + things["p"][placed.thing], radius)


def _rows(view: View, height: int, base: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (h, 3, 3) and (h, 3), the pose of the camera about the base when each row is read."""
    R, p = np.empty((height, 3, 3)), np.zeros((height, 3))
    first, last = view.first, view.last
    if first == last:
        R[:] = np.array(matrix(first.q))
        return R, p
    way = np.array(last.p) - base
    q0, q1 = np.array(first.q), np.array(last.q)
    q1 = q1 if q0 @ q1 >= 0.0 else -q1
    for row in range(height):
        part = row / max(height - 1, 1)
        q = q0 + part * (q1 - q0)
        w, x, y, z = (q / np.linalg.norm(q)).tolist()
        R[row], p[row] = matrix((w, x, y, z)), part * way
    return R, p


def lamp_rows(view: View, base: FloatArray) -> Any:
    """Return LAMP (n) of all lamps that shine."""
    rows: Any = np.zeros(len(view.lamps), LAMP)
    for row, lamp in zip(rows, view.lamps, strict=True):
        x, q_NB = view.state[lamp.row].tolist(), quat_of(view.state[lamp.row])
        dx, dy, dz = rotate(q_NB, lamp.p)
        row["p"] = np.array((x[0] + dx, x[1] + dy, x[2] + dz)) - base
        row["axis"] = rotate(multiply(q_NB, lamp.q), (1.0, 0.0, 0.0))
        row["exponent"] = exponent_of(lamp.cone)
        row["candela"], row["row"] = candelas(lamp.lumens, row["exponent"]), lamp.row
    return rows
