"""Compares the sizes that a mesh file declares with the file, before a parser trusts them: a few bytes can declare any number of triangles."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.scenario.files.opening import read_whole
from uwserver.scenario.solids.memory import check_memory

MOST_TRIANGLES = 2_000_000
MOST_BYTES = 500_000_000
_MOST_VERTICES = 3 * MOST_TRIANGLES
_PLY_HEADER_BYTES = 65_536
_STL_HEADER, _STL_TRIANGLE = 84, 50
_ELEMENT = re.compile(rb"^[ \t]*element[ \t]+(\w+)[ \t]+(\S+)", re.MULTILINE)


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
        try:
            data = read_whole(self._path.parent / name, self._left)
        except OSError as error:
            raise BadSolid(f'cannot read "{name}", which "{self._path.name}" names: {error.strerror}') from error
        self._left -= len(data)
        return data

    get = __getitem__


def _stl(path: Path, data: bytes) -> bytes:
    count = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little") if len(data) >= _STL_HEADER else -1
    if len(data) == _STL_HEADER + _STL_TRIANGLE * count:
        _check_count(path, "triangles", count, MOST_TRIANGLES)
        return data
    if data[:1000].lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096].lower():
        _check_count(path, "triangles", data.lower().count(b"endfacet"), MOST_TRIANGLES)
        # The parser would guess the encoding of a name that is not ASCII.
        return data.decode("ascii", "replace").encode()
    if count < 0:
        raise BadSolid(f'"{path.name}" is not an STL: it has {len(data)} bytes, and the header alone {_STL_HEADER}')
    needed = _STL_HEADER + _STL_TRIANGLE * count
    text = f"its header declares {count} triangles in {needed} bytes, but it has {len(data)}: export it again"
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
