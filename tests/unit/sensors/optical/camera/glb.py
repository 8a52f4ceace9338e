"""Makes .glb files for tests."""

from __future__ import annotations

import io
import struct
from typing import Any

import msgspec
import numpy as np
from PIL import Image


def png(pixels: Any) -> bytes:
    out = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(out, "PNG")
    return out.getvalue()


def glb(image: bytes = b"", **material: Any) -> bytes:
    """A square of 2 m in glTF's plane z = 0, seen from +z, with uv from the upper left."""
    corners = np.array(((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)), "<f4")
    uv = np.array(((0, 1), (1, 1), (1, 0), (0, 0)), "<f4")
    order = np.array((0, 1, 2, 0, 2, 3), "<u2")
    parts = [corners.tobytes(), uv.tobytes(), order.tobytes(), image]
    views, binary = [], b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(part)})
        binary += part + b"\0" * (-len(part) % 4)
    surface: dict[str, Any] = {"baseColorFactor": [1.0, 0.5, 0.25, 1.0]}
    told: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": [0.0, 3.0, 0.0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": surface, **material}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": views if image else views[:3],
        "buffers": [{"byteLength": len(binary)}],
    }
    if image:
        surface["baseColorTexture"] = {"index": 0}
        told |= {"textures": [{"source": 0}], "images": [{"bufferView": 3, "mimeType": "image/png"}]}
    return packed(told, binary)


def packed(told: Any, binary: bytes) -> bytes:
    text = msgspec.json.encode(told)
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
