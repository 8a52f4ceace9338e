"""What things look like: the colours of materials, and glTF files that viewers show instead of shapes.

glTF files are checked before they are served, and never decoded here.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import msgspec

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.ports import ShapeView
from uwserver.scenario.files.documents import read_whole

MOST_BYTES = 16 << 20
MOST_JSON = 2 << 20
"""Most bytes of the JSON part of a file."""
MOST_NODES = 20_000
MOST_VALUES = 6_000_000
"""Most elements of all accessors: 2 million triangles."""
EXTENSIONS = frozenset((
    "KHR_materials_unlit", "KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_clearcoat",
    "KHR_materials_transmission", "KHR_mesh_quantization", "KHR_texture_transform",
))  # fmt: skip
"""Extensions that a file may require: those that a web page can show without further decoders."""

_HEAD, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


def read_model_file(path: Path) -> bytes:
    """Return the bytes of a checked file.

    Raises:
        BadSolid: it is missing, too large, or not a self-contained .glb of glTF 2.0; the text says what to do.
    """
    if path.suffix.lower() != ".glb":
        raise BadSolid(f'"{path.name}" is not a .glb: looks must be one binary glTF 2.0 file that contains its images')
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
    """Check that bytes are a self-contained .glb of a bounded size (glTF 2.0, section 4).

    Raises:
        BadSolid: they are not; the text says what is wrong.
    """
    if len(data) < _HEAD.size + _CHUNK.size:
        raise BadSolid("it is too short for a .glb: export it again")
    magic, version, length = _HEAD.unpack_from(data)
    if magic != b"glTF" or version != 2:
        raise BadSolid("it does not begin like a .glb of glTF 2.0: export it again")
    if length != len(data):
        raise BadSolid(f"its header says {length} bytes, but it has {len(data)}: export it again")
    size, kind = _CHUNK.unpack_from(data, _HEAD.size)
    begin = _HEAD.size + _CHUNK.size
    if kind != b"JSON" or begin + size > len(data):
        raise BadSolid("its first chunk is not JSON, or ends beyond the file: export it again")
    if size > MOST_JSON:
        raise BadSolid(f"its JSON has {size} bytes; at most {MOST_JSON} are allowed: simplify it")
    try:
        told = msgspec.json.decode(data[begin : begin + size])
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise BadSolid(f"its first chunk is not JSON: {error}") from error
    binary = _binary_size(data, begin + size)
    if not isinstance(told, dict):
        raise BadSolid("its JSON is not an object: export it again")
    _check_description(told, binary)


def _binary_size(data: bytes, begin: int) -> int:
    """Return the size of the second chunk, bytes; 0 if there is none."""
    if begin == len(data):
        return 0
    if begin + _CHUNK.size > len(data):
        raise BadSolid("it ends within the header of a chunk: export it again")
    size, kind = _CHUNK.unpack_from(data, begin)
    if kind != b"BIN\0" or begin + _CHUNK.size + size > len(data):
        raise BadSolid("its second chunk is not binary, or ends beyond the file: export it again")
    return int(size)


def _check_description(told: dict[str, Any], binary: int) -> None:
    """Check the JSON part of a file; `binary` is the size of its second chunk, bytes."""
    for part in ("buffers", "images"):
        if any("uri" in each for each in _listed(told, part)):
            raise BadSolid(f'its "{part}" are in other files: export it with everything embedded')
    required = told.get("extensionsRequired", [])
    named = required if isinstance(required, list) else ["?"]
    foreign = [str(name)[:100] for name in named if not isinstance(name, str) or name not in EXTENSIONS]
    if foreign:
        raise BadSolid(f"it needs {', '.join(foreign)}, which the viewers do not support: export it without")
    if len(_listed(told, "nodes")) > MOST_NODES:
        raise BadSolid(f"it has {len(_listed(told, 'nodes'))} nodes; at most {MOST_NODES} are allowed: join some")
    buffers = [_whole(each, "byteLength") for each in _listed(told, "buffers")]
    if len(buffers) > 1 or sum(buffers) > binary:
        raise BadSolid("its buffers do not fit into its binary chunk: export it again")
    for view in _listed(told, "bufferViews"):
        if _whole(view, "byteOffset") + _whole(view, "byteLength") > binary:
            raise BadSolid("one of its buffer views ends beyond the buffer: export it again")
        _whole(view, "byteStride")
    values = 0
    for accessor in _listed(told, "accessors"):
        _whole(accessor, "byteOffset")
        values += _whole(accessor, "count")
    if values > MOST_VALUES:
        raise BadSolid(f"it has {values} vertices and corners; at most {MOST_VALUES} are allowed: simplify it")


def _listed(told: dict[str, Any], name: str) -> list[dict[str, Any]]:
    found = told.get(name, [])
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise BadSolid(f'its "{name}" is not a list of objects: export it again')
    return found


def _whole(table: dict[str, Any], name: str) -> int:
    """Return a size or offset, 0 if it is missing."""
    number = table.get(name, 0)
    if not isinstance(number, int) or isinstance(number, bool) or number < 0:
        raise BadSolid(f'a "{name}" in it is not a whole number of at least 0: export it again')
    return number


# -- colours ----------------------------------------------------------------------------------------------------------------------------


Colour = tuple[float, float, float]
"""Red, green, blue, linear, 0..1."""

MATERIALS: dict[str, Colour] = {
    "sediment": (0.36, 0.31, 0.22),
    "mud": (0.19, 0.16, 0.12),
    "sand": (0.55, 0.47, 0.31),
    "gravel": (0.30, 0.29, 0.27),
    "rock": (0.22, 0.21, 0.20),
    "concrete": (0.42, 0.41, 0.38),
    "steel": (0.33, 0.36, 0.39),
    "plastic": (0.75, 0.45, 0.08),
}
"""Colours by the name of a material, as in `environment.materials`."""
COATS: dict[str, Colour] = {
    "tiles": (0.52, 0.77, 0.82),
    "paint": (0.87, 0.45, 0.02),
    "wood": (0.25, 0.13, 0.05),
    "rubber": (0.02, 0.02, 0.02),
    "zinc": (0.62, 0.65, 0.66),
    "rust": (0.30, 0.09, 0.03),
}
"""Colours of materials without acoustic properties, as in the web view."""
CLEAN = frozenset((*COATS, "steel", "plastic"))
"""Materials without sand or growth on them."""
SEABED: Colour = MATERIALS["sand"]
STRUCTURE: Colour = MATERIALS["concrete"]
VEHICLE: Colour = (0.85, 0.62, 0.08)
"""The yellow of most hulls."""
OBJECT: Colour = (0.45, 0.28, 0.12)


def colour_of(material: str, otherwise: Colour) -> Colour:
    """Return the colour of a material; `otherwise` if it has none."""
    return MATERIALS.get(material) or COATS.get(material, otherwise)


def grey() -> Colour:
    """Return the default colour of a shape."""
    return ShapeView("sphere").colour
