"""Encodes Foxglove's messages, and gives their schemas. Degrees are allowed here, because this is a codec.

The numbers of fields are those of Foxglove's .proto files, see `SCHEMAS`. Of the wire format of protobuf there is as much as these messages need
(protobuf.dev/programming-guides/encoding). Fields are written in the order of their numbers, and left out if they are zero or empty, as every
encoder of proto3 does. So the bytes are those of generated encoders.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from uwserver.frames import Quat, Vec3
from uwserver.units import NANOSECONDS, deg

_DOUBLE = struct.Struct("<d")
_FIXED32 = struct.Struct("<I")
_ZERO = bytes(8)
_VARINT, _I64, _BYTES, _I32 = 0, 1, 2, 5

FLOAT32 = 7
"""PackedElementField.FLOAT32."""
DIAGONAL_KNOWN = 2
"""LocationFix.DIAGONAL_KNOWN."""
DELETE_ALL = 1
"""SceneEntityDeletion.ALL."""
INFO, WARNING, ERROR = 2, 3, 4
"""Levels of Log."""
_TEXT = (Path(__file__).parent / "schemas.json").read_text(encoding="ascii")
SCHEMAS: Mapping[str, bytes] = {name: base64.b64decode(data) for name, data in json.loads(_TEXT).items()}
"""For each message, by its full name such as ``foxglove.FrameTransforms``: a serialised FileDescriptorSet with all that it imports.

They were made from the package foxglove-schemas-protobuf (MIT licence, Foxglove Technologies Inc). A test compares them with it. Reading them takes
a quarter of a millisecond.
"""


def varint(number: int) -> bytes:
    """Encode a number >= 0 with seven bits in each byte, the lowest first."""
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def _tag(field: int, kind: int) -> bytes:
    return varint(field << 3 | kind)


def double(field: int, value: float) -> bytes:
    """Encode a double; +0 as nothing."""
    data = _DOUBLE.pack(value)
    return b"" if data == _ZERO else _tag(field, _I64) + data


def whole(field: int, value: int) -> bytes:
    """Encode a bool, an enum, or an integer >= 0."""
    return _tag(field, _VARINT) + varint(value) if value else b""


def fixed32(field: int, value: int) -> bytes:
    """Encode an unsigned integer of four bytes."""
    return _tag(field, _I32) + _FIXED32.pack(value) if value else b""


def blob(field: int, data: bytes) -> bytes:
    """Encode bytes; no bytes as nothing."""
    return message(field, data) if data else b""


def text(field: int, value: str) -> bytes:
    """Encode a text in UTF-8. Half a surrogate pair becomes a question mark, because decoders refuse it."""
    return blob(field, value.encode("utf-8", "replace"))


def message(field: int, body: bytes) -> bytes:
    """Encode a message within a message, also an empty one."""
    return _tag(field, _BYTES) + varint(len(body)) + body


def doubles(field: int, values: Iterable[float] | npt.NDArray[np.float64]) -> bytes:
    """Encode a repeated double, packed."""
    return blob(field, np.fromiter(values, dtype="<f8").tobytes())


def words(field: int, values: npt.NDArray[np.uint32]) -> bytes:
    """Encode a repeated fixed32, packed."""
    return blob(field, values.astype("<u4").tobytes())


def timestamp(field: int, t_ns: int) -> bytes:
    """Encode a simulation time as google.protobuf.Timestamp."""
    seconds, nanos = divmod(t_ns, NANOSECONDS)
    return message(field, whole(1, seconds) + whole(2, nanos))


def vector(field: int, v: Sequence[float]) -> bytes:
    """Encode a Vector3."""
    return message(field, double(1, v[0]) + double(2, v[1]) + double(3, v[2]))


def quaternion(field: int, q: Sequence[float]) -> bytes:
    """Encode a Quaternion from w, x, y, z."""
    return message(field, double(1, q[1]) + double(2, q[2]) + double(3, q[3]) + double(4, q[0]))


def pose(field: int, p: Sequence[float], q: Sequence[float]) -> bytes:
    """Encode a Pose."""
    return message(field, vector(1, p) + quaternion(2, q))


def colour(field: int, rgb: Sequence[float], alpha: float = 1.0) -> bytes:
    """Encode a Color of the screen (sRGB, IEC 61966-2-1) from linear red, green and blue."""
    r, g, b = (12.92 * c if c <= 0.0031308 else 1.055 * c ** (1.0 / 2.4) - 0.055 for c in rgb)
    return message(field, double(1, r) + double(2, g) + double(3, b) + double(4, alpha))


def transform(t_ns: int, parent: str, child: str, p: Sequence[float], q: Sequence[float]) -> bytes:
    """Encode one of FrameTransforms: the child's position and attitude in its parent."""
    return message(1, timestamp(1, t_ns) + text(2, parent) + text(3, child) + vector(4, p) + quaternion(5, q))


def pose_in_frame(t_ns: int, frame: str, p: Sequence[float], q: Sequence[float]) -> bytes:
    """Encode a PoseInFrame."""
    return timestamp(1, t_ns) + text(2, frame) + pose(3, p, q)


def location_fix(t_ns: int, frame: str, latitude: float, longitude: float, height: float, sigmas: Vec3 | None) -> bytes:
    """Encode a LocationFix.

    Args:
        t_ns: simulation time of the measurement.
        frame: frame of the antenna.
        latitude, longitude: rad.
        height: m.
        sigmas: standard deviations east, north, up, m; None if the receiver gives none.
    """
    known = b""
    if sigmas is not None:
        known = doubles(4, np.diag(np.square(sigmas)).reshape(-1)) + whole(5, DIAGONAL_KNOWN)
    place = double(1, deg(latitude)) + double(2, deg(longitude)) + double(3, height)
    return place + known + timestamp(6, t_ns) + text(7, frame)


def laser_scan(t_ns: int, frame: str, start: float, end: float, ranges: Iterable[float]) -> bytes:
    """Encode a LaserScan of distances (m) from one angle (rad, about z of the frame) to another."""
    return (
        timestamp(1, t_ns)
        + text(2, frame)
        + pose(3, _ORIGIN, _LEVEL)
        + double(4, start)
        + double(5, end)
        + doubles(6, ranges)
    )


def point_cloud(t_ns: int, frame: str, points: npt.NDArray[np.float32]) -> bytes:
    """Encode a PointCloud of rows (n, 4): x, y, z (m), intensity."""
    fields = b"".join(
        message(5, text(1, name) + fixed32(2, 4 * k) + whole(3, FLOAT32))
        for k, name in enumerate(("x", "y", "z", "intensity"))
    )
    data = np.ascontiguousarray(points, dtype="<f4").tobytes()
    return timestamp(1, t_ns) + text(2, frame) + pose(3, _ORIGIN, _LEVEL) + fixed32(4, 16) + fields + blob(6, data)


def log_line(t_ns: int, level: int, what: str, name: str) -> bytes:
    """Encode a Log."""
    return timestamp(1, t_ns) + whole(2, level) + text(3, what) + text(4, name)


def cube(p: Vec3, q: Quat, size: Vec3, rgb: Vec3) -> bytes:
    """Encode a CubePrimitive of a SceneEntity."""
    return message(8, pose(1, p, q) + vector(2, size) + colour(3, rgb))


def sphere(p: Vec3, q: Quat, size: Vec3, rgb: Vec3) -> bytes:
    """Encode a SpherePrimitive of a SceneEntity."""
    return message(9, pose(1, p, q) + vector(2, size) + colour(3, rgb))


def cylinder(p: Vec3, q: Quat, size: Vec3, rgb: Vec3) -> bytes:
    """Encode a CylinderPrimitive about z of its pose."""
    return message(10, pose(1, p, q) + vector(2, size) + double(3, 1.0) + double(4, 1.0) + colour(5, rgb))


def triangles(p: Vec3, q: Quat, vertices: npt.NDArray[np.float32], corners: npt.NDArray[np.uint32], rgb: Vec3) -> bytes:
    """Encode a TriangleListPrimitive of vertices (n, 3) and numbers of vertices (m, 3)."""
    points = b"".join(message(2, double(1, x) + double(2, y) + double(3, z)) for x, y, z in vertices.tolist())
    return message(12, pose(1, p, q) + points + colour(3, rgb) + words(5, corners.reshape(-1)))


def model(p: Vec3, q: Quat, scale: float, data: bytes) -> bytes:
    """Encode a ModelPrimitive with its file (glTF, binary)."""
    size = (scale, scale, scale)
    return message(14, pose(1, p, q) + vector(2, size) + text(6, "model/gltf-binary") + blob(7, data))


def entity(t_ns: int, frame: str, name: str, primitives: dict[int, list[bytes]]) -> bytes:
    """Encode a SceneEntity of a SceneUpdate that stays, and moves with its frame; primitives by the number of their field."""
    shapes = b"".join(part for number in sorted(primitives) for part in primitives[number])
    head = timestamp(1, t_ns) + text(2, frame) + text(3, name) + message(4, b"") + whole(5, 1)
    return message(2, head + shapes)


def compressed_image(t_ns: int, frame: str, data: bytes) -> bytes:
    """Encode a CompressedImage in JPEG."""
    return timestamp(1, t_ns) + blob(2, data) + text(3, "jpeg") + text(4, frame)


def delete_all(t_ns: int) -> bytes:
    """Encode a SceneEntityDeletion of a SceneUpdate, which deletes all that was there earlier."""
    return message(1, timestamp(1, t_ns) + whole(2, DELETE_ALL))


_ORIGIN: Vec3 = (0.0, 0.0, 0.0)
_LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
