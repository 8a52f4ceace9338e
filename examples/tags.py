"""AprilTags, rendered by a camera under water and found by a real detector: where it puts them, against where they are.

    pip install uwserver[pictures,solid] pupil-apriltags
    python examples/tags.py [--out picture.png] [--seconds 4]

The scenario is tags.toml; ``python examples/tags.py --make`` writes tags.glb, the looks of its board, anew.
"""

from __future__ import annotations

import argparse
import io
import json
import struct
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E)
"""The first three of the family tag36h11 (E. Olson, AprilTag, ICRA 2011), row after row from the upper left."""
SIZE_M, APART_M = 0.24, 0.5
"""Edge of a tag's black border, and from one tag to the next."""
CELLS, PIXELS = 10, 16
"""Of a tag with its white border; and of a cell along an edge."""


def tag(code: int) -> np.ndarray:
    """(160, 160) picture of a tag, 0 to 255: white border, black border, 6 x 6 bits."""
    cells = np.full((CELLS, CELLS), 255, np.uint8)
    cells[1:9, 1:9] = 0
    cells[2:8, 2:8] = [[255 * (code >> (35 - 6 * row - column) & 1) for column in range(6)] for row in range(6)]
    return np.kron(cells, np.ones((PIXELS, PIXELS), np.uint8))


def make(file: Path) -> None:
    """Write the looks of the board: three squares that face the viewer in the west, each with its texture."""
    from PIL import Image

    half = 0.5 * SIZE_M * CELLS / 8
    binary, views, accessors, primitives = b"", [], [], []

    def add(data: bytes) -> int:
        nonlocal binary
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data + b"\0" * (-len(data) % 4)
        return len(views) - 1

    def accessor(array: np.ndarray, kind: int, shape: str) -> int:
        accessors.append(
            {"bufferView": add(array.tobytes()), "componentType": kind, "count": len(array), "type": shape}
        )
        if shape == "VEC3":
            accessors[-1] |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        return len(accessors) - 1

    images = []
    for k, code in enumerate(CODES):
        middle = (k - 1) * APART_M
        # y is up, z to the right; x = -0.011 is before the board as one sees it from the west.
        corners = np.array(
            [(-0.011, y, middle + z) for y, z in ((-half, -half), (-half, half), (half, half), (half, -half))], "<f4"
        )
        uv = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], "<f4")
        order = np.array([0, 1, 2, 0, 2, 3], "<u2")
        attributes = {"POSITION": accessor(corners, 5126, "VEC3"), "TEXCOORD_0": accessor(uv, 5126, "VEC2")}
        primitives.append({"attributes": attributes, "indices": accessor(order, 5123, "SCALAR"), "material": k})
        png = io.BytesIO()
        Image.fromarray(tag(code)).save(png, "PNG", optimize=True)
        images.append({"bufferView": add(png.getvalue()), "mimeType": "image/png"})
    told = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": primitives}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorTexture": {"index": k}, "metallicFactor": 0.0}, "doubleSided": True} for k in range(len(CODES))
        ],
        "textures": [{"source": k} for k in range(len(CODES))], "images": images,
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    file.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def main() -> None:
    """Look for some seconds; tell each tag."""
    from pupil_apriltags import Detector

    from uwserver.frames import matrix
    from uwserver.scenario.build.world import build
    from uwserver.scenario.load.scenario import load

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--out", type=Path, help="write the last picture there")
    parser.add_argument("--make", action="store_true", help="write tags.glb and end")
    arguments = parser.parse_args()
    if arguments.make:
        make(HERE / "tags.glb")
        return
    resolved = load(HERE / "tags.toml", adapters={})
    vehicle, world = resolved.vehicles["rov"].vehicle, build(resolved)
    lens, p_BS = vehicle.sensors["camera"].optics(), vehicle.mounts["camera"].position_frd_m
    detector = Detector(families="tag36h11")
    errors, found, picture = [], set(), None
    for _ in range(round(arguments.seconds * 240)):
        for sample in world.step():
            if sample.port != "rov/camera":
                continue
            picture = sample.value[0].array()
            x = world.hydro.state[world.vehicles["rov"].row]
            R = np.array(matrix(tuple(x[3:7])))
            eye = x[:3] + R @ p_BS
            grey = np.ascontiguousarray(picture.mean(axis=2).astype(np.uint8))
            for one in detector.detect(grey, True, (lens.fx, lens.fy, lens.cx, lens.cy), SIZE_M):
                right, down, ahead = one.pose_t.ravel()
                place = eye + R @ (ahead, right, down)
                truth = (2.989, (one.tag_id - 1) * APART_M, 4.0)
                errors.append(float(np.linalg.norm(place - truth)))
                found.add(one.tag_id)
    print(f"tags {sorted(found)}, {len(errors)} detections")
    if arguments.out and picture is not None:
        from PIL import Image

        Image.fromarray(picture).save(arguments.out)
    print(f"found {len(found)} tags, mean error {np.mean(errors) if errors else float('inf'):.3f} m")


if __name__ == "__main__":
    main()
