"""Looks: glTF files that show what a thing looks like, for viewers alone. Checked before anybody gets them; never decoded here."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import msgspec

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.scenario.files.opening import read_whole

MOST_BYTES = 16 << 20
MOST_JSON = 2 << 20
"""Bytes of the description in a file."""
MOST_NODES = 20_000
MOST_VALUES = 6_000_000
"""Elements of all accessors: 2 million triangles."""
EXTENSIONS = frozenset((
    "KHR_materials_unlit", "KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_clearcoat",
    "KHR_materials_transmission", "KHR_mesh_quantization", "KHR_texture_transform",
))  # fmt: skip
"""Extensions that a file may require: what a page can show without further decoders."""

_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


def read_looks(path: Path) -> bytes:
    """The whole file.

    Raises:
        BadSolid: it is missing, too large, or not one self-contained .glb of glTF 2.0; the text says what to do.
    """
    if path.suffix.lower() != ".glb":
        raise BadSolid(f'"{path.name}" is no .glb: looks are one binary file of glTF 2.0, with its pictures in it')
    try:
        data = read_whole(path, MOST_BYTES)
    except OSError as error:
        raise BadSolid(f'cannot read "{path}": {error.strerror}') from error
    try:
        check_glb(data)
    except BadSolid as error:
        raise BadSolid(f'"{path.name}": {error}') from error
    return data


def check_glb(data: bytes) -> None:
    """Refuse what is no self-contained .glb of a bounded size (glTF 2.0, section 4).

    Raises:
        BadSolid: says what is wrong.
    """
    if len(data) < _HEAD.size + _CHUNK.size:
        raise BadSolid("it is too short for a .glb")
    magic, version, length = _HEAD.unpack_from(data)
    if magic != b"glTF" or version != 2:
        raise BadSolid("it does not begin as a .glb of glTF 2.0 does")
    if length != len(data):
        raise BadSolid(f"its head says {length} bytes, it has {len(data)}: it was cut off, or something was added")
    size, kind = _CHUNK.unpack_from(data, _HEAD.size)
    begin = _HEAD.size + _CHUNK.size
    if kind != b"JSON" or begin + size > len(data):
        raise BadSolid("its first part is no description that fits into it")
    if size > MOST_JSON:
        raise BadSolid(f"its description has {size} bytes: at most {MOST_JSON}")
    try:
        told = msgspec.json.decode(data[begin : begin + size])
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise BadSolid(f"its description is no JSON: {error}") from error
    binary = _binary_size(data, begin + size)
    if not isinstance(told, dict):
        raise BadSolid("its description is no object")
    _check_description(told, binary)


def _binary_size(data: bytes, begin: int) -> int:
    """Bytes of the second part; 0 where there is none."""
    if begin == len(data):
        return 0
    if begin + _CHUNK.size > len(data):
        raise BadSolid("it ends in the head of a part")
    size, kind = _CHUNK.unpack_from(data, begin)
    if kind != b"BIN\0" or begin + _CHUNK.size + size > len(data):
        raise BadSolid("its second part is no binary one that fits into it")
    return int(size)


def _check_description(told: dict[str, Any], binary: int) -> None:
    for part in ("buffers", "images"):
        if any("uri" in each for each in _listed(told, part)):
            raise BadSolid(f'its "{part}" lie outside: export it with everything embedded')
    required = told.get("extensionsRequired", [])
    named = required if isinstance(required, list) else ["?"]
    foreign = [str(name)[:100] for name in named if not isinstance(name, str) or name not in EXTENSIONS]
    if foreign:
        raise BadSolid(f"it needs {', '.join(foreign)}, which viewers here do not know: export it without")
    if len(_listed(told, "nodes")) > MOST_NODES:
        raise BadSolid(f"it has {len(_listed(told, 'nodes'))} nodes: join them to at most {MOST_NODES}")
    buffers = [_whole(each, "byteLength") for each in _listed(told, "buffers")]
    if len(buffers) > 1 or sum(buffers) > binary:
        raise BadSolid("its buffers do not fit into its binary part")
    for view in _listed(told, "bufferViews"):
        if _whole(view, "byteOffset") + _whole(view, "byteLength") > binary:
            raise BadSolid("a view of its buffer ends beyond it")
        _whole(view, "byteStride")
    for accessor in _listed(told, "accessors"):
        _whole(accessor, "byteOffset")
    values = sum(_whole(each, "count") for each in _listed(told, "accessors"))
    if values > MOST_VALUES:
        raise BadSolid(f"it has {values} vertices and corners: simplify it to at most {MOST_VALUES}")


def _listed(told: dict[str, Any], name: str) -> list[dict[str, Any]]:
    found = told.get(name, [])
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise BadSolid(f'its "{name}" are no list of objects')
    return found


def _whole(table: dict[str, Any], name: str) -> int:
    number = table.get(name, 0)
    if not isinstance(number, int) or isinstance(number, bool) or number < 0:
        raise BadSolid(f'a "{name}" in it is no size')
    return number
