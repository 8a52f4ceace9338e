"""Looks are one self-contained .glb of a bounded size, checked before anybody gets it, and change nothing but pictures."""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path
from typing import Any

import pytest

from uwserver.adapter import installed_adapters
from uwserver.physics.geometry.shapes import BadSolid
from uwserver.scenario.build.world import build
from uwserver.scenario.files.errors import ScenarioError
from uwserver.scenario.load.export import identity
from uwserver.scenario.load.scenario import load
from uwserver.scenario.scene.scenery import Scenery
from uwserver.scenario.solids import appearance
from uwserver.scenario.solids.appearance import check_glb, read_model_file
from uwserver.world.state.scene_probe import SceneProbe

TRIANGLE = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
PLAIN: dict[str, Any] = {
    "asset": {"version": "2.0"},
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36}],
}


def glb(told: object = PLAIN, binary: bytes = TRIANGLE) -> bytes:
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts


def test_a_plain_one_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "x.glb"
    path.write_bytes(glb())
    assert read_model_file(path) == glb()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"buffers": [{"byteLength": 36, "uri": "x.bin"}]}, "embedded"),
        ({"images": [{"uri": "https://evil.example/x.png"}]}, "embedded"),
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "KHR_draco"),
        ({"extensionsRequired": "x"}, "needs"),
        ({"extensionsRequired": [["x"]]}, "needs"),
        ({"buffers": [{"byteLength": 37}]}, "do not fit"),
        ({"buffers": [{"byteLength": 18}, {"byteLength": 18}]}, "do not fit"),
        ({"bufferViews": [{"byteOffset": 4, "byteLength": 36}]}, "beyond"),
        ({"bufferViews": [{"byteLength": -1}]}, "not a whole number"),
        ({"bufferViews": [{"byteLength": 36, "byteStride": -(1 << 20)}]}, "not a whole number"),
        ({"accessors": [{"count": 3, "byteOffset": -1}]}, "not a whole number"),
        ({"accessors": [{"count": 10**9}]}, "simplify"),
        ({"nodes": [{}] * 20_001}, "nodes"),
        ({"nodes": {}}, "not a list"),
    ],
)
def test_what_a_viewer_could_stumble_over_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(BadSolid, match=said):
        check_glb(glb({**PLAIN, **change}))


@pytest.mark.parametrize(
    "data",
    [b"", glb()[:-1], glb() + b"x", b"x" + glb()[1:], glb()[:4] + b"\1" + glb()[5:], glb([]), glb()[:20],
     struct.pack("<4sIII4s", b"glTF", 2, 20, 2**31, b"JSON"), glb().replace(b"BIN\0", b"NIB\0"), glb().replace(b'"asset"', b'"asse\xff"')],
)  # fmt: skip
def test_what_is_no_glb_is_refused(data: bytes) -> None:
    with pytest.raises(BadSolid):
        check_glb(data)


def test_files_of_other_kinds_and_sizes_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.glb"
    path.write_bytes(glb())
    monkeypatch.setattr(appearance, "MOST_BYTES", 100)
    for name, said in (("x.glb", "at most 100"), ("x.gltf", "not a .glb"), ("y.glb", "cannot read")):
        with pytest.raises(BadSolid, match=said):
            read_model_file(tmp_path / name)


SCENARIO = """
schema = 1
adapters = {}
[structures.post]
kind = "box"
size_m = [1, 1, 4]
position_ned_m = [5, 0, 8]
POST
[vehicles.rov]
model = "bluerov2"
[vehicles.rov.override]
ROV
"""


def test_looks_are_described_under_their_hash_and_change_no_state(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(glb())
    bare, dressed = tmp_path / "bare.toml", tmp_path / "dressed.toml"
    bare.write_text(SCENARIO.replace("POST", "").replace("ROV", ""))
    dressed.write_text(SCENARIO.replace("POST", 'looks = "a.glb"').replace("ROV", 'looks = "a.glb"'))
    resolved = load(dressed, adapters=installed_adapters())
    assert identity(resolved) == identity(load(bare, adapters=installed_adapters()))
    world = build(resolved)
    scenery = Scenery(resolved, world)
    scene = scenery.scene(SceneProbe(world).state().entities)
    name = hashlib.sha256(glb()).hexdigest()
    assert scenery.model_files == {name: glb()}
    (post,), (rov,) = scene.structures, scene.vehicles
    assert post.looks is not None
    assert (post.looks.sha256, post.looks.p) == (name, (5.0, 0.0, 8.0))
    assert rov.looks is not None
    assert (rov.looks.size, rov.looks.p) == (len(glb()), (0.0, 0.0, 0.0))
    assert rov.shapes, "the shapes remain what it is"


def test_a_fault_is_told_at_its_line(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(SCENARIO.replace("POST", 'looks = "b.glb"').replace("ROV", 'looks = "c.obj"'))
    with pytest.raises(ScenarioError) as error:
        load(path, adapters=installed_adapters())
    assert "s.toml:8:1: structures.post.looks" in str(error.value)
    assert "c.obj" in str(error.value)
