"""Model files: triangles, colours and textures of a .glb file (glTF 2.0), which was checked when the scenario was loaded."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from uwserver.physics.kernel.arrays import FloatArray, IntArray
from uwserver.sensors.optical.camera.faces import blank_faces, smooth_normals
from uwserver.sensors.optical.camera.textures import BadTexture, ByteBudget, Picture, decoded

FRD: FloatArray = np.array(((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)))
"""Matrix from the axes of glTF (y up, x forward) to forward, right, down."""
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES = 4
_DEEPEST = 64
_MOST_NODES = 50_000
"""Most visits of nodes. A node may be a child of several others."""
_MOST_PARTS = 20_000
"""Most meshes that are drawn. A mesh may belong to many nodes."""
_MOST_PICTURES = 256
_FARTHEST_M = 1e7
_WIDEST_STEP = 252
"""Largest distance between vertices, bytes (glTF 2.0, 5.11.4)."""
MOST_TRIANGLES = 2_000_000


class BadGltf(ValueError):
    """A glTF file that cannot be drawn. The text says why."""


class GltfModel(NamedTuple):
    """The contents of a glTF file.

    Attributes:
        faces: FACE (n) in forward, right, down; `texture` is an index of `pictures`.
        pictures: (h, w, 3) each.
        faults: texts about what cannot be shown.
    """

    faces: Any
    pictures: list[Picture]
    faults: tuple[str, ...]


def read_glb(data: bytes, budget: ByteBudget | None = None) -> GltfModel:
    """Return the contents of a file. Its pictures take bytes of `budget`, which all things of a world share; default: all bytes.

    Raises:
        BadGltf: the file has no triangles, or its parts do not fit together.
    """
    try:
        reader = _Reader(data, ByteBudget() if budget is None else budget)
        with np.errstate(all="ignore"):  # numbers that are not finite are refused
            parts = reader.parts()
    except (
        KeyError,
        IndexError,
        ValueError,
        TypeError,
        AttributeError,
        struct.error,
        OverflowError,
        RecursionError,
    ) as error:
        raise BadGltf(f"looks that do not fit together: {type(error).__name__}: {error}") from error
    if not parts:
        raise BadGltf("looks without triangles")
    return GltfModel(np.concatenate(parts), reader.pictures, tuple(reader.faults))


class _Reader:
    """Reads the nodes of one file."""

    def __init__(self, data: bytes, budget: ByteBudget) -> None:
        size = struct.unpack_from("<I", data, 12)[0]
        self._told: dict[str, Any] = msgspec.json.decode(data[20 : 20 + size])
        begin = 20 + size
        length = struct.unpack_from("<I", data, begin)[0] if begin + 8 <= len(data) else 0
        self._binary = data[begin + 8 : begin + 8 + length]
        self.pictures: list[Picture] = []
        self.faults: list[str] = []
        self._budget = budget
        self._numbers: dict[int, int] = {}
        self._values: dict[int, npt.NDArray[Any]] = {}
        self._triangles = self._visited = self._parts = 0

    def parts(self) -> list[Any]:
        """Return FACE of all meshes, transformed by their nodes."""
        told, found = self._told, list[Any]()
        scenes = told.get("scenes") or [{"nodes": list(range(len(told.get("nodes", []))))}]
        for node in scenes[told.get("scene", 0)].get("nodes", []):
            self._walk(node, np.eye(4), 0, found)
        return found

    def _walk(self, number: int, above: FloatArray, depth: int, found: list[Any]) -> None:
        self._visited += 1
        if depth > _DEEPEST or self._visited > _MOST_NODES:
            raise ValueError("nodes that contain themselves, or too many nodes")
        node = self._told["nodes"][number]
        here = above @ _placed(node)
        if "mesh" in node:
            for primitive in self._told["meshes"][node["mesh"]]["primitives"]:
                if primitive.get("mode", _TRIANGLES) == _TRIANGLES:
                    found.append(self._primitive(primitive, here))
        for child in node.get("children", []):
            self._walk(child, here, depth + 1, found)

    def _primitive(self, told: dict[str, Any], pose: FloatArray) -> Any:
        points = self._accessor(told["attributes"]["POSITION"])
        named = self._accessor(told["indices"]).ravel() if "indices" in told else None
        count = (len(points) if named is None else len(named)) // 3
        self._parts += 1
        self._triangles += count
        if self._parts > _MOST_PARTS:
            raise ValueError(f"more than {_MOST_PARTS} meshes at nodes")
        if self._triangles > MOST_TRIANGLES:
            raise ValueError(f"more than {MOST_TRIANGLES} triangles")
        order: IntArray = np.arange(3 * count) if named is None else named[: 3 * count].astype(np.int64)
        # Transform only the vertices that are used: many nodes may each use a few of many vertices.
        used, places = np.unique(order, return_inverse=True)
        vertices = (points[used].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]) @ FRD.T
        if not bool((np.abs(vertices) <= _FARTHEST_M).all()):
            raise ValueError(f"vertices that are not finite, or farther away than {_FARTHEST_M:g} m")
        order, places = order.reshape(-1, 3), places.reshape(-1, 3)
        if np.linalg.det(pose[:3, :3]) < 0.0:
            order, places = order[:, ::-1], places[:, ::-1]
        rows = blank_faces(len(order))
        corners: FloatArray = vertices[places]
        rows["corners"], rows["normals"] = corners, smooth_normals(corners)
        material = self._told["materials"][told["material"]] if "material" in told else {}
        rows["sided"] = 0 if material.get("doubleSided") else 1
        surface = material.get("pbrMetallicRoughness", {})
        rows["colour"] = np.clip(surface.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))[:3], 0.0, 1.0)
        texture = surface.get("baseColorTexture")
        coordinates = told["attributes"].get(f"TEXCOORD_{texture.get('texCoord', 0)}") if texture else None
        if texture is not None and coordinates is not None:
            self._paint(rows, corners, self._accessor(coordinates)[order], texture["index"])
        return rows

    def _paint(self, rows: Any, corners: FloatArray, uv: npt.NDArray[Any], texture: int) -> None:
        number = self._texture(texture)
        if number < 0:
            return
        if not bool(np.isfinite(uv).all()):
            raise ValueError("coordinates of a texture that are not finite")
        height, width = self.pictures[number].shape[:2]
        rows["texture"], rows["uv"] = number, uv
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        sides = (uv[:, 1:] - uv[:, :1]).astype(np.float64) * (width, height)
        texels = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        rows["texel"] = np.sqrt(area / np.maximum(texels, 1e-6))

    def _texture(self, texture: int) -> int:
        """Return the number of its picture; -1 if the picture cannot be shown."""
        source = self._told["textures"][texture]["source"]
        if source not in self._numbers:
            if len(self._numbers) >= _MOST_PICTURES:
                raise ValueError(f"more than {_MOST_PICTURES} pictures")
            self._numbers[source] = -1
            view = self._told["bufferViews"][self._told["images"][source]["bufferView"]]
            begin = view.get("byteOffset", 0)
            try:
                self.pictures.append(decoded(self._binary[begin : begin + view["byteLength"]], self._budget))
                self._numbers[source] = len(self.pictures) - 1
            except BadTexture as error:
                self.faults.append(str(error))
        return self._numbers[source]

    def _accessor(self, number: int) -> npt.NDArray[Any]:
        """Return the values of an accessor, (count, width). Normalised integers become fractions."""
        if number not in self._values:
            self._values[number] = self._read(self._told["accessors"][number])
        return self._values[number]

    def _read(self, told: dict[str, Any]) -> npt.NDArray[Any]:
        view = self._told["bufferViews"][told["bufferView"]]
        kind, width = np.dtype(_TYPES[told["componentType"]]), _WIDTHS[told["type"]]
        size = kind.itemsize * width
        step = view.get("byteStride") or size
        offsets, count = (view.get("byteOffset", 0), told.get("byteOffset", 0)), told["count"]
        if not all(isinstance(value, int) and value >= 0 for value in (*offsets, count - 1, step)):
            raise ValueError("an accessor whose offset, count or step is no whole number, or negative")
        if not size <= step <= _WIDEST_STEP:
            raise ValueError(f"an accessor with a step of {step} bytes")
        begin = sum(offsets)
        if begin + (count - 1) * step + size > len(self._binary):
            raise ValueError("an accessor that ends beyond the file")
        # The constructor itself refuses an array that exceeds the buffer.
        rows = np.ndarray((count, width), kind, self._binary, begin, (step, kind.itemsize))
        values: npt.NDArray[Any] = np.ascontiguousarray(rows)
        if told.get("normalized"):
            values = values / np.float32(np.iinfo(kind).max)
        return values


def _placed(node: dict[str, Any]) -> FloatArray:
    """Return the pose of a node in its parent."""
    if "matrix" in node:
        given: FloatArray = np.array(node["matrix"], np.float64).reshape(4, 4).T
        return given
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    pose: FloatArray = np.eye(4)
    pose[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    pose[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)))
    pose[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return pose
