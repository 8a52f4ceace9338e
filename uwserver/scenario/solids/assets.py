"""Reads mesh files with trimesh, turns them into our frames, checks them, and splits them into tiles of the size that the engines take."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from uwserver.physics.geometry.shapes import HULL_POINTS, TILE_TRIANGLES, BadSolid, ConvexHull, TriangleMesh, has_area
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.scenario.files.opening import read_whole
from uwserver.scenario.solids.mesh_checks import MOST_BYTES, MOST_TRIANGLES, SiblingFiles, checked

FORMATS = (".glb", ".gltf", ".obj", ".stl", ".ply")

_FROM_UP: dict[str, FloatArray] = {
    # From FLU to FRD, and from the axes of glTF (y up, z out of the picture) to FRD; x stays x.
    "z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
Warn = Any
"""Called with the text of a warning."""


def read_mesh(path: Path, up: Literal["y", "z"] | None, scale: float, warn: Warn) -> tuple[TriangleMesh, ...]:
    """Return the triangles of a file, in tiles of a size that the engines take.

    Args:
        path: of the file.
        up: axis of the file that points up; None: y for glTF, z for others.
        scale: length of one unit of the file, m.
        warn: called with texts about what was repaired or is doubtful.

    Raises:
        BadSolid: the file is missing, unreadable, empty, too large, or has vertices that are not finite.
    """
    mesh = _read(path)
    vertices, faces = _turned(mesh, path, up, scale)
    sound = has_area(vertices, faces)
    if not sound.all():
        warn(f'"{path.name}": {int((~sound).sum())} of {len(faces)} triangles have no area and are left out')
        faces = faces[sound]
    if not len(faces):
        raise BadSolid(f'"{path.name}" has no triangle with an area')
    closed = is_closed(faces)
    if not closed:
        warn(
            f'"{path.name}" is not closed: it acts as a sheet without thickness, and bodies inside it are not pushed out'
        )
    elif _volume(vertices, faces) < 0.0:
        faces = faces[:, ::-1]
    return tiles(vertices, np.ascontiguousarray(faces), closed)


def read_hull(path: Path, up: Literal["y", "z"] | None, scale: float, warn: Warn) -> ConvexHull:
    """Return the convex hull of a file. If it has more than `HULL_POINTS` corners, the farthest ones in as many directions are kept.

    Raises:
        BadSolid: as `read_mesh`; or the points span no volume.
    """
    from scipy.spatial import ConvexHull as Quickhull
    from scipy.spatial import QhullError

    vertices, _ = _turned(_read(path), path, up, scale)
    try:
        corners = vertices[np.sort(Quickhull(vertices).vertices)]
        if len(corners) <= HULL_POINTS:
            return ConvexHull(corners)
        k = np.arange(HULL_POINTS) + 0.5
        # Directions spread evenly over a sphere: Fibonacci's spiral.
        z, turn = 1.0 - 2.0 * k / HULL_POINTS, np.pi * (1.0 + np.sqrt(5.0)) * k
        ring = np.sqrt(1.0 - z * z)
        directions = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
        kept = corners[np.unique((corners @ directions.T).argmax(axis=0))]
        planes = Quickhull(kept).equations
    except QhullError as error:
        raise BadSolid(f'the points of "{path.name}" span no volume: use a mesh with a thickness') from error
    lost = float((corners @ planes[:, :3].T + planes[:, 3]).max())
    warn(
        f'the hull of "{path.name}" is simplified from {len(corners)} to {len(kept)} corners: up to {lost:.3g} m are cut off'
    )
    return ConvexHull(kept)


def is_closed(faces: IntArray) -> bool:
    """Return whether the surface has no border and is wound consistently: each edge is used equally often in both directions.

    Solids that touch along an edge count as closed.
    """
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1
    one_way, other_way = np.sort(starts * count + ends), np.sort(ends * count + starts)
    return bool(np.array_equal(one_way, other_way))


def tiles(vertices: FloatArray, faces: IntArray, oriented: bool) -> tuple[TriangleMesh, ...]:
    """Return a mesh in tiles of at most `TILE_TRIANGLES`; it is halved along its longest axis as often as needed."""
    if len(faces) <= TILE_TRIANGLES:
        used, numbers = np.unique(faces, return_inverse=True)
        return (TriangleMesh(np.ascontiguousarray(vertices[used]), numbers.reshape(-1, 3).astype(np.int64), oriented),)
    centres = vertices[faces].mean(axis=1)
    axis = int(np.ptp(centres, axis=0).argmax())
    order = np.argsort(centres[:, axis], kind="stable")
    half = len(order) // 2
    return tiles(vertices, faces[order[:half]], oriented) + tiles(vertices, faces[order[half:]], oriented)


def _read(path: Path) -> Any:
    if path.suffix.lower() not in FORMATS:
        raise BadSolid(f'"{path.name}" has an unknown file type: use {", ".join(FORMATS)}')
    try:
        data = checked(path, read_whole(path, MOST_BYTES))
    except OSError as error:
        raise BadSolid(f'cannot read "{path}": {error.strerror}') from error
    try:
        import trimesh
    except ImportError as error:
        raise BadSolid('mesh files need the extra "solid": pip install "uwserver[solid]"') from error
    try:
        kind, beside = path.suffix.lower()[1:], cast("Any", SiblingFiles(path))
        scene = trimesh.load_scene(io.BytesIO(data), kind, resolver=beside, process=False, skip_materials=True)
        mesh = scene.to_mesh()
        if np.isfinite(mesh.vertices).all():  # otherwise the caller reports it
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
    except BadSolid:
        raise
    except MemoryError as error:
        raise BadSolid(
            f'there is too little memory for "{path.name}" ({len(data) / 1e6:.0f} MB): simplify it'
        ) from error
    except Exception as error:  # a parser of foreign files may raise anything
        raise BadSolid(f'cannot read "{path.name}": {type(error).__name__}: {error}') from error
    return mesh


def _turned(mesh: Any, path: Path, up: Literal["y", "z"] | None, scale: float) -> tuple[FloatArray, IntArray]:
    """Return checked vertices in our frame, m, and faces."""
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if not len(faces):
        raise BadSolid(f'"{path.name}" has no triangles')
    if len(faces) > MOST_TRIANGLES:
        raise BadSolid(f'"{path.name}" has {len(faces)} triangles: simplify it to at most {MOST_TRIANGLES}')
    axis = up or ("y" if path.suffix.lower() in (".glb", ".gltf") else "z")
    vertices = scale * (np.asarray(mesh.vertices, dtype=np.float64) @ _FROM_UP[axis].T)
    bad = int((~np.isfinite(vertices)).any(axis=1).sum())
    if bad:
        raise BadSolid(f'{bad} vertices of "{path.name}" are not finite: repair the file')
    return np.ascontiguousarray(vertices), faces


def _volume(vertices: FloatArray, faces: IntArray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", np.cross(a, b), c)) / 6.0
