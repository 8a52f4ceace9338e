"""Foxglove's messages: byte for byte what the generated encoders of its own packages write. Also of uwserver.adapter.foxglove.codec."""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np
import pytest

from uwserver.adapter.foxglove import SCHEMAS, codec
from uwserver.adapter.foxglove.shapes import entity_of
from uwserver.frames import rotate
from uwserver.ports import ModelFileView, ShapeView

P, Q, RGB = (1.5, -2.0, 0.25), (0.5, -0.5, 0.5, 0.5), (0.0, 1.0, 1.0)
T_NS = 12_000_000_345


def generated(name: str, data: bytes) -> Any:
    """The message as their decoder reads it."""
    module = pytest.importorskip(f"foxglove_schemas_protobuf.{name}_pb2")
    return getattr(module, name).FromString(data)


def same(name: str, data: bytes) -> Any:
    """As `generated`; their encoder gives the same bytes again, so none of ours is of another kind, order or length."""
    told = generated(name, data)
    assert told.SerializeToString(deterministic=True) == data
    return told


@pytest.mark.parametrize("name", list(SCHEMAS))
def test_the_frozen_schemas_are_those_of_the_package(name: str) -> None:
    short = name.removeprefix("foxglove.")
    module = pytest.importorskip(f"foxglove_schemas_protobuf.{short}_pb2")
    build = importlib.import_module("mcap_protobuf.schema").build_file_descriptor_set
    assert build(getattr(module, short)).SerializeToString(deterministic=True) == SCHEMAS[name]


def test_the_sdk_has_the_same_messages() -> None:
    """Their types, as foxglove-sdk writes them, against ours."""
    sdk = pytest.importorskip("foxglove.messages")
    fix = sdk.LocationFix(
        latitude=math.degrees(math.radians(60.0)),
        longitude=math.degrees(math.radians(10.0)),
        altitude=-1.0,
        frame_id="gps",
        timestamp=sdk.Timestamp(12, 345),
    )
    ours = codec.location_fix(T_NS, "gps", math.radians(60.0), math.radians(10.0), -1.0, None)
    assert fix.encode() == ours
    line = sdk.Log(timestamp=sdk.Timestamp(12, 345), level=sdk.LogLevel.Warning, message="m", name="n")
    assert line.encode() == codec.log_line(T_NS, codec.WARNING, "m", "n")


def test_transforms_and_poses() -> None:
    told = same(
        "FrameTransforms",
        codec.transform(T_NS, "N", "rov", P, Q) + codec.transform(0, "a", "b", (0, 0, 0), (1, 0, 0, 0)),
    )
    first = told.transforms[0]
    assert (first.timestamp.seconds, first.timestamp.nanos) == (12, 345)
    assert (first.parent_frame_id, first.child_frame_id) == ("N", "rov")
    assert (first.translation.x, first.translation.y, first.translation.z) == P
    assert (first.rotation.w, first.rotation.x, first.rotation.y, first.rotation.z) == Q
    pose = same("PoseInFrame", codec.pose_in_frame(T_NS, "N", P, Q)).pose
    assert pose.position.y == -2.0
    assert pose.orientation.x == -0.5


def test_a_fix() -> None:
    fix = same(
        "LocationFix",
        codec.location_fix(T_NS, "rov/gps", math.radians(63.5), math.radians(-10.25), -0.5, (2.0, 2.0, 3.0)),
    )
    assert fix.latitude == pytest.approx(63.5, abs=1e-12)
    assert fix.longitude == pytest.approx(-10.25, abs=1e-12)
    assert list(fix.position_covariance) == [4.0, 0, 0, 0, 4.0, 0, 0, 0, 9.0]
    assert fix.position_covariance_type == fix.DIAGONAL_KNOWN


def test_ranges_and_points() -> None:
    scan = same("LaserScan", codec.laser_scan(T_NS, "rov/lasers", -0.5, 0.5, [1.0, math.inf, 3.0]))
    assert (scan.start_angle, scan.end_angle, list(scan.ranges)) == (-0.5, 0.5, [1.0, math.inf, 3.0])
    points = np.arange(12, dtype=np.float32).reshape(3, 4)
    cloud = same("PointCloud", codec.point_cloud(T_NS, "rov/sonar", points))
    assert cloud.point_stride == 16
    assert [(f.name, f.offset, f.type) for f in cloud.fields] == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
        ("intensity", 12, 7),
    ]
    np.testing.assert_array_equal(np.frombuffer(cloud.data, "<f4").reshape(3, 4), points)


def test_a_picture() -> None:
    picture = same("CompressedImage", codec.compressed_image(T_NS, "rov/camera", b"\xff\xd8jpeg"))
    assert (picture.format, picture.data, picture.frame_id) == ("jpeg", b"\xff\xd8jpeg", "rov/camera")


@pytest.mark.parametrize("text", ["", "a fault </script>", "\ud800 half a pair", "x" * 300])
def test_log_lines(text: str) -> None:
    line = same("Log", codec.log_line(T_NS, codec.WARNING, text, "fault"))
    assert line.message == text.encode("utf-8", "replace").decode()
    assert line.level == line.WARNING


SHAPES = (
    ShapeView("box", P, Q, size=(1.0, 2.0, 3.0), colour=RGB),
    ShapeView("sphere", radius=0.5),
    ShapeView("cylinder", P, radius=0.25, length=4.0),
    ShapeView("capsule", radius=0.25, length=4.0),
    ShapeView("plane", (0.0, 0.0, 20.0)),
    ShapeView("mesh", mesh="tri"),
)
TRIANGLE = (
    np.array([1, 1], "<u4").tobytes() + np.arange(9, dtype="<f4").tobytes() + np.array([0, 1, 2], "<u4").tobytes()
)
TRIANGLE = np.array([3, 1], "<u4").tobytes() + TRIANGLE[8:]


def scene(shapes: tuple[ShapeView, ...], looks: ModelFileView | None = None) -> Any:
    data = codec.delete_all(T_NS) + entity_of(
        T_NS, "rov", "rov", shapes, looks, {"tri": TRIANGLE}.__getitem__, {"g": b"glTF"}.__getitem__
    )
    return same("SceneUpdate", data)


def test_shapes() -> None:
    update = scene(SHAPES)
    assert update.deletions[0].type == update.deletions[0].ALL
    (entity,) = update.entities
    assert entity.frame_locked
    assert (entity.lifetime.seconds, entity.lifetime.nanos) == (0, 0)
    assert (len(entity.cubes), len(entity.spheres), len(entity.cylinders), len(entity.triangles)) == (2, 3, 2, 1)
    assert (entity.cubes[0].size.x, entity.cubes[0].size.z, entity.cubes[0].color.a) == (1.0, 3.0, 1.0)
    assert entity.cubes[1].pose.position.z == pytest.approx(20.01)
    lying = entity.cylinders[0]
    assert (lying.size.x, lying.size.z) == (0.5, 4.0)
    q = lying.pose.orientation
    np.testing.assert_allclose(
        rotate((q.w, q.x, q.y, q.z), (0.0, 0.0, 1.0)), (1.0, 0.0, 0.0), atol=1e-12
    )  # theirs stands about z
    assert sorted(ball.pose.position.x for ball in entity.spheres) == [-2.0, 0.0, 2.0]
    mesh = entity.triangles[0]
    assert (mesh.points[2].z, list(mesh.indices)) == (8.0, [0, 1, 2])


@pytest.mark.parametrize(("up", "file_up", "file_right"), [("y", (0, 1, 0), (0, 0, 1)), ("z", (0, 0, 1), (0, -1, 0))])
def test_models_lie_as_in_the_web_view(up: Any, file_up: tuple[int, ...], file_right: tuple[int, ...]) -> None:
    model = scene((), ModelFileView("g", 4, up=up)).entities[0].models[0]
    assert (model.data, model.media_type) == (b"glTF", "model/gltf-binary")
    q = model.pose.orientation

    def shown(v: tuple[int, ...]) -> tuple[float, ...]:
        # Viewers turn each glTF from y up to z up before they place it.
        return rotate((q.w, q.x, q.y, q.z), (v[0], -v[2], v[1]))

    np.testing.assert_allclose(shown((1, 0, 0)), (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(shown(file_up), (0, 0, -1), atol=1e-12)
    np.testing.assert_allclose(shown(file_right), (0, 1, 0), atol=1e-12)


def test_a_large_mesh_is_drawn_with_fewer_triangles() -> None:
    side = 400
    x, y = np.meshgrid(np.arange(side, dtype="<f4"), np.arange(side, dtype="<f4"), indexing="ij")
    vertices = np.stack([x, y, np.sin(x / 30)], axis=2).reshape(-1, 3)
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 1, a + side], 1), np.stack([a + 1, a + side + 1, a + side], 1)]).astype(
        "<u4"
    )
    packed = np.array([len(vertices), len(faces)], "<u4").tobytes() + vertices.tobytes() + faces.tobytes()
    data = entity_of(0, "N", "seabed", (ShapeView("mesh", mesh="m"),), None, {"m": packed}.__getitem__, {}.__getitem__)
    (mesh,) = generated("SceneUpdate", data).entities[0].triangles
    assert len(faces) > 300_000
    assert 10_000 < len(mesh.indices) // 3 <= 100_000
    assert max(mesh.indices) < len(mesh.points)
    assert max(point.x for point in mesh.points) > 395.0
