"""Reads mesh files with trimesh, turns them into our frames, checks them, and splits them into tiles of the size that the engines take.

Before the parser trusts the sizes that a file declares, they are compared with the file: a few bytes can declare any number of triangles.
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from uwserver.packages import install_command
from uwserver.physics.geometry.shapes import HULL_POINTS, TILE_TRIANGLES, BadSolid, ConvexHull, TriangleMesh, has_area
from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.scenario.files.documents import opened, read_whole
from uwserver.scenario.solids.memory import check_memory

FORMATS = (".glb", ".gltf", ".obj", ".stl", ".ply")

_FROM_UP: dict[str, FloatArray] = {
    # From FLU to FRD, and from the axes of glTF (y up, z out of the picture) to FRD; x stays x.
    "z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
Warn = Any
"""Called with the text of a warning."""
MOST_TRIANGLES = 2_000_000
MOST_BYTES = 500_000_000
_MOST_VERTICES = 3 * MOST_TRIANGLES
_PLY_HEADER_BYTES = 65_536
_STL_HEADER, _STL_TRIANGLE = 84, 50
_STL_HEAD = 4096
"""Bytes of an STL that tell which kind it is."""
_END_OF_FACET = re.compile(rb"endfacet", re.IGNORECASE)
_ELEMENT = re.compile(rb"^[ \t]*element[ \t]+(\w+)[ \t]+(\S+)", re.MULTILINE)


def read_mesh(path: Path, up: Literal["y", "z"] | None, scale: float, warn: Warn) -> tuple[TriangleMesh, ...]:
    """Return the triangles of a file, in tiles of a size that the engines take.

    Args:
        path: path of the file.
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
        if path.suffix.lower() == ".stl":
            with opened(path) as file:  # before it is read: a sparse file of this size costs nobody anything
                _is_stl_text(path, file.read(_STL_HEAD), os.fstat(file.fileno()).st_size)
        data = checked(path, read_whole(path, MOST_BYTES))
    except OSError as error:
        raise BadSolid(f'cannot read "{path}": {error.strerror}') from error
    try:
        import trimesh
    except ImportError as error:
        raise BadSolid(f'mesh files need the extra "solid": {install_command("uwserver[solid]")}') from error
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
    _check_count(path, "triangles", len(faces), MOST_TRIANGLES)
    axis = up or ("y" if path.suffix.lower() in (".glb", ".gltf") else "z")
    vertices = scale * (np.asarray(mesh.vertices, dtype=np.float64) @ _FROM_UP[axis].T)
    bad = int((~np.isfinite(vertices)).any(axis=1).sum())
    if bad:
        raise BadSolid(f'{bad} vertices of "{path.name}" are not finite: repair the file')
    return np.ascontiguousarray(vertices), faces


def _volume(vertices: FloatArray, faces: IntArray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", np.cross(a, b), c)) / 6.0


# -- declared sizes ---------------------------------------------------------------------------------------------------------------------


def checked(path: Path, data: bytes) -> bytes:
    """Return the bytes for the parser of a file of a known type.

    Raises:
        BadSolid: the file declares more than it has, or more than is allowed.
    """
    kind = path.suffix.lower()
    try:
        if kind == ".stl":
            return _stl(path, data)
        if kind == ".ply":
            _check_ply(path, data)
        elif kind == ".obj":
            _check_count(path, "triangles", _lines(data, b"f"), MOST_TRIANGLES)
            _check_count(path, "vertices", _lines(data, b"v"), _MOST_VERTICES)
        else:
            _check_gltf(path, _gltf_tree(path, data))
    except BadSolid:  # which is a ValueError too
        raise
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise BadSolid(f'cannot read "{path.name}": {type(error).__name__}: {error}: export it again') from error
    return data


class SiblingFiles:
    """Reads the files that a glTF names. They must be regular files in its own folder, together no larger than a mesh may be."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left = MOST_BYTES

    def __getitem__(self, name: str) -> bytes:
        """Return the bytes of a file.

        Raises:
            BadSolid: it is in another folder, cannot be read, or is too large.
        """
        if not name or Path(name).name != name:
            raise BadSolid(f'"{self._path.name}" names "{name[:80]}", which is not in its own folder: move it there')
        file = self._path.parent / name
        if file.resolve().parent != self._path.parent.resolve():
            raise BadSolid(f'"{self._path.name}" names "{name}", a link to another folder: put the file itself there')
        try:
            data = read_whole(file, self._left)
        except OSError as error:
            raise BadSolid(f'cannot read "{name}", which "{self._path.name}" names: {error.strerror}') from error
        self._left -= len(data)
        return data

    get = __getitem__


def _stl(path: Path, data: bytes) -> bytes:
    if not _is_stl_text(path, data[:_STL_HEAD], len(data)):
        return data
    _check_count(path, "triangles", sum(1 for _ in _END_OF_FACET.finditer(data)), MOST_TRIANGLES)
    # The parser would guess the encoding of a name that is not ASCII.
    return data.decode("ascii", "replace").encode()


def _is_stl_text(path: Path, head: bytes, size: int) -> bool:
    """Return whether an STL is text, from its first bytes and its size, bytes.

    Raises:
        BadSolid: it is neither text, nor binary with as many triangles as its header says.
    """
    count = int.from_bytes(head[_STL_HEADER - 4 : _STL_HEADER], "little") if len(head) >= _STL_HEADER else -1
    if size == _STL_HEADER + _STL_TRIANGLE * count:
        _check_count(path, "triangles", count, MOST_TRIANGLES)
        return False
    if head[:1000].lstrip()[:5].lower() == b"solid" and b"facet" in head.lower():
        return True
    if count < 0:
        raise BadSolid(f'"{path.name}" is not an STL: it has {size} bytes, and the header alone {_STL_HEADER}')
    needed = _STL_HEADER + _STL_TRIANGLE * count
    text = f"its header declares {count} triangles in {needed} bytes, but it has {size}: export it again"
    raise BadSolid(f'"{path.name}" is not an STL: {text}')


def _check_ply(path: Path, data: bytes) -> None:
    head, found, _ = data[:_PLY_HEADER_BYTES].partition(b"end_header")
    if not head.startswith(b"ply") or not found:
        raise BadSolid(f'"{path.name}" is not a PLY: it does not begin with a header from "ply" to "end_header"')
    for name, text in _ELEMENT.findall(head):
        count, what = int(text), name.decode("ascii", "replace")
        if not 0 <= count <= len(data):  # each has at least one byte
            raise BadSolid(f'"{path.name}" declares {count} of "{what}" in {len(data)} bytes: export it again')
        if what == "vertex":
            _check_count(path, "vertices", count, _MOST_VERTICES)
        elif what == "face":
            _check_count(path, "triangles", count, MOST_TRIANGLES)


def _gltf_tree(path: Path, data: bytes) -> Mapping[str, Any]:
    if path.suffix.lower() == ".glb":
        try:
            magic, _, _, length, kind = struct.unpack_from("<4sIII4s", data)
        except struct.error:
            magic, length, kind = b"", 0, b""
        if magic != b"glTF" or kind != b"JSON" or 20 + length > len(data):
            raise BadSolid(
                f'"{path.name}" is not a GLB: its header does not fit its {len(data)} bytes: export it again'
            )
        data = data[20 : 20 + length]
    tree: Mapping[str, Any] = json.loads(data)
    return tree


def _check_gltf(path: Path, tree: Mapping[str, Any]) -> None:
    """Check accessors and nodes: a few bytes can declare large accessors without data, and nodes that repeat a mesh a million times."""
    accessors, nodes = tree.get("accessors", ()), tree.get("nodes", ())
    for accessor in accessors:
        _check_count(path, "entries of an accessor", accessor["count"], _MOST_VERTICES)
        if "bufferView" not in accessor:
            raise BadSolid(f'"{path.name}" has an accessor without data, or compressed: export it without compression')
    _check_count(path, "entries of accessors", sum(accessor["count"] for accessor in accessors), 4 * _MOST_VERTICES)
    children = [child for node in nodes for child in node.get("children", ())]
    if len(set(children)) < len(children):
        raise BadSolid(f'"{path.name}" has a node with two parents: export it again')
    meshes = tree.get("meshes", ())
    corners = [sum(_corners(accessors, part) for part in mesh["primitives"]) for mesh in meshes]
    total = sum(corners[node["mesh"]] for node in nodes if "mesh" in node)
    _check_count(path, "triangles", total // 3, MOST_TRIANGLES)


def _corners(accessors: Any, primitive: Mapping[str, Any]) -> int:
    """Return an upper bound of the number of triangle corners; in a strip each vertex may begin a triangle."""
    number: int = primitive.get("indices", primitive["attributes"]["POSITION"])
    count: int = accessors[number]["count"]
    return count * (3 if primitive.get("mode", 4) in (5, 6) else 1)


def _lines(data: bytes, word: bytes) -> int:
    """Return the number of lines that begin with a word and a blank."""
    return data.count(b"\n" + word + b" ") + data.count(b"\n" + word + b"\t") + data.startswith(word + b" ")


def _check_count(path: Path, what: str, count: int, most: int) -> None:
    if not 0 <= count <= most:
        raise BadSolid(f'"{path.name}" has {count} {what}; at most {most} are allowed: simplify it')
    if what == "triangles":
        check_memory(path.name, count)
