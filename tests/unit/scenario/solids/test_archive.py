"""Solid things as one line of text: every shape comes back bit for bit, and what is none is refused."""

from __future__ import annotations

import base64

import msgspec
import numpy as np
import pytest
import zstandard

from uwserver.physics.geometry.shapes import (
    Box,
    Capsule,
    ConvexHull,
    Cylinder,
    HalfSpace,
    Placed,
    Shape,
    Solid,
    Sphere,
    TriangleMesh,
)
from uwserver.scenario.solids import archive
from uwserver.scenario.solids.archive import pack, unpack

RNG = np.random.default_rng(7)
MESH = TriangleMesh(RNG.normal(size=(12, 3)), RNG.integers(0, 12, (20, 3)), oriented=False)


def one(shape: Shape) -> dict[str, Solid]:
    return {"it": Solid("it", (Placed(shape),))}


@pytest.mark.parametrize(
    "shape", [Box((1.0, 2.0, 0.1)), Sphere(0.1), Cylinder(1.0 / 3.0, 0.3), Capsule(0.2, 1e-9), HalfSpace()]
)
def test_convex_shapes_come_back(shape: Shape) -> None:
    (placed,) = unpack(pack(one(shape)))["it"].shapes
    assert placed == Placed(shape)
    assert type(placed.shape) is type(shape)


def test_a_mesh_comes_back_bit_for_bit() -> None:
    shape = unpack(pack(one(MESH)))["it"].shapes[0].shape
    assert isinstance(shape, TriangleMesh)
    assert shape.vertices.tobytes() == MESH.vertices.tobytes()
    assert shape.vertices.dtype == np.float64
    assert shape.faces.tobytes() == MESH.faces.tobytes()
    assert shape.faces.dtype == np.int64
    assert shape.oriented is False


def test_odd_bits_of_a_hull_come_back() -> None:
    points = np.array([[0.0, -0.0, 5e-324], [1.0, 1e308, -1.0], [0.1, 0.2, 0.3], [1.0, 2.0, 3.0]])
    shape = unpack(pack(one(ConvexHull(points))))["it"].shapes[0].shape
    assert isinstance(shape, ConvexHull)
    assert shape.points.tobytes() == points.tobytes()


def test_place_and_surface_of_a_solid_come_back() -> None:
    placed = Placed(Sphere(0.5), (1.0 / 3.0, -2.0, 3e-17), (0.6, 0.0, 0.8, 0.0), 4)
    solid = Solid("wall", (placed, Placed(Box((1.0, 1.0, 1.0)))), 0.7, 0.25, 3)
    back = unpack(pack({"structures/wall": solid}))
    assert back == {"structures/wall": solid}
    assert isinstance(back["structures/wall"].shapes[0].p, tuple)


def test_names_and_their_order_come_back() -> None:
    solids = {name: Solid(name, (Placed(Sphere(1.0)),)) for name in ("z", "a", "m/ü")}
    assert list(unpack(pack(solids))) == ["z", "a", "m/ü"]
    assert unpack(pack({})) == {}


def test_it_is_one_line_of_ascii_and_the_same_each_time() -> None:
    text = pack(one(MESH))
    assert text.isascii()
    assert "\n" not in text
    assert pack(one(MESH)) == text


def packed(plain: object) -> str:
    compressed = zstandard.ZstdCompressor().compress(msgspec.msgpack.encode(plain))
    return base64.b85encode(compressed).decode()


@pytest.mark.parametrize(
    "plain",
    [
        3,
        [],
        {"it": 3},
        {"it": {"name": "it"}},
        {"it": {"name": "it", "friction": 0.5, "restitution": 0.0, "material": 0, "shapes": [{"kind": "Torus"}]}},
        {"it": {"name": "it", "friction": 0.5, "restitution": 0.0, "material": 0, "shapes": [{"kind": "Box"}]}},
        {"it": {"name": "it", "friction": 0.5, "restitution": 0.0, "material": 0, "shapes": 7}},
    ],
)
def test_what_holds_no_solids_is_refused(plain: object) -> None:
    with pytest.raises(ValueError, match="the solids cannot be read"):
        unpack(packed(plain))


def test_an_archive_that_would_grow_without_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    text = pack({"it": Solid("it", (Placed(TriangleMesh(np.zeros((50_000, 3)), MESH.faces)),))})
    monkeypatch.setattr(archive, "LARGEST_BYTES", 100_000)
    stream = zstandard.ZstdCompressor(write_content_size=False).compress(b"\0" * 1_000_000)
    with pytest.raises(ValueError, match="the solids cannot be read"):
        unpack(base64.b85encode(stream).decode())
    assert len(text) < 100_000, "it is small only until it is unpacked"
