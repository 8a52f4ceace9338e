"""A dock with AprilTags: where each sits, the file that the dock is made of, and from where a camera sees it.

    pip install uwserver[pictures,solid] pupil-apriltags
    python examples/tags.py dock_tags.glb

writes the file anew. dock_tags.py docks by it. All places are in the dock's own frame D, in m: x into the dock, y to starboard, z down, and the
origin is where the middle of a vehicle is that has docked.
"""

from __future__ import annotations

import io
import json
import math
import struct
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np


class Tag(NamedTuple):
    """A tag that faces who comes in, upright.

    Attributes:
        code: its bits, of the family tag36h11 (E. Olson, AprilTag, ICRA 2011; E. Olson and J. Wang, AprilTag 2, IROS 2016).
        size: edge of its black border, which is 8 of its 10 cells.
        place: of its middle.
    """

    code: int
    size: float
    place: tuple[float, float, float]


WINGS, WALL = -0.6, 0.80
"""Where the plates beside the mouth and the one at the end stand: x of what faces the vehicle."""
TAGS = (
    Tag(0xD5D628584, 0.32, (WINGS, -0.80, 0.0)),
    Tag(0xD97F18B49, 0.32, (WINGS, 0.80, 0.0)),
    Tag(0xDD280910E, 0.20, (WALL, -0.25, -0.16)),
    Tag(0xE479E9C98, 0.20, (WALL, 0.25, -0.16)),
    Tag(0xEBCBCA822, 0.20, (WALL, -0.25, 0.16)),
    Tag(0xF31DAB3AC, 0.20, (WALL, 0.25, 0.16)),
)
"""Large ones beside the mouth to be seen from far, small ones at the end of the dock to be seen from within; their places are known by their ids."""
THICK_M = 0.01
"""Of the plates on which tags are printed."""
PAINT = {"frame": (0.85, 0.55, 0.03), "plate": (0.03, 0.05, 0.06)}
BOXES = (
    ("plate", (WALL + THICK_M + 0.015, 0.0, 0.0), (0.03, 1.15, 0.85)),
    ("plate", (WINGS + THICK_M + 0.015, -0.82, 0.0), (0.03, 0.46, 0.50)),
    ("plate", (WINGS + THICK_M + 0.015, 0.82, 0.0), (0.03, 0.46, 0.50)),
    *(("frame", (0.09, y, z), (1.38, 0.05, 0.05)) for y in (-0.55, 0.55) for z in (-0.45, 0.45)),
    *(("frame", (x, y, 0.9), (0.06, 0.06, 2.8)) for x in (-0.56, 0.84) for y in (-0.55, 0.55)),
    *(("frame", (x, 0.0, -0.45), (0.05, 1.1, 0.05)) for x in (-0.56, 0.84)),
)
"""What it is built of: paint, middle and edges. A frame on four legs, open above, below and in front."""
_AXES = np.array(((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))
"""From D to the axes of a camera that looks into the dock: right, down, ahead."""
_CORNERS = np.array(((-0.5, 0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)))
"""Right and down, in the detector's order."""
CERTAIN, FITS_PX = 8.0, 1.5
"""Least decision margin of a tag, and how far its corners may lie beside where the pose of all puts them (rms)."""
CORNER_PX = 0.4
"""Error of a corner that is expected: from it follows how far off a pose is."""
_FIRST = np.array(
    [[(-1, -1, -1), (-1, -1, 1), (-1, 1, 1), (-1, 1, -1)], [(1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1)]]
)
_SIDES = np.concatenate([np.roll(_FIRST, k, axis=2) for k in range(3)])
"""Corners of the sides of a cube, anticlockwise from without."""
_Pose = tuple[float, np.ndarray, np.ndarray, np.ndarray]
"""How well it fits (rms, pixels), rotation from D, place of D's origin, covariance of a turn and of that place: all in the camera's axes."""


class Lens(NamedTuple):
    """Of a pinhole camera, pixels; `uwserver camera-info` tells it of each camera."""

    fx: float
    fy: float
    cx: float
    cy: float


class Seen(NamedTuple):
    """A dock in a picture.

    Attributes:
        p_C: (3) D's origin in the camera's axes: right, down, ahead.
        R_CD: (3, 3) from D to the camera's axes.
        sigma_p, sigma_course: what they are expected to be off, m and rad.
        ids: of the tags that were found.
        corners: (n, 4, 2) of them in the picture, pixels.
    """

    p_C: np.ndarray
    R_CD: np.ndarray
    sigma_p: float
    sigma_course: float
    ids: tuple[int, ...]
    corners: np.ndarray


class Finder:
    """Finds the dock in pictures, with the detector that robots use (pupil-apriltags)."""

    def __init__(self, lens: Lens) -> None:
        from pupil_apriltags import Detector

        class Kept(Detector):  # type: ignore[misc]
            def __del__(self) -> None:
                """The detector's own frees the family of tags before what still reads it, and may crash: it is left to the end of the process."""

        self._lens = lens
        self._detector = Kept(families="tag36h11", quad_decimate=1.0)

    def find(self, picture: np.ndarray) -> Seen | None:
        """Where the dock is; None where fewer than two tags are seen (one alone, and small, may stand in two ways), or such that do not fit together.

        Args:
            picture: (h, w, 3) uint8.
        """
        # Green goes farthest in coastal water.
        told = self._detector.detect(np.ascontiguousarray(picture[..., 1]))
        told = [one for one in told if one.tag_id < len(TAGS) and one.decision_margin > CERTAIN]
        if len(told) < 2:
            return None
        tags, corners = [TAGS[one.tag_id] for one in told], np.array([one.corners for one in told])
        points, best = np.concatenate([corners_of(tag) for tag in tags]), None
        # What each tag alone tells begins a search for the pose in which all are where they are seen.
        for one, tag in zip(told, tags, strict=True):
            R, middle = self._alone(one.homography, tag.size)
            pose = self._fitted(points, corners.reshape(-1, 2), R, middle - R @ tag.place)
            if pose is not None and (best is None or pose[0] < best[0]):
                best = pose
        if best is None or best[0] > FITS_PX:
            return None
        _, R, p, spread = best
        ids = tuple(int(one.tag_id) for one in told)
        return Seen(p, R, math.sqrt(np.trace(spread[3:, 3:])), math.sqrt(spread[1, 1]), ids, corners)

    def _alone(self, homography: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
        """Rotation from D, and the middle of a tag in the camera's axes; (-1, -1) to (1, 1) of the homography are the tag's corners."""
        fx, fy, cx, cy = self._lens
        right, down, middle = (np.array(((1 / fx, 0, -cx / fx), (0, 1 / fy, -cy / fy), (0, 0, 1))) @ homography).T
        scale = math.copysign(2.0 / (np.linalg.norm(right) + np.linalg.norm(down)), middle[2])
        right, down, middle = scale * right, scale * down, scale * middle
        U, _, V = np.linalg.svd(np.column_stack([right, down, np.cross(right, down)]))
        return U @ V @ _AXES, 0.5 * size * middle

    def _fitted(self, points: np.ndarray, seen: np.ndarray, R: np.ndarray, p: np.ndarray) -> _Pose | None:
        """The pose of least squares, by Gauss and Newton from R, p; None where that leads nowhere."""
        f, middle = np.array(self._lens[:2]), np.array(self._lens[2:])
        for _ in range(20):
            turned = points @ R.T
            at = turned + p
            depth = at[:, 2:]
            if (depth < 0.05).any():
                return None
            off = seen - middle - f * at[:, :2] / depth
            # What a corner moves in the picture by: columns of a small turn about the camera's axes, then of a small way along them.
            way = np.concatenate(
                [np.broadcast_to(np.diag(f), (len(at), 2, 2)), (-f * at[:, :2] / depth)[:, :, None]], axis=2
            )
            way = way / depth[:, :, None]
            turn = np.cross(np.eye(3)[None], turned[:, None]).transpose(0, 2, 1)
            J = np.concatenate([way @ turn, way], axis=2).reshape(-1, 6)
            normal = J.T @ J
            if np.linalg.cond(normal) > 1e12:
                return None
            step = np.linalg.solve(normal, J.T @ off.ravel())
            R, p = _turn(step[:3]) @ R, p + step[3:]
            if np.abs(step).max() < 1e-6:
                break
        return float(np.sqrt((off**2).sum(axis=1).mean())), R, p, CORNER_PX**2 * np.linalg.inv(normal)


def corners_of(tag: Tag) -> np.ndarray:
    """(4, 3) in D, in the detector's order."""
    return np.array(tag.place) + np.column_stack([np.zeros(4), tag.size * _CORNERS])


def _turn(v: np.ndarray) -> np.ndarray:
    """Rotation about a vector by its length, rad (Rodrigues)."""
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return np.eye(3)
    K = np.cross(np.eye(3), v / angle)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def looks(code: int) -> np.ndarray:
    """(160, 160) picture of a tag, 0 to 255: white border, black border, 6 x 6 bits."""
    cells = np.full((10, 10), 255, np.uint8)
    cells[1:9, 1:9] = 0
    cells[2:8, 2:8] = [[255 * (code >> (35 - 6 * row - column) & 1) for column in range(6)] for row in range(6)]
    return np.kron(cells, np.ones((16, 16), np.uint8))


class _Model:
    """A .glb file as it grows."""

    def __init__(self) -> None:
        self._binary = b""
        self._told: dict[str, list[dict]] = {
            name: [] for name in ("bufferViews", "accessors", "images", "textures", "materials", "primitives")
        }

    def _add(self, name: str, entry: dict) -> int:
        self._told[name].append(entry)
        return len(self._told[name]) - 1

    def _view(self, data: bytes) -> int:
        at = len(self._binary)
        self._binary += data + b"\0" * (-len(data) % 4)
        return self._add("bufferViews", {"buffer": 0, "byteOffset": at, "byteLength": len(data)})

    def _accessor(self, array: np.ndarray, shape: str) -> int:
        kind = 5126 if array.dtype == np.float32 else 5123
        told = {"bufferView": self._view(array.tobytes()), "componentType": kind, "count": len(array), "type": shape}
        if shape == "VEC3":
            told |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        return self._add("accessors", told)

    def _faces(self, corners: np.ndarray, material: dict, uv: np.ndarray | None = None) -> None:
        """Rectangles of four corners each, (n, 4, 3) in D, anticlockwise as seen from before them."""
        points = corners.reshape(-1, 3) @ np.array(((1, 0, 0), (0, 0, 1), (0, -1, 0)))  # glTF: y up, z to the right
        order = (4 * np.arange(len(corners))[:, None] + (0, 1, 2, 0, 2, 3)).ravel()
        attributes = {"POSITION": self._accessor(points.astype("<f4"), "VEC3")}
        if uv is not None:
            attributes["TEXCOORD_0"] = self._accessor(uv.astype("<f4"), "VEC2")
        number = self._add("materials", {"pbrMetallicRoughness": {"metallicFactor": 0.0} | material})
        indices = self._accessor(order.astype("<u2"), "SCALAR")
        self._add("primitives", {"attributes": attributes, "indices": indices, "material": number})

    def boxes(
        self, boxes: list[tuple[tuple[float, ...], tuple[float, ...]]], paint: tuple[float, ...], first: int = 0
    ) -> None:
        """Boxes of one colour: middles and edges; `first` = 1 leaves out the sides that look to -x."""
        faces = [np.array(middle) + 0.5 * np.array(edges) * _SIDES[first:] for middle, edges in boxes]
        self._faces(np.concatenate(faces), {"baseColorFactor": [*paint, 1.0]})

    def tag(self, tag: Tag) -> None:
        """A tag with its white border, printed on a thin plate."""
        from PIL import Image

        edge = 1.25 * tag.size
        self.boxes([((tag.place[0] + 0.5 * THICK_M, *tag.place[1:]), (THICK_M, edge, edge))], (0.9, 0.9, 0.9), first=1)

        png = io.BytesIO()
        Image.fromarray(looks(tag.code)).save(png, "PNG", optimize=True)
        image = self._add("images", {"bufferView": self._view(png.getvalue()), "mimeType": "image/png"})
        texture = {"baseColorTexture": {"index": self._add("textures", {"source": image})}}
        self._faces(corners_of(tag._replace(size=edge))[None], texture, np.array([(0, 1), (1, 1), (1, 0), (0, 0)]))

    def data(self) -> bytes:
        """The whole file."""
        told = dict(self._told)
        meshes, size = [{"primitives": told.pop("primitives")}], len(self._binary)
        told |= {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
        text = json.dumps(told | {"meshes": meshes, "buffers": [{"byteLength": size}]}).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", size, b"BIN\0") + self._binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def make(file: Path) -> None:
    """Write the dock: solid and looks in one."""
    model = _Model()
    for name, paint in PAINT.items():
        model.boxes([box[1:] for box in BOXES if box[0] == name], paint)
    for tag in TAGS:
        model.tag(tag)
    file.write_bytes(model.data())


if __name__ == "__main__":
    make(Path(sys.argv[1]))
