"""Looks: axes, colours, textures; files that do not fit together."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from sensors.optical.camera.glb import glb, packed, png

from uwserver.scenario.solids.looks import check_glb
from uwserver.sensors.optical.camera import textures
from uwserver.sensors.optical.camera.gltf import BadLooks, read_glb

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
        {"scene": 5},
        {"bufferViews": "x"},
    ],
)
def test_files_that_do_not_fit_together_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(BadLooks):
        read_glb(broken(**changes))
