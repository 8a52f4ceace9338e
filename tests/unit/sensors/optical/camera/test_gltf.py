"""Model files: axes, colours, textures; files that do not fit together."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from sensors.optical.camera.glb import glb, packed, png

from uwserver.scenario.solids.appearance import check_glb
from uwserver.sensors.optical.camera import gltf, textures
from uwserver.sensors.optical.camera.gltf import BadGltf, read_glb

RED_AND_BLUE = png([[[255, 0, 0], [0, 0, 255]]] * 2)


def test_axes_and_colours() -> None:
    data = glb()
    check_glb(data)
    faces = read_glb(data).faces
    assert len(faces) == 2
    # y up becomes down, x stays forward, z to the right; the node lifts it by 3 m.
    assert faces["corners"].reshape(-1, 3).min(axis=0).tolist() == [-1.0, 0.0, -4.0]
    assert faces["corners"].reshape(-1, 3).max(axis=0).tolist() == [1.0, 0.0, -2.0]
    np.testing.assert_allclose(faces["normals"].reshape(-1, 3), [(0.0, 1.0, 0.0)] * 6, atol=1e-6)
    assert faces["colour"].tolist() == [[1.0, 0.5, 0.25]] * 2
    assert faces["sided"].tolist() == [1, 1]
    assert read_glb(glb(doubleSided=True)).faces["sided"].tolist() == [0, 0]


def test_a_texture_and_the_size_of_its_texels() -> None:
    looks = read_glb(glb(RED_AND_BLUE))
    assert [picture.shape for picture in looks.pictures] == [(2, 2, 3)]
    assert looks.faces["texture"].tolist() == [0, 0]
    np.testing.assert_allclose(looks.faces["texel"], 1.0)


def test_a_texture_that_is_none_or_too_large_is_told_and_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = read_glb(glb(b"no picture at all"))
    assert looks.faces["texture"].tolist() == [-1, -1]
    assert "no PNG or JPEG" in looks.faults[0]
    monkeypatch.setattr(textures, "MOST_PIXELS", 3)
    assert "2 x 2 pixels: at most 3" in read_glb(glb(RED_AND_BLUE)).faults[0]


def broken(**changes: object) -> bytes:
    data = glb()
    size = int.from_bytes(data[12:16], "little")
    told = msgspec.json.decode(data[20 : 20 + size])
    return packed(told | changes, data[20 + size + 8 :])


@pytest.mark.parametrize(
    "changes",
    [
        {"nodes": [{"children": [0]}]},
        {"nodes": [{"mesh": 7}]},
        {"nodes": [{"children": [1] * 60_000, "mesh": 0}, {}]},
        {"meshes": [{"primitives": []}]},
        {"accessors": [{"bufferView": 0, "componentType": 5126, "count": 10**9, "type": "VEC3"}] * 3},
        {"nodes": [{"mesh": 0, "translation": [0, 1e308, 0]}]},
        {"scene": 5},
        {"bufferViews": "x"},
    ],
)
def test_files_that_do_not_fit_together_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(BadGltf):
        read_glb(broken(**changes))


@pytest.mark.parametrize(
    ("view", "accessor"),
    [
        ({"byteStride": -4}, {}),
        ({"byteStride": 8}, {}),
        ({"byteStride": 256}, {"count": 1}),
        ({"byteStride": 12.0}, {}),
        ({}, {"byteOffset": -1}),
        ({}, {"count": 0}),
        ({}, {"count": -(2**40)}),
        ({"byteOffset": 2**62}, {}),
        ({"byteOffset": 12}, {"byteOffset": 200}),
    ],
)
def test_an_accessor_lies_within_the_file(view: dict[str, object], accessor: dict[str, object]) -> None:
    """Arrays of numbers are views of memory: what a file says of them is checked to the last byte."""
    square = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}
    views = [{"byteLength": 48, **view}]
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    with pytest.raises(BadGltf):
        read_glb(broken(bufferViews=views, accessors=[square | accessor], meshes=[mesh]))
    assert len(read_glb(broken(bufferViews=[{"byteLength": 48}], accessors=[square], meshes=[mesh])).faces) == 1


def test_a_picture_of_many_textures_is_decoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    data = glb(RED_AND_BLUE)
    size = int.from_bytes(data[12:16], "little")
    told = msgspec.json.decode(data[20 : 20 + size])
    primitive, material = told["meshes"][0]["primitives"][0], told["materials"][0]
    told["textures"] = [{"source": 0}] * 30
    told["materials"] = [
        {**material, "pbrMetallicRoughness": {"baseColorTexture": {"index": number}}} for number in range(30)
    ]
    told["meshes"][0]["primitives"] = [primitive | {"material": number} for number in range(30)]
    looks = read_glb(packed(told, data[20 + size + 8 :]))
    assert len(looks.pictures) == 1
    assert looks.faces["texture"].tolist() == [0] * 60
    # Pictures of their own take of the budget that all things have together; what is beyond it is not even decoded.
    told["images"] *= 30
    told["textures"] = [{"source": number} for number in range(30)]
    budget = textures.ByteBudget(3 * 2 * 2 * 5)
    looks = read_glb(packed(told, data[20 + size + 8 :]), budget)
    assert len(looks.pictures) == 5
    assert len(looks.faults) == 25
    assert "make them smaller" in looks.faults[0]
    assert budget.left == 0
    monkeypatch.setattr(gltf, "_MOST_PICTURES", 29)
    with pytest.raises(BadGltf, match="pictures"):
        read_glb(packed(told, data[20 + size + 8 :]))


def test_vertices_that_no_triangle_names_cost_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few triangles of a large table of vertices at many nodes: the vertices are not moved to each."""
    count, nodes = 50_000, 300
    binary = np.arange(3 * count, dtype="<f4").tobytes() + np.array((0, 1, 2), "<u4").tobytes()
    told = {
        "nodes": [{"mesh": 0, "translation": [0.0, 0.0, float(k)]} for k in range(nodes)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [{"byteLength": 12 * count}, {"byteOffset": 12 * count, "byteLength": 12}],
        "buffers": [{"byteLength": len(binary)}],
    }
    moved = []
    magnitude = np.abs
    monkeypatch.setattr(np, "abs", lambda values: moved.append(values.size) or magnitude(values))
    assert len(read_glb(packed(told, binary)).faces) == nodes
    assert sum(moved) == 9 * nodes
    monkeypatch.setattr(gltf, "_MOST_PARTS", nodes - 1)
    with pytest.raises(BadGltf, match="at nodes"):
        read_glb(packed(told, binary))
    monkeypatch.setattr(gltf, "MOST_TRIANGLES", nodes - 1)
    with pytest.raises(BadGltf):
        read_glb(packed(told, binary))
